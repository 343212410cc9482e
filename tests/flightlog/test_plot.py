"""The inner signals for plotting programs: the same names live and from a log, and nothing but numbers."""

import csv
import json
import math

import pytest
from msgspec.structs import replace

from kffa_offboard import cli
from kffa_offboard.config import bundled
from kffa_offboard.flightlog.notes import Header
from kffa_offboard.flightlog.plot import PlotStream
from kffa_offboard.flightlog.signals import BLOCKS, LIVE_ARRAY_ID, to_message
from kffa_offboard.flightlog.writer import TlogWriter
from kffa_offboard.frame_codec import pack
from kffa_offboard.offboard.events import OwnHeartbeat, PayloadReport, Signals
from kffa_offboard.trials.processes import free_port

START_US = 1_700_000_000_250_000
CHANNELS = ("roll", "pitch", "yaw", "altitude")
STEP = Signals(
    START_US,
    "engaged",
    **{name: tuple(b + c / 4.0 for c in range(4)) for b, name in enumerate(BLOCKS)},
    saturated=(False, False, False, True),
    dt=0.01,
    latency_s=0.0625,
)


def sent(*items, vehicle=""):
    datagrams = []
    stream = PlotStream(datagrams.append, vehicle)
    for item in items:
        stream(START_US, item)
    return [json.loads(data) for data in datagrams]


def test_a_control_step_is_one_object_with_every_signal_of_every_channel():
    (step,) = sent(STEP)
    assert step["timestamp"] == START_US / 1e6
    for b, name in enumerate(BLOCKS):
        for c, channel in enumerate(CHANNELS):
            assert step[f"{channel}/{name}"] == b + c / 4.0
    assert [step[f"{channel}/saturated"] for channel in CHANNELS] == [0.0, 0.0, 0.0, 1.0]
    assert (step["state"], step["dt"], step["latency_s"]) == (3.0, 0.01, 0.0625)


def test_what_is_not_a_number_is_left_out_because_plotjuggler_stops_at_it():
    odd = replace(STEP, latency_s=math.nan, disturbance=(math.inf, 0.0, -math.inf, 1.0))
    (step,) = sent(odd)
    assert not {"latency_s", "roll/disturbance", "yaw/disturbance"} & set(step)
    assert step["altitude/disturbance"] == 1.0


def test_place_load_and_vehicle_have_names_of_their_own():
    step, load = sent(
        replace(STEP, position_reference=(1.5, -2.0)), PayloadReport(START_US, 5.0, 0.25), vehicle="north"
    )
    assert (step["north/x/reference"], step["north/y/reference"]) == (1.5, -2.0)
    assert load == {"timestamp": START_US / 1e6, "north/payload/mass_kg": 5.0, "north/payload/std_kg": 0.25}


def test_what_is_no_signal_is_not_sent():
    assert sent(OwnHeartbeat("active")) == []


def write_log(path, steps, part=1):
    with TlogWriter(path, header=Header("1.2.3", {}, {}, part=part)) as log:
        log.write_begin(START_US)
        for step in steps:
            log.write_signals(step)
    return path


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def exported(*arguments):
    with pytest.raises(SystemExit) as ended:
        cli.main(["export", *map(str, arguments)])
    return ended.value.code


def named_by_plotjuggler(datagram):
    """Its JSON reader flattens an object without a topic, each name after a slash; `timestamp` is time."""
    return {f"/{name}": value for name, value in datagram.items() if name != "timestamp"}


def test_a_log_is_exported_with_the_times_of_the_live_stream_and_plotjuggler_s_names_for_it(tmp_path, capsys):
    steps = [STEP, replace(STEP, time_us=START_US + 10_001, latency_s=math.nan)]
    log = write_log(tmp_path / "flight.tlog", steps)
    assert exported(log) == 0
    rows = rows_of(tmp_path / "flight.csv")
    assert [row["timestamp"] for row in rows] == ["1700000000.250000", "1700000000.260001"]
    for row, step in zip(rows, steps, strict=True):
        live = named_by_plotjuggler(*sent(step))
        assert {name: float(row[name]) for name in live} == pytest.approx(live, rel=1e-6)
        assert {name for name in row if row[name] == ""} == set(row) - {*live, "timestamp"}
    assert "2 control steps, 0.0 s" in capsys.readouterr().out


def test_the_export_goes_on_through_the_further_files_of_a_flight(tmp_path):
    write_log(tmp_path / "long.tlog", [STEP])
    write_log(tmp_path / "long-2.tlog", [replace(STEP, time_us=START_US + 10_000)], part=2)
    assert exported(tmp_path / "long.tlog", "--out", tmp_path / "whole.csv") == 0
    assert len(rows_of(tmp_path / "whole.csv")) == 2


def test_the_export_makes_its_directory_and_never_writes_over_the_log(tmp_path, capsys):
    log = write_log(tmp_path / "flight.tlog", [STEP])
    part = write_log(tmp_path / "flight-2.tlog", [STEP], part=2)
    recorded = log.read_bytes(), part.read_bytes()
    assert exported(log, "--out", tmp_path / "new" / "flight.csv") == 0
    assert len(rows_of(tmp_path / "new" / "flight.csv")) == 2
    for target in (log, part):
        assert exported(log, "--out", target) == 2
        assert f"--out {target}: is what is to be read" in capsys.readouterr().err
    assert (log.read_bytes(), part.read_bytes()) == recorded


def test_of_a_ground_station_s_log_the_live_signals_are_exported(tmp_path):
    path = tmp_path / "ground.tlog"
    with TlogWriter(path) as log:
        log.write(START_US + 5_000, pack(to_message(STEP, LIVE_ARRAY_ID), 245, 191, 0))
    assert exported(path) == 0
    (row,) = rows_of(tmp_path / "ground.csv")
    assert float(row["/altitude/estimate"]) == STEP.estimate[3]


def test_a_log_without_signals_is_refused_with_the_reason(tmp_path, capsys):
    path = write_log(tmp_path / "empty.tlog", [])
    assert exported(path) == 2
    assert "no inner signals" in capsys.readouterr().err
    assert not (tmp_path / "empty.csv").exists()


@pytest.mark.parametrize("url", ["udpin:127.0.0.1:9870", "serial:/dev/ttyS0:57600", "127.0.0.1:9870"])
def test_signals_go_out_over_udp_only(url, capsys):
    config = str(bundled("px4-udp.toml"))
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "--config", config, "--link", f"udpin:127.0.0.1:{free_port()}", "--plot", url])
    assert ended.value.code == 2
    assert "udpout:HOST:PORT" in capsys.readouterr().err
