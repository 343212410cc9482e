"""What looks after the control loop of one vehicle: its punctuality, and trouble beside the flight."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from kffa_offboard.offboard.events import ProcessReport, Trouble
from kffa_offboard.process.notify import ServiceManager
from kffa_offboard.process.realtime import Collector
from kffa_offboard.process.timing import StepClock

TroubleSource = Callable[[], str | None]
"""Returns what is wrong, once for each reason; else None."""


class LoopWatch:
    """Told by the loop what it does (`mavlink.shell.Watch`); says what is to be reported.

    Parameters
    ----------
    clock
        Counts late steps of this vehicle.
    manager, collector
        Of the process.
    sources
        Where trouble may come from; all are asked in each turn of the loop.

    """

    def __init__(
        self,
        clock: StepClock,
        manager: ServiceManager,
        collector: Collector,
        sources: Sequence[TroubleSource] = (),
    ) -> None:
        self._clock = clock
        self._manager = manager
        self._collector = collector
        self._sources = tuple(sources)
        self._stepped = False

    def step(self, arrived_us: int, done_us: int) -> None:
        """See `StepClock.step`."""
        self._clock.step(arrived_us, done_us)
        self._stepped = True

    def deadline(self, due_us: int, done_us: int) -> None:
        """See `StepClock.deadline`."""
        self._clock.deadline(due_us, done_us)

    def turned(self, now_us: int) -> list[ProcessReport]:
        """The loop has come round and everything due was sent: what there is to report."""
        self._manager.turned(now_us)
        if self._stepped:
            self._stepped = False
            self._collector.step_done(now_us)
        reports: list[ProcessReport] = [
            Trouble(text) for source in self._sources if (text := source()) is not None
        ]
        timing = self._clock.report(now_us)
        return reports if timing is None else [*reports, timing]

    def summary(self) -> dict[str, int]:
        """Steps and what was late, since the start."""
        return self._clock.summary()

    def ended(self) -> list[ProcessReport]:
        """The loop is over: the last counts."""
        return [self._clock.last_report()]
