"""kffa-offboard compare as people run it, with the bundled imitation."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from kffa_offboard.cli import main

COMPARE = [sys.executable, "-m", "kffa_offboard", "compare"]


@pytest.mark.timeout(400)  # three flights of a minute each in lock-step: a dozen seconds on a quiet machine
def test_the_imitation_flies_both_ways_and_the_page_holds_table_and_figure(tmp_path: Path) -> None:
    out = tmp_path / "out"
    only = [word for name in ("native-stock", "kffa-ladrc", "kffa-ladrc-wind") for word in ("--only", name)]
    ended = subprocess.run(
        [*COMPARE, "--full", *only, "--json", "--out", str(out)],
        capture_output=True,
        text=True,
        timeout=390,
    )
    assert ended.returncode == 0, ended.stderr
    results = json.loads(ended.stdout.splitlines()[-1])
    stock, ours, _ = (trial["load"] for trial in results["trials"])
    for event in ("pickup", "drop"):
        assert stock[event]["peak_m"] > 5.0 * ours[event]["peak_m"]
        assert stock[event]["iae_m_s"] > 5.0 * ours[event]["iae_m_s"]
    assert ours["level_rms_deg"] < 0.3
    *calm, windy = (trial["place"] for trial in results["trials"])
    assert calm == [None, None]
    assert windy["hover_rms_m"] < 0.05
    assert max(windy["pickup_peak_m"], windy["drop_peak_m"]) < 0.15
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in page
    assert f"{ours['pickup']['peak_m']:.3f}" in page
    assert "http" not in page.replace("http-equiv", "")
    assert (out / "height.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((out / "results.json").read_text()) == results


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--firmware", "/no/such/firmware"], "--firmware /no/such/firmware: no program; give the"),
        (["--only", "no-such"], "--only no-such: no such trial; choose from attitude-attitude, "),
    ],
)
def test_wrong_usage_is_one_line_and_status_2(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["compare", *options, "--out", str(tmp_path)])
    assert ended.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert said in lines[0]
