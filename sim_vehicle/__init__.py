"""A simulated quadrotor with a load, behind MAVLink, that behaves as PX4 or as ArduCopter does."""
