"""What the page is made of: figures against a flight with known ones, time 0, gaps, damage."""

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.parts import without_parts
from kffa_offboard.report.align import zero_of
from kffa_offboard.report.command import distinct_names
from kffa_offboard.report.flight import Flight, FlightEvent, Line, Origin
from kffa_offboard.report.metrics import judge, stream_metrics
from kffa_offboard.report.panels import panels
from kffa_offboard.report.read import own_text, read_any, read_flight
from kffa_offboard.report.thinning import thinned, with_gaps, without_turns

GOLDEN = Path(__file__).parents[1] / "golden" / "flights"


def test_tracking_error_while_engaged_is_reference_less_measurement_yaw_the_short_way(write_log, tmp_path):
    found = judge(read_flight(write_log(tmp_path / "flight.tlog")))

    assert found.tracking_rms["roll"] == pytest.approx(0.1, rel=1e-5)
    assert found.tracking_rms["altitude"] == pytest.approx(0.1, rel=1e-5)
    assert found.tracking_rms["yaw"] == pytest.approx(0.1, rel=1e-4)  # not 2 pi - 0.1
    assert found.engaged_s == pytest.approx(8.0 - 0.01 - 2.0)
    assert found.duration_s == pytest.approx(7.99)


def test_a_load_event_is_judged_from_one_second_before_to_five_after(write_log, tmp_path):
    (load,) = judge(read_flight(write_log(tmp_path / "flight.tlog", duration_s=12.0))).loads

    assert load.event.mass_kg == 2.0
    assert load.peak_m == pytest.approx(0.1, rel=1e-5)
    assert load.peak_estimate_m == pytest.approx(0.04, rel=1e-4)
    assert load.iae_m_s == pytest.approx(0.1 * 6.0, rel=1e-4)


def test_saturation_latency_and_dropped_frames_are_those_of_the_log(write_log, tmp_path):
    found = judge(read_flight(write_log(tmp_path / "flight.tlog")))

    assert found.saturated_share["roll"] == pytest.approx(0.25, abs=0.01)
    assert found.saturated_share["pitch"] == 0.0
    assert found.latency_p50_s == pytest.approx(0.02)
    assert found.latency_p99_s == pytest.approx(0.12)
    assert found.frames_dropped == 3


def test_a_telemetry_gap_is_counted_and_does_not_count_as_jitter(write_log, tmp_path):
    found = judge(read_flight(write_log(tmp_path / "flight.tlog"))).streams["attitude"]

    assert found.gaps == 1
    assert found.longest_s == pytest.approx(0.51)
    assert found.jitter_s == pytest.approx(0.0, abs=1e-9)
    assert found.rate_hz == pytest.approx(749 / 7.99)


def test_jitter_is_the_spread_of_the_intervals(noise):
    times = np.arange(2000) * 0.01 + noise.normal(0.0, 0.001, 2000)

    found = stream_metrics(np.sort(times))

    assert found.jitter_s == pytest.approx(math.sqrt(2.0) * 0.001, rel=0.1)


def test_time_0_is_the_start_engaging_or_the_first_load(write_log, tmp_path):
    flight = read_flight(write_log(tmp_path / "flight.tlog"))

    assert zero_of(flight, "start").time_s == 0.0
    assert zero_of(flight, "engage").time_s == pytest.approx(1.0)
    assert zero_of(flight, "event").time_s == pytest.approx(4.0)


def test_flights_that_never_engaged_say_what_time_0_is_instead():
    armed = Flight("a", Origin("a"), events=(FlightEvent(3.0, "armed", "armed"),))
    silent = Flight("b", Origin("b"))

    assert zero_of(armed, "engage").time_s == 3.0
    assert "never engaged" in zero_of(armed, "engage").what
    assert "never engaged nor armed" in zero_of(silent, "engage").what
    assert "no pick-up or drop" in zero_of(silent, "event").what


def test_two_flights_lie_over_one_another_at_the_event(write_log, tmp_path):
    flights = [read_flight(write_log(tmp_path / f"{name}.tlog")) for name in "ab"]
    shifted = [zero_of(flights[0], "start").time_s, zero_of(flights[1], "event").time_s]

    altitude = next(panel for panel in panels(flights, shifted) if panel.key == "altitude-tracking")
    first = [curve.line.time_s[0] for curve in altitude.curves if curve.signal == "measured"]

    assert first == pytest.approx([0.0, -4.0])


def test_angles_are_shown_in_degrees_and_gaps_interrupt_the_line(write_log, tmp_path):
    flight = read_flight(write_log(tmp_path / "flight.tlog"))

    found = {panel.key: panel for panel in panels([flight], [0.0])}
    measured = next(curve.line for curve in found["roll-tracking"].curves if curve.signal == "measured")

    assert found["roll-tracking"].unit == "deg"
    assert measured.values[0] == pytest.approx(math.degrees(0.2), rel=1e-6)
    lost = measured.time_s[np.isnan(measured.values)]
    assert lost == pytest.approx([6.245])
    assert np.isnan(found["altitude-disturbance"].curves[0].line.values[:50]).all()


def test_pauses_between_messages_are_shown_without_the_rounding_of_sums():
    times = np.arange(300) * 0.01 + 1.03
    flight = Flight("f", Origin("f"), arrivals={"attitude": times})
    (panel,) = panels([flight], [0.5])
    assert np.all(panel.curves[0].line.values == 10.0)


def test_states_modes_arming_loads_and_texts_are_events(write_log, tmp_path):
    events = read_flight(write_log(tmp_path / "flight.tlog")).events

    assert [(event.kind, event.text) for event in events] == [
        ("state", "ready"),
        ("mode", "mode OFFBOARD"),
        ("state", "engaging"),
        ("text", "hello <b>pilot</b></script>"),
        ("armed", "armed"),
        ("state", "engaged"),
        ("load", "picked up 2.0 kg"),
    ]


def test_a_dropped_load_has_negative_mass_and_other_texts_none():
    assert own_text("dropped 4.9 kg").mass_kg == -4.9
    assert own_text("carrying 4.9 kg").kind == "text"


def test_a_log_that_breaks_off_is_shown_up_to_there(write_log, tmp_path):
    whole = write_log(tmp_path / "whole.tlog", end=False).read_bytes()
    cut = tmp_path / "cut.tlog"
    cut.write_bytes(whole[: len(whole) * 3 // 4])

    flight = read_flight(cut)

    assert flight.frames_dropped is None
    assert any("breaks off" in remark for remark in flight.remarks)
    assert any("incomplete" in remark for remark in flight.remarks)
    assert 4.0 < flight.duration_s < 7.0


def test_a_log_without_inner_signals_shows_what_was_measured(write_log, tmp_path):
    flight = read_flight(write_log(tmp_path / "station.tlog", signals=False, end=False))

    assert {quantity for quantity, _ in flight.lines} == {"measured"}
    assert flight.lines["measured", "altitude"].values[0] == pytest.approx(5.0)
    assert flight.lines["measured", "roll"].values[0] == pytest.approx(0.1)
    assert any("no inner signals" in remark for remark in flight.remarks)
    assert math.isnan(judge(flight).tracking_rms["altitude"])


def test_signals_sent_live_are_shown_beside_the_whole_telemetry():
    flight = read_flight(GOLDEN / "px4-drop.tlog.gz")
    live, whole = (len(flight.lines[quantity, "roll"]) for quantity in ("reference", "measured"))

    assert whole == pytest.approx(10 * live, rel=0.02)
    assert any("sent live, thinned" in remark for remark in flight.remarks)
    assert [event.text for event in flight.events if event.kind == "load"] == [
        "picked up 5.0 kg",
        "dropped 5.0 kg",
    ]


def test_logs_without_a_flight_are_refused_in_one_line(write_log, tmp_path):
    empty = tmp_path / "empty.tlog"
    empty.touch()
    foreign = tmp_path / "foreign.tlog"
    foreign.write_bytes(b"# not a log\n" * 10)

    with pytest.raises(UserError, match=r"empty\.tlog: is empty; there is nothing to show"):
        read_flight(empty)
    with pytest.raises(UserError, match=r"not a \.tlog"):
        read_flight(foreign)


def test_a_compressed_flight_and_its_second_part_are_one_flight(write_log, tmp_path):
    data = write_log(tmp_path / "flight.tlog").read_bytes()
    second = write_log(tmp_path / "other.tlog", duration_s=12.0, end=False, part=2).read_bytes()
    (tmp_path / "packed.tlog.gz").write_bytes(gzip.compress(data))
    (tmp_path / "packed-2.tlog.gz").write_bytes(gzip.compress(second))
    logs = [tmp_path / "packed-2.tlog.gz", tmp_path / "packed.tlog.gz", tmp_path / "packed.tlog.gz"]

    assert without_parts(logs) == [tmp_path / "packed.tlog.gz"]
    assert read_flight(logs[1]).duration_s == pytest.approx(11.99)
    remarks = read_flight(logs[0]).remarks
    assert remarks == ("is part 2 of a flight alone; name its first file to see all of it",)


def test_flights_called_alike_are_told_apart_by_their_directories(tmp_path):
    logs = [tmp_path / "a" / "flight.tlog", tmp_path / "b" / "flight.tlog", tmp_path / "own.tlog"]

    names = distinct_names(logs)

    assert len(set(names)) == 3
    assert names[2] == "own"


def test_flights_called_alike_in_one_directory_are_told_apart_by_their_suffixes(tmp_path):
    logs = [tmp_path / name for name in ("flight.tlog", "flight.ulg", "flight.BIN", "own.BIN")]
    elsewhere = tmp_path / "b" / "flight.tlog"

    assert distinct_names(logs) == ["flight.tlog", "flight.ulg", "flight.BIN", "own"]
    assert len(set(distinct_names([*logs, elsewhere]))) == 5


def test_thinning_keeps_every_extreme_and_the_ends(noise):
    values = noise.normal(size=60_000)
    values[12_345], values[54_321] = 100.0, -100.0
    found = thinned(Line(np.arange(60_000) * 0.01, values), 1000)

    assert len(found) <= 1002
    assert found.values.max() == 100.0
    assert found.values.min() == -100.0
    assert found.time_s[[0, -1]] == pytest.approx([0.0, 599.99])


def test_thinning_keeps_gaps(noise):
    values = noise.normal(size=10_000)
    values[5000:5100] = np.nan

    found = thinned(Line(np.arange(10_000) * 0.01, values), 1000)

    assert np.isnan(found.values[(found.time_s > 50.2) & (found.time_s < 50.8)]).all()


def test_a_short_line_is_drawn_as_it_is():
    line = Line(np.arange(5.0), np.arange(5.0))

    assert thinned(line, 10) is line
    assert with_gaps(line).values.tolist() == line.values.tolist()


def test_yaw_that_turns_past_half_a_circle_is_not_joined_across_the_plot():
    found = without_turns(np.arange(3.0), np.array([3.1, 3.2, 3.3]))

    assert np.isnan(found.values).tolist() == [False, True, False, False]
    assert found.values[2] == pytest.approx(3.2 - 2.0 * math.pi)


def test_a_log_of_the_autopilots_own_shows_set_points_estimates_and_the_load():
    flight = read_any(Path(__file__).parents[1] / "data" / "arducopter-pickup-drop.BIN", "copter")
    pickup, drop = (event for event in flight.events if event.kind == "load")

    assert pickup.text.startswith("pick-up of 5")
    assert drop.time_s - pickup.time_s == pytest.approx(10.0, abs=0.3)
    quantities = {quantity for quantity, channel in flight.lines if channel == "altitude"}
    assert quantities == {"measured", "estimate", "command", "disturbance"}
    assert any("written on board" in remark for remark in flight.remarks)
    assert zero_of(flight, "event").time_s == pickup.time_s


def test_a_missing_log_is_one_line(tmp_path):
    with pytest.raises(UserError, match=r"cannot read flight log .*none\.tlog: No such file"):
        read_any(tmp_path / "none.tlog", "none")


@pytest.mark.parametrize("name", ["flight.ulg", "flight.BIN"])
def test_what_is_named_like_a_log_of_the_autopilot_and_is_none_is_said_to_be_none(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(bytes(range(200)))
    with pytest.raises(UserError, match=r"no flight log that is known; give .* or a PX4 .ulg"):
        read_any(path, name)
