"""Parameters from connect to release: judged, set on request, put back; over a link that loses messages."""

import random
from dataclasses import dataclass, field

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.parameter_check import CheckSettings
from kffa_offboard.mavlink.parameter_file import ChangedParameter, ParameterFile
from kffa_offboard.mavlink.parameter_keeper import RESTORE_LIMIT_US, KeeperSettings, ParameterKeeper
from kffa_offboard.mavlink.parameters import decode_value, encode_value
from kffa_offboard.offboard.events import HeartbeatReceived, ModeKind
from kffa_offboard.offboard.settings import LimitSettings

CHECK = CheckSettings("rates", 0.4, LimitSettings(), False, 0.2, 1.0, 2.6)
STOCK = {"GUID_OPTIONS": 0.0, "GUID_TIMEOUT": 3.0, "ATC_ANGLE_BOOST": 1.0, "SCHED_LOOP_RATE": 400.0}
FIXED = {"GUID_OPTIONS": 8.0, "GUID_TIMEOUT": 0.5, "ATC_ANGLE_BOOST": 0.0, "SCHED_LOOP_RATE": 400.0}
REAL32, INT32 = mavlink.MAV_PARAM_TYPE_REAL32, mavlink.MAV_PARAM_TYPE_INT32
TICK_US = 50_000


@dataclass
class Bench:
    """A keeper and the parameters of a vehicle; some messages of either side are lost."""

    keeper: ParameterKeeper
    values: dict
    firmware: str = "ardupilot"
    loses: float = 0.0
    obeys: bool = True
    answers: bool = True
    armed: bool = False
    mode: ModeKind = ModeKind.OTHER
    time_us: int = 1_000_000
    dice: random.Random = field(default_factory=lambda: random.Random(7))
    sent: list = field(default_factory=list)
    checked: list = field(default_factory=list)
    texts: list = field(default_factory=list)

    def arrives(self):
        return self.dice.random() >= self.loses

    def heartbeat(self):
        beat = HeartbeatReceived(self.firmware, self.mode, "?", 0, self.armed)
        self.keeper.heartbeat(self.time_us, beat)
        self.settle()

    def settle(self):
        """Let both sides answer each other until they are silent."""
        while True:
            todo = self.keeper.take()
            if todo is None:
                return
            self.checked += todo.events
            self.texts += [announcement.text for announcement in todo.announcements]
            self.sent += todo.messages
            if not todo.messages:
                return
            for message in todo.messages:
                if self.arrives():
                    self.answer(message)

    def answer(self, message):
        if not self.answers or message.get_type() not in ("PARAM_REQUEST_READ", "PARAM_SET"):
            return
        name, encoding = message.param_id, "bytewise" if self.firmware == "px4" else "c-cast"
        if name not in self.values:
            return
        kind = INT32 if name.startswith("COM_OBL") else REAL32
        if message.get_type() == "PARAM_SET" and self.obeys:
            self.values[name] = decode_value(message.param_value, kind, encoding)
        if self.arrives():
            field_ = encode_value(self.values[name], kind, encoding)
            value = mavlink.MAVLink_param_value_message(name.encode(), field_, kind, 9, 65535)
            self.keeper.receive(self.time_us, value)

    def run(self, seconds):
        for k in range(round(seconds * 1e6 / TICK_US)):
            self.time_us += TICK_US
            if k % 20 == 0:
                self.heartbeat()
            self.keeper.advance(self.time_us)
            self.settle()

    def finish(self, seconds=8.0):
        """The service has finished; returns how long the keeper needed, s."""
        self.keeper.finish(self.time_us)
        self.settle()
        began = self.time_us
        while not self.keeper.done:
            assert self.time_us - began < seconds * 1e6
            self.run(TICK_US * 1e-6)
        return (self.time_us - began) * 1e-6

    def set_by_somebody(self, name, value):
        self.values[name] = value
        message = mavlink.MAVLink_param_value_message(name.encode(), value, REAL32, 9, 65535)
        self.keeper.receive(self.time_us, message)
        self.settle()

    @property
    def sets(self):
        return [message for message in self.sent if message.get_type() == "PARAM_SET"]

    def problems(self, severity="unsafe"):
        return [p.name for p in self.checked[-1].problems if p.severity == severity]


@pytest.fixture
def file(tmp_path):
    return ParameterFile(tmp_path / "logs" / "changed.json")


@pytest.fixture
def bench(route, file):
    def make(values=STOCK, fix=False, shadow=False, **changes):
        keeper = ParameterKeeper(route, KeeperSettings(CHECK, fix, shadow), file)
        return Bench(keeper, dict(values), **changes)

    return make


# ------------------------------------------------------------------------ judging


def test_the_service_is_told_at_the_first_heartbeat_that_it_must_wait_and_then_what_was_found(bench):
    vehicle = bench()
    vehicle.heartbeat()
    vehicle.run(3.0)
    first, *_, last = vehicle.checked
    assert not first.complete
    assert last.complete
    assert vehicle.problems() == ["GUID_OPTIONS"]
    assert vehicle.problems("warning") == ["GUID_TIMEOUT", "ATC_ANGLE_BOOST"]


def test_only_single_parameters_are_asked_for(bench):
    vehicle = bench()
    vehicle.run(3.0)
    assert {m.get_type() for m in vehicle.sent} == {"PARAM_REQUEST_READ", "COMMAND_LONG"}
    assert not vehicle.sets


def test_a_quarter_of_the_messages_may_be_lost(bench):
    vehicle = bench(FIXED, loses=0.25)
    vehicle.run(5.0)
    assert vehicle.checked[-1].complete
    assert vehicle.problems() == []


def test_a_parameter_that_this_firmware_does_not_have_is_no_problem(bench):
    vehicle = bench({"GUID_OPTIONS": 8.0})
    vehicle.run(5.0)
    assert vehicle.checked[-1].complete
    assert vehicle.checked[-1].problems == ()


def test_arducopter_that_never_answers_is_unsafe_and_px4_is_worth_a_warning(bench):
    silent = bench(answers=False)
    silent.run(8.0)
    assert silent.problems() == ["GUID_OPTIONS"]
    silent = bench(answers=False, firmware="px4")
    silent.run(8.0)
    assert silent.problems() == []
    assert "no answer" in silent.checked[-1].problems[-1].text


def test_nothing_falls_due_in_the_past_while_a_vehicle_answers_nothing(bench):
    """The service takes no step back in time: the daemon ended with a ValueError."""
    keeper = bench(STOCK, answers=False)
    for k in range(100):
        keeper.time_us += TICK_US
        if k % 20 == 0:
            keeper.heartbeat()
        keeper.keeper.advance(keeper.time_us)
        keeper.settle()
        due_us = keeper.keeper.due_us()
        assert due_us is None or due_us > keeper.time_us


def test_px4_integers_are_read_as_their_bytes(bench):
    vehicle = bench({"COM_OBL_RC_ACT": 7.0, "COM_OF_LOSS_T": 1.0}, firmware="px4")
    vehicle.run(4.0)
    assert vehicle.problems() == ["COM_OBL_RC_ACT"]


def test_a_change_by_somebody_else_is_judged_at_once(bench):
    vehicle = bench()
    vehicle.run(3.0)
    vehicle.set_by_somebody("GUID_OPTIONS", 8.0)
    assert vehicle.problems() == []
    vehicle.set_by_somebody("GUID_OPTIONS", 0.0)
    assert vehicle.problems() == ["GUID_OPTIONS"]


def test_after_a_silence_parameters_are_read_again(bench):
    vehicle = bench(FIXED)
    vehicle.run(3.0)
    vehicle.values["GUID_OPTIONS"] = 0.0  # restarted with other values
    vehicle.time_us += 4_000_000
    vehicle.run(3.0)
    assert vehicle.problems() == ["GUID_OPTIONS"]


# ------------------------------------------------------------------------ setting


def test_on_request_parameters_are_set_and_come_back_at_the_end(bench, file):
    vehicle = bench(fix=True)
    vehicle.run(3.0)
    assert vehicle.values == FIXED
    assert vehicle.problems() == vehicle.problems("warning") == []
    assert {c.name for c in file.load("ardupilot")} == {"GUID_OPTIONS", "GUID_TIMEOUT", "ATC_ANGLE_BOOST"}
    assert vehicle.finish() < 1.0
    assert vehicle.values == STOCK
    assert vehicle.keeper.changes == ()
    assert not file.path.exists()


@pytest.mark.parametrize("seed", range(5))
def test_setting_and_putting_back_survive_losses(bench, seed):
    vehicle = bench(fix=True, loses=0.2, dice=random.Random(seed))
    vehicle.run(6.0)
    vehicle.finish()
    assert vehicle.values == STOCK
    assert vehicle.keeper.changes == ()


def test_old_values_are_on_disk_before_anything_is_changed(route, bench, file):
    vehicle = bench(fix=True, obeys=False)
    seen = []
    honest = vehicle.answer

    def watch(message):
        if message.get_type() == "PARAM_SET":
            seen.append({change.name: change.old for change in file.load("ardupilot")})
        honest(message)

    vehicle.answer = watch
    vehicle.run(2.5)
    assert seen
    assert all(old == {name: STOCK[name] for name in old} and len(old) == 3 for old in seen)


def test_without_a_place_for_the_old_values_nothing_is_changed(bench, file):
    file.path.with_name(file.path.name + ".new").mkdir(parents=True)  # where the file is prepared
    vehicle = bench(fix=True)
    with pytest.raises(UserError, match="cannot keep the old parameters"):
        vehicle.run(3.0)
    assert vehicle.values == STOCK


def test_nothing_is_set_while_armed(bench):
    vehicle = bench(fix=True, armed=True)
    vehicle.run(3.0)
    assert not vehicle.sets
    assert vehicle.problems() == ["GUID_OPTIONS"]
    assert "armed: parameters stay" in vehicle.texts[0]


def test_a_vehicle_that_is_armed_meanwhile_is_set_no_further(bench, file):
    vehicle = bench(fix=True, obeys=False)
    vehicle.heartbeat()
    while not vehicle.sets:
        vehicle.run(0.05)
    vehicle.armed = True
    vehicle.heartbeat()
    vehicle.run(5.0)
    assert len(vehicle.sets) == 3
    assert "armed: parameters are not set any further" in vehicle.texts
    assert vehicle.checked[-1].complete and vehicle.problems() == ["GUID_OPTIONS"]
    assert "GUID_OPTIONS" in file.text(), "what was asked for may still be obeyed"


def test_without_the_request_and_in_shadow_nothing_is_set(bench, file):
    file.save("ardupilot", (ChangedParameter("GUID_OPTIONS", 0.0, 8.0),))
    vehicle = bench(FIXED, shadow=True)
    vehicle.run(3.0)
    assert vehicle.finish() == 0.0
    assert not vehicle.sets
    assert file.path.exists()


def test_a_vehicle_that_does_not_obey_stays_unsafe(bench):
    vehicle = bench(fix=True, obeys=False)
    vehicle.run(4.0)
    assert vehicle.problems() == ["GUID_OPTIONS"]
    vehicle.finish()
    assert vehicle.values == STOCK


# ------------------------------------------------------------------------ putting back


def test_values_wait_until_the_vehicle_is_disarmed_or_out_of_offboard(bench):
    for change in ({"armed": False}, {"mode": ModeKind.HOLD}):
        vehicle = bench(fix=True)
        vehicle.run(3.0)
        vehicle.armed, vehicle.mode = True, ModeKind.OFFBOARD
        vehicle.heartbeat()
        vehicle.keeper.finish(vehicle.time_us)
        before = len(vehicle.sets)
        vehicle.run(2.0)
        assert len(vehicle.sets) == before
        vehicle.armed = change.get("armed", True)
        vehicle.mode = change.get("mode", ModeKind.OFFBOARD)
        vehicle.run(1.5)
        assert vehicle.keeper.done
        assert vehicle.values == STOCK


def test_what_could_not_be_put_back_is_kept_on_record_and_named(bench, file):
    vehicle = bench(fix=True)
    vehicle.run(3.0)
    vehicle.answers = False
    assert vehicle.finish() <= RESTORE_LIMIT_US * 1e-6
    assert {(c.name, c.old) for c in vehicle.keeper.changes} == {
        ("GUID_OPTIONS", 0.0),
        ("GUID_TIMEOUT", 3.0),
        ("ATC_ANGLE_BOOST", 1.0),
    }
    assert {c.name for c in file.load("ardupilot")} == {c.name for c in vehicle.keeper.changes}


def test_a_vehicle_that_answers_late_is_waited_for(bench):
    vehicle = bench(fix=True)
    vehicle.run(3.0)
    vehicle.answers = False
    vehicle.keeper.finish(vehicle.time_us)
    vehicle.run(3.0)
    vehicle.answers = True
    vehicle.run(1.9)
    assert vehicle.keeper.done
    assert vehicle.values == STOCK
    assert vehicle.keeper.changes == ()


def test_a_value_that_somebody_else_set_meanwhile_is_left_alone(bench):
    vehicle = bench(fix=True)
    vehicle.run(3.0)
    vehicle.set_by_somebody("GUID_TIMEOUT", 1.0)
    vehicle.finish()
    assert vehicle.values == STOCK | {"GUID_TIMEOUT": 1.0}
    assert any("set by somebody else" in text for text in vehicle.texts)
    assert vehicle.keeper.changes == ()


def test_being_stopped_in_the_middle_of_setting_puts_back_what_was_set(bench):
    vehicle = bench(fix=True, loses=0.3)
    for _ in range(100):
        if not vehicle.sets:
            vehicle.run(TICK_US * 1e-6)
    assert vehicle.values not in (STOCK, FIXED)
    vehicle.loses = 0.0
    vehicle.finish()
    assert vehicle.values == STOCK


# ------------------------------------------------------------------------ after a crash


def test_after_a_crash_the_next_start_puts_the_old_values_back(bench, file):
    crashed = bench(fix=True)
    crashed.run(3.0)
    vehicle = bench(crashed.values)
    vehicle.run(3.0)
    assert vehicle.values == STOCK
    assert not file.path.exists()
    assert vehicle.problems() == ["GUID_OPTIONS"]


def test_after_a_crash_a_run_that_sets_them_again_still_knows_the_first_values(bench, file):
    crashed = bench(fix=True)
    crashed.run(3.0)
    vehicle = bench(crashed.values, fix=True)
    vehicle.run(3.0)
    assert vehicle.values == FIXED
    vehicle.finish()
    assert vehicle.values == STOCK
    assert not file.path.exists()


def test_after_a_crash_in_flight_nothing_changes_until_the_vehicle_is_down(bench):
    crashed = bench(fix=True)
    crashed.run(3.0)
    vehicle = bench(crashed.values, armed=True, mode=ModeKind.OFFBOARD)
    vehicle.run(3.0)
    assert vehicle.values == FIXED
    assert not vehicle.sets
    vehicle.armed = False
    vehicle.finish()
    assert vehicle.values == STOCK


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"firmware": "ardupilot", "changed": [{"name": "X"}]}'])
def test_a_damaged_record_is_reported_not_guessed_at(bench, file, text):
    file.path.parent.mkdir()
    file.path.write_text(text)
    with pytest.raises(UserError, match="by hand"):
        bench().heartbeat()


def test_a_record_of_another_firmware_is_not_applied(bench, file):
    file.save("px4", (ChangedParameter("COM_OF_LOSS_T", 2.0, 1.0),))
    with pytest.raises(UserError, match="px4, but this one runs ardupilot"):
        bench().heartbeat()


def test_the_same_inputs_ask_for_the_same_messages(bench):
    def flown():
        vehicle = bench(fix=True, loses=0.2)
        vehicle.run(4.0)
        vehicle.finish()
        return [(m.get_type(), str(m)) for m in vehicle.sent], vehicle.texts

    assert flown() == flown()
