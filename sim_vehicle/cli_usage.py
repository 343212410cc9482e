"""Wrong values of command-line options, in one line each like everything else that a person can put right."""

from __future__ import annotations

import sys
from typing import Any

import typer
from pydantic import ValidationError
from typer.core import TyperGroup

EXIT_BAD_INPUT = 2


class OneLineGroup(TyperGroup):
    """Commands whose options, where a value is wrong, say so with value and remedy."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command; a value of an option that is wrong ends it with status 2."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            line = _line(error)
            if line is None:  # what is missing or too much: typer says how the command is used
                raise
            print(f"error: {line}", file=sys.stderr)
            raise typer.Exit(EXIT_BAD_INPUT) from error


def _line(error: typer.BadParameter) -> str | None:
    """Option, value and what is right; None if typer did not look at a value."""
    option: Any = error.param
    if option is None:
        return None
    name = max(option.opts, key=len)
    if error.message.endswith("is not readable."):
        return f"{name}: {error.message.rstrip('.')}; chmod u+r it, or be the user who may read it"
    if not isinstance(error.__cause__, ValidationError):
        return None
    detail = error.__cause__.errors()[0]
    right = "a whole number" if detail["type"].startswith("int") else "a number"
    return f"{name} {detail['input']}: must be {right}"
