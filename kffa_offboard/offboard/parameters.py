"""What the autopilot's parameters mean for engaging, and what people are told of them."""

from __future__ import annotations

from kffa_offboard.offboard.events import Announce, ParametersChecked, Severity

_SEVERITIES = {
    "unsafe": Severity.CRITICAL,
    "warning": Severity.WARNING,
    "information": Severity.INFO,
}


def unsafe(checked: ParametersChecked) -> str | None:
    """Why control must not be taken; None if the parameters allow it."""
    if not checked.complete:
        return "parameters are being read"
    return next((problem.text for problem in checked.problems if problem.severity == "unsafe"), None)


def announcements(before: ParametersChecked, now: ParametersChecked) -> tuple[Announce, ...]:
    """Lines for the problems that are new."""
    told = set(before.problems)
    return tuple(
        Announce(_SEVERITIES[problem.severity], problem.text)
        for problem in now.problems
        if problem not in told
    )
