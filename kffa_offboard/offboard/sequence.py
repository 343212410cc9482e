"""Getting control and giving it back: requests with retries, and the order of engaging.

Engaging, the same for PX4 and ArduPilot: stream setpoints, ask for OFFBOARD until a heartbeat shows
it, then (if allowed) ask to arm until a heartbeat shows that, or wait for a person to arm. Pure
functions over frozen records; the service keeps the record and runs it at its deadline.

A command that the autopilot has accepted is not sent again: if a later heartbeat does not
agree, somebody else has decided otherwise, and asking again would fight the pilot.
"""

from __future__ import annotations

from enum import Enum
from functools import lru_cache

from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.offboard.events import HeartbeatReceived, ModeKind, Output, SetArmed, SetMode
from kffa_offboard.offboard.settings import SequenceSettings

LANDED_WITHIN_S = 3.0
"""A land detector that has not noticed the ground by then will not: ArduCopter's under attitude setpoints."""


@lru_cache(256)
def microseconds(seconds: float) -> int:
    """Seconds as whole microseconds."""
    return round(seconds * 1e6)


# ------------------------------------------------------------------------------ retries


class Retry(Struct, frozen=True, gc=False):
    """A request that is repeated until it is accepted or given up.

    Attributes
    ----------
    request : what is sent
    next_us, interval_us : next sending, and the time between two
    give_up_us : end of waiting
    accepted_us : when the autopilot accepted it; from then on it is not sent again
    undoes_open : it undoes a request that may still take effect: until it is accepted, a heartbeat that
        shows the state before is no proof
    """

    request: SetMode | SetArmed
    next_us: int
    interval_us: int
    give_up_us: int
    accepted_us: int | None = None
    undoes_open: bool = False


def begin_retry(request: SetMode | SetArmed, time_us: int, interval_s: float, timeout_s: float) -> Retry:
    """Ask for the first time at `time_us`."""
    return Retry(request, time_us, microseconds(interval_s), time_us + microseconds(timeout_s))


def retry_due(retry: Retry) -> int:
    """When the retry wants to be run next."""
    return retry.give_up_us if retry.accepted_us is not None else min(retry.next_us, retry.give_up_us)


def run_retry(retry: Retry, time_us: int) -> tuple[Retry, tuple[Output, ...], bool]:
    """The record, what is to be sent at `time_us`, and whether waiting is over."""
    if time_us >= retry.give_up_us:
        return retry, (), True
    if retry.accepted_us is not None or time_us < retry.next_us:
        return retry, (), False
    return replace(retry, next_us=time_us + retry.interval_us), (retry.request,), False


def accept_retry(retry: Retry, time_us: int) -> Retry:
    """The autopilot has accepted the request."""
    return replace(retry, accepted_us=time_us, undoes_open=False)


def refuse_disarming(retry: Retry, time_us: int) -> Retry:
    """The autopilot refuses to disarm a vehicle that stands: its land detector has `LANDED_WITHIN_S` left.

    Where a request to arm is open, refusing means nothing yet.
    """
    if not isinstance(retry.request, SetArmed) or retry.undoes_open or retry.accepted_us is not None:
        return retry
    return replace(retry, give_up_us=min(retry.give_up_us, time_us + microseconds(LANDED_WITHIN_S)))


def contradicted(settings: SequenceSettings, retry: Retry, time_us: int) -> bool:
    """A heartbeat at `time_us` that does not show the accepted state is no longer an old one."""
    if retry.accepted_us is None:
        return False
    return time_us - retry.accepted_us > microseconds(settings.confirm_grace_s)


# ----------------------------------------------------------------------------- engaging


class EngagePhase(Enum):
    """Steps of engaging, in order."""

    STREAM = "stream"
    MODE = "mode"
    ARM = "arm"
    PERSON = "person"


class Engagement(Struct, frozen=True, gc=False):
    """Where engaging is.

    Attributes
    ----------
    phase : current step
    grounded : engaging on the ground
    start_mode : the autopilot's custom_mode before; a third mode is the pilot's
    offboard : that was OFFBOARD already, in which setpoints act from the first on
    armed : the vehicle was armed at the last heartbeat
    until_us : end of STREAM or PERSON
    retry : the request of MODE or ARM
    arm_asked : the daemon has asked to arm
    """

    phase: EngagePhase
    grounded: bool
    start_mode: int
    offboard: bool
    armed: bool
    until_us: int
    retry: Retry | None = None
    arm_asked: bool = False


class EngageStep(Struct, frozen=True, gc=False):
    """Outcome: the record, what to send, and at most one of the ends.

    Attributes
    ----------
    complete : in OFFBOARD and armed
    failure : given up, why
    takeover : somebody else decided, what
    """

    engagement: Engagement
    outputs: tuple[Output, ...] = ()
    complete: bool = False
    failure: str | None = None
    takeover: str | None = None


def begin_engagement(
    settings: SequenceSettings, time_us: int, heartbeat: HeartbeatReceived, grounded: bool
) -> Engagement:
    """Start streaming at `time_us`."""
    until = time_us + microseconds(settings.stream_time_s)
    offboard = heartbeat.mode is ModeKind.OFFBOARD
    return Engagement(EngagePhase.STREAM, grounded, heartbeat.custom_mode, offboard, heartbeat.armed, until)


def engagement_due(engagement: Engagement) -> int:
    """When the engagement wants to be run next."""
    return engagement.until_us if engagement.retry is None else retry_due(engagement.retry)


def mode_granted(engagement: Engagement) -> bool:
    """The autopilot follows the daemon's setpoints, as far as is known."""
    if engagement.phase is EngagePhase.MODE:
        return engagement.retry is not None and engagement.retry.accepted_us is not None
    return engagement.phase is not EngagePhase.STREAM or engagement.offboard


def ask_no_more(settings: SequenceSettings, engagement: Engagement, time_us: int) -> Engagement:
    """Wait for a last while whether OFFBOARD, once asked for, is granted after all."""
    assert engagement.retry is not None
    until_us = time_us + microseconds(settings.hold_timeout_s)
    return replace(engagement, retry=replace(engagement.retry, next_us=until_us, give_up_us=until_us))


def run_engagement(
    settings: SequenceSettings, may_arm: bool, state: Engagement, time_us: int, heartbeat: HeartbeatReceived
) -> EngageStep:
    """Run the deadline of the engagement."""
    if state.phase is EngagePhase.STREAM:
        if heartbeat.mode is ModeKind.OFFBOARD:
            return _after_mode(settings, may_arm, state, time_us, heartbeat)
        request = SetMode(ModeKind.OFFBOARD)
        retry = begin_retry(request, time_us, settings.mode_retry_s, settings.mode_timeout_s)
        state = replace(state, phase=EngagePhase.MODE, retry=retry)
    if state.phase is EngagePhase.PERSON:
        return EngageStep(state, failure=f"nobody armed in {settings.person_arm_timeout_s:g} s")
    assert state.retry is not None
    retry, outputs, expired = run_retry(state.retry, time_us)
    state = replace(state, retry=retry)
    if not expired:
        return EngageStep(state, outputs)
    if state.phase is EngagePhase.MODE:
        return EngageStep(state, failure=f"no OFFBOARD mode in {settings.mode_timeout_s:g} s")
    return EngageStep(state, failure=f"not armed in {settings.arm_timeout_s:g} s")


def _after_mode(
    settings: SequenceSettings, may_arm: bool, state: Engagement, time_us: int, heartbeat: HeartbeatReceived
) -> EngageStep:
    """OFFBOARD is granted: done if armed, else arm or wait for a person."""
    state = replace(state, start_mode=heartbeat.custom_mode, retry=None)
    if heartbeat.armed:
        return EngageStep(state, complete=True)
    if not may_arm:
        until = time_us + microseconds(settings.person_arm_timeout_s)
        return EngageStep(replace(state, phase=EngagePhase.PERSON, until_us=until))
    retry = begin_retry(SetArmed(True), time_us, settings.arm_retry_s, settings.arm_timeout_s)
    retry, outputs, _ = run_retry(retry, time_us)
    return EngageStep(replace(state, phase=EngagePhase.ARM, retry=retry, arm_asked=True), outputs)


def heartbeat_in_engagement(
    settings: SequenceSettings, may_arm: bool, state: Engagement, time_us: int, heartbeat: HeartbeatReceived
) -> EngageStep:
    """Take in a heartbeat: progress, or somebody else's decision."""
    offboard = heartbeat.mode is ModeKind.OFFBOARD
    if state.armed and not heartbeat.armed:
        return EngageStep(state, takeover="disarmed")
    state = replace(state, armed=heartbeat.armed)
    if state.phase in (EngagePhase.STREAM, EngagePhase.MODE):
        if not offboard and heartbeat.custom_mode != state.start_mode:
            return EngageStep(state, takeover=f"mode {heartbeat.mode_name}")
        if state.phase is EngagePhase.STREAM:
            return EngageStep(state)
        if offboard:
            return _after_mode(settings, may_arm, state, time_us, heartbeat)
        assert state.retry is not None
        lost = contradicted(settings, state.retry, time_us)
        return EngageStep(state, takeover=f"mode {heartbeat.mode_name}" if lost else None)
    if not offboard or heartbeat.custom_mode != state.start_mode:
        return EngageStep(state, takeover=f"mode {heartbeat.mode_name}")
    if heartbeat.armed:
        return EngageStep(state, complete=True)
    if state.retry is not None and contradicted(settings, state.retry, time_us):
        return EngageStep(state, takeover="disarmed")
    return EngageStep(state)
