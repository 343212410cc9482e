"""The demonstration: fly the simulated vehicle with the daemon, measure how far it moved, draw it."""
