"""Faults of the link between daemon and vehicle, made on purpose: to see that the daemon copes."""
