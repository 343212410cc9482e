"""Offboard KFFA-LADRC attitude and altitude control for multirotors that carry loads."""

__version__ = "0.1.0"
