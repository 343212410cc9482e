"""The offboard service: a state machine without I/O, its limits, and where setpoints come from."""
