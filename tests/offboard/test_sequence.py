"""Requests with retries, and the order of engaging, step by step: what is asked when, and who has decided."""

import pytest
from msgspec.structs import replace

from kffa_offboard.offboard import sequence
from kffa_offboard.offboard.events import HeartbeatReceived, ModeKind, SetArmed, SetMode
from kffa_offboard.offboard.sequence import EngagePhase, accept_retry, begin_retry, run_retry
from kffa_offboard.offboard.settings import SequenceSettings

START_US = 7_000_000
SETTINGS = SequenceSettings(
    stream_time_s=0.3, mode_retry_s=0.5, mode_timeout_s=1.2, arm_retry_s=1.0, arm_timeout_s=2.5
)
OFFBOARD, ARM = SetMode(ModeKind.OFFBOARD), SetArmed(True)
GUIDED, GUIDED_NOGPS, LOITER, BRAKE = 4, 20, 5, 17


def heard(custom_mode, armed=False):
    kind = {GUIDED: ModeKind.OFFBOARD, GUIDED_NOGPS: ModeKind.OFFBOARD, BRAKE: ModeKind.HOLD}
    names = {GUIDED: "GUIDED", GUIDED_NOGPS: "GUIDED_NOGPS", LOITER: "LOITER", BRAKE: "BRAKE"}
    return HeartbeatReceived(
        "ardupilot", kind.get(custom_mode, ModeKind.OTHER), names[custom_mode], custom_mode, armed
    )


def test_seconds_are_whole_microseconds_to_the_nearest():
    assert sequence.microseconds(4.1) == 4_100_000  # 4.1 * 1e6 is a little less
    assert sequence.microseconds(0.25) == 250_000


# ------------------------------------------------------------------------------ retries


def test_a_request_goes_out_at_once_then_at_each_interval_until_its_time_is_over():
    retry = begin_retry(OFFBOARD, START_US, 0.5, 1.2)
    due, sent = [], []
    for _ in range(4):
        due.append(sequence.retry_due(retry) - START_US)
        retry, outputs, over = run_retry(retry, sequence.retry_due(retry))
        sent.append((outputs, over))
    assert due == [0, 500_000, 1_000_000, 1_200_000]
    assert sent == [((OFFBOARD,), False)] * 3 + [((), True)]


def test_between_two_intervals_nothing_is_sent_and_a_late_one_delays_the_next():
    retry, _, _ = run_retry(begin_retry(OFFBOARD, START_US, 0.5, 9.0), START_US)
    assert run_retry(retry, START_US + 499_999) == (retry, (), False)
    retry, outputs, _ = run_retry(retry, START_US + 700_000)
    assert outputs == (OFFBOARD,) and sequence.retry_due(retry) == START_US + 1_200_000


def test_what_is_accepted_is_not_sent_again_and_still_has_an_end():
    retry, _, _ = run_retry(begin_retry(OFFBOARD, START_US, 0.5, 1.2), START_US)
    retry = accept_retry(replace(retry, undoes_open=True), START_US + 100_000)
    assert not retry.undoes_open, "and what it was to undo is settled"
    assert sequence.retry_due(retry) == START_US + 1_200_000
    assert run_retry(retry, START_US + 1_199_999) == (retry, (), False)
    assert run_retry(retry, START_US + 1_200_000) == (retry, (), True)


def test_a_heartbeat_contradicts_an_accepted_request_when_it_cannot_be_an_old_one_any_more():
    asked = begin_retry(OFFBOARD, START_US, 0.5, 5.0)
    assert not sequence.contradicted(SETTINGS, asked, START_US + 4_000_000), "nobody has accepted it"
    accepted = accept_retry(asked, START_US)
    assert not sequence.contradicted(SETTINGS, accepted, START_US + 300_000)
    assert sequence.contradicted(SETTINGS, accepted, START_US + 300_001)


# ------------------------------------------------------------------------- engaging, at its deadlines


def begun(custom_mode=LOITER, armed=False, grounded=True):
    return sequence.begin_engagement(SETTINGS, START_US, heard(custom_mode, armed), grounded)


def run(state, heartbeat, may_arm=True):
    """Run the deadline at its time."""
    due_us = sequence.engagement_due(state)
    return due_us - START_US, sequence.run_engagement(SETTINGS, may_arm, state, due_us, heartbeat)


def asked_for_mode(**begin):
    _, step = run(begun(**begin), heard(LOITER))
    assert step.engagement.phase is EngagePhase.MODE
    return step.engagement


def asked_to_arm(custom_mode=GUIDED):
    state = asked_for_mode()
    return sequence.heartbeat_in_engagement(SETTINGS, True, state, START_US + 400_000, heard(custom_mode))


def accepted(state, time_us):
    return replace(state, retry=accept_retry(state.retry, time_us))


def test_setpoints_are_streamed_first_and_then_the_mode_is_asked_for_until_it_is_given_up():
    state, seen = begun(), []
    for _ in range(4):
        time_us, step = run(state, heard(LOITER))
        state = step.engagement
        seen.append((time_us, step.outputs, step.failure))
    assert seen == [
        (300_000, (OFFBOARD,), None),
        (800_000, (OFFBOARD,), None),
        (1_300_000, (OFFBOARD,), None),
        (1_500_000, (), "no OFFBOARD mode in 1.2 s"),
    ]
    assert not step.complete


def test_a_vehicle_that_is_in_offboard_already_is_not_asked_for_the_mode():
    _, step = run(begun(GUIDED, armed=True), heard(GUIDED, armed=True))
    assert step.complete and step.outputs == () and not step.engagement.arm_asked
    _, step = run(begun(GUIDED), heard(GUIDED))
    assert step.outputs == (ARM,) and step.engagement.arm_asked


def test_arming_is_asked_for_until_it_is_given_up():
    step = asked_to_arm()
    assert (step.outputs, step.engagement.phase) == ((ARM,), EngagePhase.ARM)
    assert step.engagement.arm_asked and not step.complete
    state, seen = step.engagement, []
    for _ in range(3):
        time_us, step = run(state, heard(GUIDED))
        state = step.engagement
        seen.append((time_us, step.outputs, step.failure))
    assert seen == [
        (1_400_000, (ARM,), None),
        (2_400_000, (ARM,), None),
        (2_900_000, (), "not armed in 2.5 s"),
    ]


def test_who_must_not_arm_waits_a_minute_for_a_person():
    state = asked_for_mode()
    step = sequence.heartbeat_in_engagement(SETTINGS, False, state, START_US + 400_000, heard(GUIDED))
    assert step.outputs == () and step.engagement.phase is EngagePhase.PERSON
    assert not step.engagement.arm_asked
    time_us, given_up = run(step.engagement, heard(GUIDED), may_arm=False)
    assert (time_us, given_up.failure) == (60_400_000, "nobody armed in 60 s")
    assert not given_up.complete
    armed = sequence.heartbeat_in_engagement(
        SETTINGS, False, step.engagement, START_US + 500_000, heard(GUIDED, armed=True)
    )
    assert armed.complete and armed.outputs == ()


def test_a_release_that_waits_for_the_answer_asks_no_more_and_waits_two_seconds():
    state = sequence.ask_no_more(SETTINGS, asked_for_mode(), START_US + 400_000)
    time_us, step = run(state, heard(LOITER))
    assert (time_us, step.outputs) == (2_400_000, ())
    assert step.failure is not None


def test_the_autopilot_follows_once_it_is_in_offboard_or_has_accepted_that():
    assert not sequence.mode_granted(begun())
    assert sequence.mode_granted(begun(GUIDED)), "there setpoints act from the first on"
    asked = asked_for_mode()
    assert not sequence.mode_granted(asked)
    assert sequence.mode_granted(accepted(asked, START_US + 400_000))
    assert sequence.mode_granted(asked_to_arm().engagement)
    waits = sequence.heartbeat_in_engagement(SETTINGS, False, asked, START_US + 400_000, heard(GUIDED))
    assert sequence.mode_granted(waits.engagement)


# --------------------------------------------------------------------------- engaging, by heartbeats


def beat(state, time_s, heartbeat):
    """What a heartbeat so long after the start changes: who has taken over, and whether it is done."""
    step = sequence.heartbeat_in_engagement(
        SETTINGS, True, state, START_US + sequence.microseconds(time_s), heartbeat
    )
    return step.takeover, step.complete


@pytest.mark.parametrize("state", [begun(), asked_for_mode()])
def test_until_it_is_granted_the_mode_of_before_is_nobodys_decision_and_a_third_one_is(state):
    assert beat(state, 0.4, heard(LOITER)) == (None, False)
    assert beat(state, 0.4, heard(BRAKE)) == ("mode BRAKE", False)


def test_offboard_that_shows_while_setpoints_are_only_streamed_is_waited_for():
    step = sequence.heartbeat_in_engagement(SETTINGS, True, begun(), START_US + 100_000, heard(GUIDED))
    assert (step.takeover, step.outputs, step.engagement.phase) == (None, (), EngagePhase.STREAM)


def test_a_granted_mode_that_a_later_heartbeat_does_not_show_was_taken_back():
    state = accepted(asked_for_mode(), START_US + 400_000)
    assert beat(state, 0.7, heard(LOITER)) == (None, False)
    assert beat(state, 0.700001, heard(LOITER)) == ("mode LOITER", False)


@pytest.mark.parametrize("state", [begun(armed=True), asked_for_mode(armed=True)])
def test_who_disarms_while_control_is_being_taken_has_decided(state):
    assert beat(state, 0.4, heard(LOITER)) == ("disarmed", False)


@pytest.mark.parametrize("state", [begun(), asked_for_mode()])
def test_who_arms_meanwhile_and_disarms_again_has_decided_too(state):
    step = sequence.heartbeat_in_engagement(SETTINGS, True, state, START_US + 400_000, heard(LOITER, True))
    assert step.takeover is None
    assert beat(step.engagement, 0.5, heard(LOITER)) == ("disarmed", False)


def test_a_vehicle_that_is_armed_has_control_taken_with_the_mode():
    assert beat(asked_for_mode(armed=True), 0.4, heard(GUIDED, armed=True)) == (None, True)


@pytest.mark.parametrize(
    ("granted", "shown", "takeover"),
    [
        (GUIDED, LOITER, "mode LOITER"),  # the one of before
        (GUIDED, GUIDED_NOGPS, "mode GUIDED_NOGPS"),  # another mode of the same kind
        (GUIDED_NOGPS, GUIDED_NOGPS, None),
        (GUIDED, GUIDED, None),
    ],
)
@pytest.mark.parametrize("armed", [True, False])
def test_once_granted_only_that_mode_keeps_control(granted, shown, takeover, armed):
    state = asked_to_arm(granted).engagement
    assert beat(state, 0.5, heard(shown, armed)) == (takeover, armed and takeover is None)


def test_arming_that_was_accepted_and_does_not_show_was_undone_by_somebody():
    asked = asked_to_arm().engagement
    assert beat(asked, 2.0, heard(GUIDED)) == (None, False), "it has not been accepted"
    armed = accepted(asked, START_US + 500_000)
    assert beat(armed, 0.8, heard(GUIDED)) == (None, False)
    assert beat(armed, 0.800001, heard(GUIDED)) == ("disarmed", False)
