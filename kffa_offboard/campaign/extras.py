"""Packages of the extra `campaign`, imported when they are needed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from kffa_offboard.errors import UserError


def need(module: str, what: str) -> Any:
    """Import `module`. Raises UserError, naming the extra, if it is not installed."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise UserError(
            f"{what} needs the package {error.name}, which is not installed; "
            'install it with: pip install "kffa-offboard[campaign]"'
        ) from error
