"""Wrong values of command-line options, in one line each like everything else that a person can put right."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

from kffa_offboard.errors import UserError


class OneLineGroup(TyperGroup):
    """Commands whose options, where a value is wrong, say so with value, limit and remedy."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command. Raises UserError for a value of an option that is wrong."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            line = _line(error)
            if line is None:  # a missing argument: typer says which, and how the command is used
                raise
            raise UserError(line) from error


def _line(error: typer.BadParameter) -> str | None:
    """Option, value, what is wrong and what is right; None if typer did not look at a value."""
    from pydantic import ValidationError

    from kffa_offboard.config_errors import finding

    option: Any = error.param
    if option is None:
        return None
    name = max(option.opts, key=len) if option.param_type_name == "option" else option.metavar
    if error.message.endswith("is not readable."):
        return f"{name}: {error.message.rstrip('.')}; chmod u+r it, or be the user who may read it"
    if not isinstance(error.__cause__, ValidationError):
        return None
    detail = error.__cause__.errors()[0]
    return f"{name} {detail['input']}: {finding(detail).rstrip('.')}{_range(option.min, option.max)}"


def _range(low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return ""
    return f"; give {low:.15g} or more" if high is None else f"; give {low:.15g} to {high:.15g}"
