"""The linear loop is the one that flies, and tuned loops have the margins that were asked for."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import control as oracle
import numpy as np
import pytest

from kffa_offboard.config import bundled
from kffa_offboard.config_control import ControlTable
from kffa_offboard.control import controllers
from kffa_offboard.errors import UserError
from kffa_offboard.loganalysis.link_quality import DEAD_TIME_SHIFT_S, OMEGA_C_SCALE
from kffa_offboard.loganalysis.loop_model import (
    LinearController,
    LinearSystem,
    PlantNumbers,
    closed_loop,
    frequency_response,
    open_loop,
    plant,
    step_response,
)
from kffa_offboard.loganalysis.margins import Wanted, frequencies, margins
from kffa_offboard.loganalysis.tune import allowed_bandwidths, parameters_of, tune
from kffa_offboard.loganalysis.tune_altitude import DROP_M_S2, AltitudeSearch, Candidate
from kffa_offboard.loganalysis.tune_command import control_of, run_tune
from kffa_offboard.loganalysis.tune_figure import about_minus_180
from kffa_offboard.offboard.settings import LimitSettings

PERIOD_S = 0.01
ALTITUDE = PlantNumbers(b0=24.6, damping=0.0, stiffness=0.0, delay_s=0.0525, lag_s=0.05)
CONTROL = ControlTable.model_validate(
    {"altitude": {"hover_thrust": 0.3986, "delay_s": 0.0525, "lag_s": 0.05, "omega_c": 3.0, "omega_o": 30.0}}
)


def test_the_linear_loop_recovers_from_a_load_as_the_controller_itself_does() -> None:
    base = LinearController.of(parameters_of(CONTROL), PERIOD_S)
    vehicle = plant(ALTITUDE, PERIOD_S)
    predicted = step_response(closed_loop(base.system(3), vehicle), 2.0)
    state = controllers.initial_state(base.parameters, np.zeros(4), np.zeros(4))
    x, flown = np.zeros(len(vehicle.a)), []
    for _ in range(len(predicted)):
        y = vehicle.c @ x
        measured, rate = np.array([0.0, 0.0, 0.0, y[0]]), np.array([0.0, 0.0, 0.0, y[1]])
        inputs = controllers.ControllerInput(np.zeros(4), measured, np.ones(4, dtype=bool), rate)
        state, output = controllers.step(base.parameters, state, inputs, PERIOD_S)
        x = vehicle.a @ x + vehicle.b @ np.array([output.command[3], 1.0])
        flown.append(y[0])
    assert np.max(np.abs(flown)) > 0.02
    assert np.allclose(flown, predicted, atol=0.01 * np.max(np.abs(flown)))


def test_the_held_command_moves_the_plant_as_a_fine_simulation_says() -> None:
    vehicle, fine = plant(ALTITUDE, PERIOD_S), 1e-5
    commands = np.sign(np.sin(np.arange(40) * 0.7))
    x = np.zeros(len(vehicle.a))
    for command in commands:
        x = vehicle.a @ x + vehicle.b @ np.array([command, 0.0])
    y = rate = motor = 0.0
    for k in range(round(len(commands) * PERIOD_S / fine)):
        slot = int((k * fine - ALTITUDE.delay_s + 1e-9) // PERIOD_S)
        acting = commands[slot] if slot >= 0 else 0.0
        y, rate = y + fine * rate, rate + fine * ALTITUDE.b0 * motor
        motor += fine * (acting - motor) / ALTITUDE.lag_s
    assert np.allclose(vehicle.c @ x, [y, rate], rtol=2e-3)


def test_margins_are_those_of_python_control() -> None:
    base = LinearController.of(parameters_of(CONTROL), PERIOD_S)
    loop = open_loop(base.system(3), plant(ALTITUDE, PERIOD_S))
    ours = margins(frequencies(PERIOD_S), frequency_response(loop, frequencies(PERIOD_S)))
    system = oracle.StateSpace(loop.a, loop.b, loop.c, loop.d, loop.period_s)
    fine = np.geomspace(0.1, 300.0, 4000)
    response = oracle.frequency_response(system, fine)
    gains, phases, *_ = oracle.stability_margins(response, returnall=True)
    nearest = np.min(np.abs(20.0 * np.log10(gains)))
    assert ours.gain_db == pytest.approx(nearest, abs=0.2)
    assert ours.phase_deg == pytest.approx(np.min(np.abs(phases)), abs=1.0)


@pytest.fixture(scope="module")
def model() -> dict[str, dict[str, object]]:
    return {
        "altitude": {"hover_thrust": 0.3986, "delay_s": 0.0525, "lag_s": 0.05},
        "rates": {"roll": {"rate_time_constant_s": 0.07, "delay_s": 0.055}},
    }


def test_tuned_channels_have_the_margins_and_no_others_are_touched(
    model: dict[str, dict[str, object]],
) -> None:
    control, channels = control_of(model, "model.toml")
    assert channels == (0, 3)
    wanted = Wanted(6.0, 30.0, 0.02)
    for tuned in tune(control, channels, PERIOD_S, wanted).channels:
        assert tuned.margins.gain_db >= 6.0
        assert tuned.margins.phase_deg >= 30.0
        assert tuned.margins.delay_s >= 0.02
        assert 2.0 * tuned.omega_c < tuned.omega_o


def test_more_margin_costs_bandwidth() -> None:
    quick = allowed_bandwidths(0.05, 0.05, PERIOD_S, Wanted(6.0, 30.0, 0.02))
    calm = allowed_bandwidths(0.05, 0.05, PERIOD_S, Wanted(6.0, 45.0, 0.02))
    assert calm.disturbance_area > 1.5 * quick.disturbance_area


@pytest.mark.parametrize(("delay_s", "period_s"), [(0.03, 0.05), (0.06, 0.01), (0.1, 0.05)])
def test_the_rule_of_the_link_verdict_stays_inside_what_the_loop_allows(
    delay_s: float, period_s: float
) -> None:
    dead = delay_s + 0.5 * period_s
    allowed = allowed_bandwidths(delay_s, 0.05, period_s, Wanted(6.0, 30.0, 0.02))
    assert OMEGA_C_SCALE / (dead - DEAD_TIME_SHIFT_S) <= 1.1 * allowed.omega_c


def test_margins_that_nothing_has_are_refused_with_the_remedy() -> None:
    with pytest.raises(UserError, match="smaller margins"):
        allowed_bandwidths(0.4, 0.05, 0.02, Wanted(12.0, 70.0, 0.2))


def test_the_filter_of_a_candidate_is_at_rest_where_the_filter_that_flies_comes_to_rest() -> None:
    table = {
        **CONTROL.altitude.model_dump(exclude_unset=True),
        "measurement_noise_m": 0.01,
        "disturbance_intensity": 700.0,
    }
    other = LinearController.of(parameters_of(ControlTable.model_validate({"altitude": table})), PERIOD_S)
    moved = LinearController.of(parameters_of(CONTROL), PERIOD_S).with_filter(3, 0.01**2, 700.0)
    assert moved.settled.kalman is not None and other.settled.kalman is not None
    for there, here in zip(moved.settled.kalman.spreads, other.settled.kalman.spreads, strict=True):
        assert np.allclose(there.covariance.matrix, here.covariance.matrix, rtol=1e-3)


@pytest.fixture(scope="module")
def search() -> AltitudeSearch:
    """Of the demonstration's vehicle and link, with its sensors' noise."""
    noise = {"measurement_noise_m": 0.01, "climb_rate_noise_m_s": 0.02}
    table = ControlTable.model_validate(
        {"altitude": {**CONTROL.altitude.model_dump(exclude_unset=True), **noise}}
    )
    return AltitudeSearch(LinearController.of(parameters_of(table), PERIOD_S), ALTITUDE, 0.3986)


@pytest.fixture(scope="module")
def calm(search: AltitudeSearch) -> Candidate:
    return search.calmest(0.08, Wanted())


def test_a_peak_of_8_cm_leaves_more_than_4_decibels_27_degrees_and_35_ms(calm: Candidate) -> None:
    assert calm.peak <= 0.08
    assert calm.margins.meet(Wanted(4.7, 27.0, 0.035))
    assert calm.thrust_noise <= 0.1 * 0.3986


def test_all_default_margins_cost_a_peak_of_more_than_12_cm(search: AltitudeSearch) -> None:
    found = search.quickest(Wanted())
    assert found.margins.meet(Wanted())
    assert 0.12 < found.peak < 0.2


@pytest.mark.parametrize(("change_db", "stays"), [(-0.5, True), (0.5, False)])
def test_the_controller_itself_oscillates_where_gain_and_delay_margin_say(
    calm: Candidate, change_db: float, stays: bool
) -> None:
    """Its own steps, with a vehicle whose thrust is stronger by the margin, then with one that is later."""
    margins = calm.margins
    stronger = replace(ALTITUDE, b0=ALTITUDE.b0 * 10.0 ** ((margins.gain_db + change_db) / 20.0))
    later = replace(ALTITUDE, delay_s=ALTITUDE.delay_s + margins.delay_s + 0.002 * np.sign(change_db))
    for vehicle in (stronger, later):
        first, last = swings(calm, plant(vehicle, PERIOD_S))
        assert bool(last < first) == stays


def swings(found: Candidate, vehicle: LinearSystem) -> tuple[float, float]:
    """Largest output in two later stretches of a flight with `controllers.step` after a kick."""
    base = (
        LinearController.of(parameters_of(CONTROL), PERIOD_S)
        .with_filter(3, found.measurement_noise**2, found.disturbance_intensity)
        .with_prediction(3, found.prediction_s)
        .with_bandwidths(np.full(4, found.omega_c), np.full(4, found.omega_o))
    )
    state, x, flown = base.settled, np.zeros(len(vehicle.a)), []
    x[1] = 0.1
    for _ in range(600):
        y = vehicle.c @ x
        measured, rate = np.array([0.0, 0.0, 0.0, y[0]]), np.array([0.0, 0.0, 0.0, y[1]])
        inputs = controllers.ControllerInput(np.zeros(4), measured, np.ones(4, dtype=bool), rate)
        state, output = controllers.step(base.parameters, state, inputs, PERIOD_S)
        x = vehicle.a @ x + vehicle.b @ np.array([output.command[3], 0.0])
        flown.append(abs(y[0]))
    return max(flown[200:300]), max(flown[500:])


def altitude_loop(
    file: str, period_s: float, link_s: float, delay_s: float
) -> tuple[LinearSystem, LinearSystem]:
    """Controller of a bundled configuration, told of a link slower by `link_s`, and motors of 50 ms."""
    given = tomllib.loads(bundled(file).read_text(encoding="utf-8"))["control"]
    for key in ("delay_s", "prediction_s"):
        given["altitude"][key] += link_s
    control, _ = control_of(given, file)
    settings = control.settings(LimitSettings())
    base = LinearController.of(parameters_of(control), period_s)
    vehicle = PlantNumbers(9.80665 / control.altitude.hover_thrust, 0.0, 0.0, delay_s + link_s, 0.05)
    return base.with_bandwidths(settings.omega_c, settings.omega_o).system(3), plant(vehicle, period_s)


@pytest.mark.parametrize(
    ("file", "delay_s", "wanted", "peak_m"),
    [
        ("compare-ardupilot.toml", 0.02, Wanted(3.7, 32.0, 0.029), 0.027),
        ("compare-ardupilot.toml", 0.028, Wanted(4.0, 24.0, 0.021), 0.03),
        ("compare-px4.toml", 0.02, Wanted(4.8, 29.0, 0.025), 0.025),
        ("compare-px4.toml", 0.03, Wanted(3.9, 17.0, 0.015), 0.03),
    ],
)
def test_the_altitude_loop_for_a_real_autopilot_keeps_its_margins_and_moves_by_less_than_3_cm(
    file: str, delay_s: float, wanted: Wanted, peak_m: float
) -> None:
    """A delay between the one that was identified and the one that flights show, or 10 ms more."""
    loop, vehicle = altitude_loop(file, PERIOD_S, 0.0, delay_s)
    omega = frequencies(PERIOD_S)
    assert margins(omega, frequency_response(open_loop(loop, vehicle), omega)).meet(wanted)
    moved = DROP_M_S2 * np.abs(step_response(closed_loop(loop, vehicle), 2.0))
    assert moved.max() < peak_m


@pytest.mark.parametrize(
    ("period_s", "link_s", "wanted"),
    [(0.01, 0.05, Wanted(2.0, 16.0, 0.021)), (0.02, 0.0, Wanted(3.5, 28.0, 0.024))],
    ids=["60 ms link delay", "50 Hz telemetry"],
)
def test_the_altitude_loop_for_a_real_px4_has_margin_over_a_slow_link_and_with_half_the_telemetry(
    period_s: float, link_s: float, wanted: Wanted
) -> None:
    loop, vehicle = altitude_loop("compare-px4.toml", period_s, link_s, 0.02)
    omega = frequencies(period_s)
    assert margins(omega, frequency_response(open_loop(loop, vehicle), omega)).meet(wanted)


@pytest.mark.parametrize("turns", [-1, 0, 1])
def test_the_drawn_phase_margin_stands_on_minus_180_degrees_whatever_the_turns(turns: int) -> None:
    phase = np.array([-266.0, -134.0, -400.0])
    assert about_minus_180(phase + 360.0 * turns, -134.0 + 360.0 * turns) == pytest.approx(phase)


def test_tune_writes_tables_that_load_and_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "model.toml"
    file.write_text("[control.rates.roll]\nrate_time_constant_s = 0.07\ndelay_s = 0.055\n")
    for _ in range(2):  # the second time over its own results
        assert run_tune(file, Wanted(), PERIOD_S, tmp_path / "out", False) == 0
    with pytest.raises(UserError, match="is what is to be read, which would be lost"):
        run_tune(tmp_path / "out" / "tuned.toml", Wanted(), PERIOD_S, tmp_path / "out", False)
    assert "roll" in capsys.readouterr().out
    tuned = tomllib.loads((tmp_path / "out" / "tuned.toml").read_text())
    control, _ = control_of(tuned["control"], "tuned.toml")
    assert control.rates.roll.omega_c > 1.0
    assert (tmp_path / "out" / "loops.png").stat().st_size > 10_000


def test_every_wrong_value_of_a_model_is_a_line_with_key_value_and_limit() -> None:
    given = {"altitude": {"hover_thrust": 0.0, "delay_s": 2.0}}
    with pytest.raises(UserError) as refused:
        control_of(given, "model.toml")
    assert sorted(str(refused.value).splitlines()) == [
        "model.toml: control.altitude.delay_s = 2.0: is above 0.5 s; were these milliseconds?",
        "model.toml: control.altitude.hover_thrust = 0.0: must be at least 0.05 of full thrust",
    ]
