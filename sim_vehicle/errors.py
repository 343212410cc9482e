"""Errors that are meant for people."""

from __future__ import annotations


class SimulatorError(Exception):
    """Something the user can put right.

    The text is one line that names the thing, its value, the limit and the remedy; the command
    line prints it after ``error:`` and ends with status 2.
    """
