"""The gripper and the load: the third part of the offboard service, beside `session.py` and `service.py`.

Gripper commands go out here, at once or when the step of thrust asks for it; what the load does is watched
here (`payload.py`), and a release that is refused is taken back.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.control import vehicle
from kffa_offboard.offboard import events, telemetry, trust
from kffa_offboard.offboard.engage_session import EngageSession
from kffa_offboard.offboard.events import Severity
from kffa_offboard.offboard.guard import tilt_factor
from kffa_offboard.offboard.loop import Order, Trace
from kffa_offboard.offboard.payload import (
    Awareness,
    PayloadSample,
    begin_awareness,
    call_off_drop,
    expect_drop,
    has_load,
    step_awareness,
    weigh_anew,
)
from kffa_offboard.offboard.release import ReleasePlan, altitude_disturbance, plan_release, with_altitude_step
from kffa_offboard.offboard.segments import Land
from kffa_offboard.offboard.sequence import microseconds
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.state import ENGAGED, SENDING, State
from kffa_offboard.offboard.swinging import for_swinging_load
from kffa_offboard.offboard.tuning import adopt

GripperAction = Literal["grab", "release"]


class Release(Struct, frozen=True, gc=False):
    """A release under way: its plan, when the gripper's command is due (None: it is out), when the release
    should show, and the altitude channel's disturbance before it, m/s^2.
    """

    plan: ReleasePlan
    gripper_us: int | None
    shows_us: int
    before: float


class PayloadSession(EngageSession):
    """Gripper and payload awareness; use `service.Service`."""

    __slots__ = ()

    def __init__(self, settings: ServiceSettings) -> None:
        super().__init__(settings)
        self._awareness: Awareness | None = None
        self._release_plan: Release | None = None
        self._position_us: int | None = None

    def _payload_deadlines(self) -> list[tuple[int, Callable[[int], None]]]:
        deadlines: list[tuple[int, Callable[[int], None]]] = []
        if self._gripper_us is not None:
            deadlines.append((self._gripper_us, self._gripper_silent))
        if self._release_plan is not None and self._release_plan.gripper_us is not None:
            deadlines.append((self._release_plan.gripper_us, self._open_gripper))
        return deadlines

    # -------------------------------------------------------------------------- gripper

    def _gripper_requested(self, time_us: int, action: GripperAction) -> None:
        """Somebody else wants the gripper worked; that needs an autopilot, not control of it."""
        why = self._gripper_refusal(action)
        if why is not None:
            self._say(Severity.WARNING, f"gripper not worked: {why}")
            self._emit(events.RequestRefused(why, self.settings.shadow))
        else:
            half_a_period_s = 0.5 / self.settings.telemetry.attitude_hz
            self._work_gripper(time_us, action, half_a_period_s)

    def _gripper_refusal(self, action: GripperAction) -> str | None:
        """Why the gripper is not worked for somebody else."""
        if self.settings.shadow:
            return "shadow mode"
        if self._known.heartbeat is None:
            return "no heartbeat"
        return "a release is under way" if action == "release" and self._release_is_out else None

    @property
    def _release_is_out(self) -> bool:
        """The gripper has the command of a planned release, whose outcome is open."""
        return self._release_plan is not None and self._release_plan.gripper_us is None

    def _work_gripper(self, time_us: int, action: GripperAction, period_s: float) -> None:
        """Work the gripper; a known load leaves with its thrust. The next step is `period_s` away.

        A load that is being released is not released again: its thrust can be taken away only once.
        """
        if self._release_plan is not None and action == "release":
            return
        if self._release_plan is not None and not self._release_is_out:
            self._call_off_release(time_us)
        plan = self._plan_release(period_s) if action == "release" else None
        if plan is None or self._loop is None or self._awareness is None:
            self._send_gripper(time_us, action)
            return
        gripper_us = time_us + microseconds(plan.gripper_after_s)
        shows_us = time_us + microseconds(plan.shows_after_s)
        self._release_plan = Release(plan, gripper_us, shows_us, altitude_disturbance(self._loop))
        self._awareness = expect_drop(self._awareness, plan.load, shows_us)
        self._loop = with_altitude_step(
            self.settings.controller, self._loop, plan.disturbance_step, plan.shows_after_s
        )
        if gripper_us <= time_us:
            self._open_gripper(time_us)

    def _plan_release(self, period_s: float) -> ReleasePlan | None:
        payload, aware = self.settings.payload, self._awareness
        if payload is None or aware is None or aware.load is None or self.state not in SENDING:
            return None
        if not has_load(payload, aware):
            return None
        return plan_release(payload, self.settings.controller, aware.load.mass, period_s)

    def _open_gripper(self, time_us: int) -> None:
        """The command of a planned release."""
        assert self._release_plan is not None
        self._release_plan = replace(self._release_plan, gripper_us=None)
        self._send_gripper(time_us, "release")

    def _send_gripper(self, time_us: int, action: GripperAction) -> None:
        self._emit(events.SetGripper(action))
        self._gripper_us = time_us + microseconds(self.settings.sequence.gripper_timeout_s)

    def _gripper_silent(self, time_us: int) -> None:
        self._gripper_us = None
        self._say(Severity.WARNING, "gripper: no answer; is it enabled?")

    def _gripper_answered(self, time_us: int, event: events.CommandAnswered) -> None:
        """COMMAND_ACK of the gripper; a refusal takes the expected release back."""
        if event.in_progress:
            if self._gripper_us is not None:
                self._gripper_us = time_us + microseconds(self.settings.sequence.gripper_timeout_s)
            return
        self._gripper_us = None
        if not event.accepted and self._release_is_out:
            self._call_off_release(time_us)

    def _call_off_release(self, time_us: int) -> None:
        """The load stays: the disturbance is what it was."""
        release = self._release_plan
        assert release is not None
        self._release_plan = None
        if self._loop is not None:
            if not vehicle.expects_step(self._loop.controller) and time_us >= release.shows_us:
                step = release.before - altitude_disturbance(self._loop)
                self._loop = with_altitude_step(self.settings.controller, self._loop, step)
            else:
                self._loop = with_altitude_step(self.settings.controller, self._loop, 0.0)
        if self._awareness is not None and self.settings.payload is not None:
            self._awareness = call_off_drop(self.settings.payload, self._awareness)

    def _let_go(self, state: State) -> None:
        """Nothing is in the daemon's hands any more; a release whose command is not out does not happen."""
        super()._let_go(state)
        if self._release_plan is not None and self._release_plan.gripper_us is not None:
            assert self._now_us is not None
            self._call_off_release(self._now_us)
            self._say(Severity.WARNING, "release called off")
        self._release_plan = None

    # ----------------------------------------------------------------------------- load

    def _retune(self, settings: ServiceSettings) -> None:
        """Go on with other numbers; a hover thrust tells load and disturbance anew from the same thrust."""
        if self._loop is not None and self._loop.swings:
            settings = for_swinging_load(settings)
        before, self.settings = self.settings, settings
        told, self._loop = self._loop, adopt(self._loop, before, settings)
        if self._release_plan is not None and told is not None and self._loop is not None:
            moved = altitude_disturbance(self._loop) - altitude_disturbance(told)
            self._release_plan = replace(self._release_plan, before=self._release_plan.before + moved)
        if self._awareness is not None and _hover(before) != _hover(settings):
            self._awareness = weigh_anew(self._awareness)

    def _watch_payload(self, time_us: int, trace: Trace, order: Order) -> None:
        """Give the control step that was just made to payload awareness."""
        settings, known = self.settings.payload, self._known
        if settings is None:
            return
        assert known.attitude is not None and known.position is not None
        attitude, late_s = known.attitude.attitude, self.settings.telemetry.late_max_s
        old = telemetry.before_silence(self.settings.telemetry, known, trace.dt)
        carrying = None if self._loop is None else self._loop.carrying
        sample = PayloadSample(  # by place: names would cost three times as much
            time_us,
            trace.dt,
            trace.applied[3] / tilt_factor(self.settings.limits, attitude),
            attitude,
            known.position.velocity[2],
            known.position.sample_time_us != self._position_us and not old,
            order.acting and order.airborne and not self._landing(),
            carrying is not None and carrying.swings,
            max(trace.dt, trust.lateness_s(self._trust, time_us)) > late_s,
        )
        self._position_us = known.position.sample_time_us
        if self._awareness is None:
            self._awareness = begin_awareness(sample)
            return
        self._awareness, outputs = step_awareness(settings, self._awareness, sample)
        self._outputs += outputs
        if self._awareness.expected is None and self._release_plan is not None:
            self._release_plan = None  # its outcome has been announced

    def _landing(self) -> bool:
        """The ground may take part of the weight; a release just before it is still watched."""
        if (
            self._flight is None
            or self._loop is None
            or self.state is not ENGAGED
            or self._release_plan is not None
        ):
            return False
        index, scenario = self._flight.scenario.segment_index, self.settings.scenario
        height = self._loop.altitude - self._flight.scenario.ground
        low = height < self.settings.flight.slow_height_m
        return low and index < len(scenario) and isinstance(scenario[index], Land)


def _hover(settings: ServiceSettings) -> float | None:
    """What thrust is weighed with."""
    return None if settings.payload is None else settings.payload.estimator.hover_thrust
