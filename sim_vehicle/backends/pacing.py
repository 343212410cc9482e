"""Wall-clock matters of a backend, without a clock: pacing, and noticing that the firmware is silent."""

from __future__ import annotations

from sim_vehicle.errors import SimulatorError

LARGEST_LAG_S = 0.1
"""If the machine is this far behind, simulated time is let go rather than caught up in a burst."""


class Pacer:
    """Keeps simulated time to a multiple of wall time."""

    def __init__(self, real_time_factor: float) -> None:
        self._factor = real_time_factor
        self._origin_s: float | None = None

    def wait(self, time_us: int, now_s: float) -> float:
        """Seconds to sleep until simulated time `time_us` is due; 0 if it is, or if nobody paces."""
        if self._factor == 0.0:
            return 0.0
        simulated = time_us * 1e-6 / self._factor
        if self._origin_s is None or now_s - self._origin_s - simulated > LARGEST_LAG_S:
            self._origin_s = now_s - simulated
        return max(0.0, self._origin_s + simulated - now_s)


class StallWatch:
    """Says so when the firmware falls silent: after `warning_s`, then each time the silence has doubled.

    Parameters
    ----------
    who : the backend, at the head of each line
    what : what is missing, in the singular
    remedy : what to do if it never came
    timeout_s : silence after which `check` gives up; 0 for never
    """

    def __init__(
        self, who: str, what: str, remedy: str, *, warning_s: float, timeout_s: float, now_s: float
    ) -> None:
        self._who, self._what, self._remedy = who, what, remedy
        self._warning_s, self._timeout_s = warning_s, timeout_s
        self._last_s = now_s
        self._next_s = warning_s
        self._ever = False

    def heard(self, now_s: float) -> str | None:
        """Something came. A line if that ends an announced silence."""
        silence = now_s - self._last_s
        announced = self._next_s > self._warning_s
        self._last_s, self._next_s, self._ever = now_s, self._warning_s, True
        return f"{self._who}: {self._what}s are coming again after {silence:.1f} s" if announced else None

    def check(self, now_s: float, time_us: int) -> str | None:
        """A line if it is time for one. Raises SimulatorError if the time to wait is over."""
        silence = now_s - self._last_s
        if 0.0 < self._timeout_s <= silence:
            raise SimulatorError(f"{self._text(self._timeout_s, time_us)}; {self._remedy}")
        if silence < self._next_s:
            return None
        line = f"{self._text(self._next_s, time_us)}, still waiting; {self._remedy}"
        self._next_s *= 2.0
        return line

    def _text(self, silence_s: float, time_us: int) -> str:
        when = f" at {time_us * 1e-6:.2f} s of simulated time" if self._ever else ""
        return f"{self._who}: no {self._what} for {silence_s:g} s{when}"
