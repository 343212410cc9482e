"""Errors that are meant for people."""

from __future__ import annotations


class UserError(Exception):
    """Something a person can put right: one line with the thing, its value, the limit and the remedy.

    Commands print it as ``error: ...`` without a traceback and end with status 2.
    """
