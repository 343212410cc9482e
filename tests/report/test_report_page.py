"""The page as a browser shows it, and the command that writes it."""

import re
import subprocess
from html import unescape
from typing import get_args

import pytest

from kffa_offboard.cli import main
from kffa_offboard.cli_logs import AlignName
from kffa_offboard.report.align import Alignment
from kffa_offboard.report.page import render
from kffa_offboard.report.read import read_flight

HOOK = """
<script>
(async () => {
  const wait = (until) => new Promise((resolve, reject) => {
    const began = Date.now();
    const late = () => Date.now() - began > 45000;
    const look = () => until() ? resolve() : late() ? reject("too late") : setTimeout(look, 20);
    look();
  });
  const plots = [...document.querySelectorAll(".plot")];
  const found = { plots: plots.length };
  try {
    await wait(() => window.__report_ok !== undefined);
    found.drawn = plots.filter((plot) => plot.querySelector(".trace path, .trace .point")).length;
    found.ok = window.__report_ok;
    const near = (range) => (plot) => Math.abs(plot.layout.xaxis.range[0] - range[0]) < 1e-9
      && Math.abs(plot.layout.xaxis.range[1] - range[1]) < 1e-9;
    await Plotly.relayout(plots[2], { "xaxis.range[0]": 2.5, "xaxis.range[1]": 4.5 });
    await wait(() => plots.every(near([2.5, 4.5])));
    found.linked = plots.filter(near([2.5, 4.5])).length;
    const altitude = document.getElementById("plot-altitude-tracking");
    const span = () => altitude.layout.yaxis.range.map((value) => Number(value.toFixed(3)));
    found.zoomed_values = span();
    document.querySelector("button[data-time=in]").click();
    await wait(() => plots.every(near([3, 4])));
    found.zoomed = plots.filter(near([3, 4])).length;
    document.querySelector("input[data-flight='1']").click();
    const shown = () => plots.flatMap((plot) => plot.data).filter((trace) => trace.visible !== false);
    await wait(() => shown().every((trace) => trace.meta.flight !== 1));
    found.after = shown().length > 0;
    document.querySelector("input[data-flight='1']").click();
    document.querySelector("button[data-time=all]").click();
    await wait(() => altitude.layout.xaxis.range[1] > 6);
    found.all_values = span();
    found.width = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  } catch (problem) { found.problem = String(problem); }
  document.body.dataset.found = JSON.stringify(found);
})();
</script>
"""


def opened(chromium, page, tmp_path, width=1200):
    """DOM and console of a page in a headless browser that has no network."""
    command = [chromium, "--headless", "--no-sandbox", "--disable-gpu", f"--window-size={width},900"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--enable-logging=stderr", "--dump-dom"]
    command += ["--virtual-time-budget=60000", "--host-resolver-rules=MAP * ~NOTFOUND", page.as_uri()]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=110, check=True)
    console = [line for line in ended.stderr.splitlines() if "CONSOLE" in line]
    return ended.stdout, console


@pytest.fixture
def two_flights(write_log, tmp_path):
    return [read_flight(write_log(tmp_path / f"{name}.tlog")) for name in ("first", "second")]


def test_a_browser_draws_every_plot_links_their_time_and_obeys_the_legend(chromium, two_flights, tmp_path):
    page = tmp_path / "report.html"
    page.write_text(render(two_flights, "engage").replace("</body>", HOOK + "</body>"), encoding="utf-8")

    dom, console = opened(chromium, page, tmp_path)

    found = unescape(re.search(r'data-found="([^"]*)"', dom)[1])
    count = len(re.findall(r'id="plot-[a-z]', dom))
    assert console == []
    assert count == 23
    assert found == (
        f'{{"plots":{count},"drawn":{count},"ok":true,"linked":{count},"zoomed_values":[4.894,5.006],"zoomed":{count},'
        '"after":true,"all_values":[3.94,5.06],"width":0}'
    )


def test_a_vehicle_cannot_put_elements_into_the_page(two_flights):
    page = render(two_flights, "engage")

    assert "hello <b>pilot" not in page
    assert "hello &lt;b&gt;pilot&lt;/b&gt;&lt;/script&gt;" in page


def test_the_page_fetches_nothing(two_flights):
    page = render(two_flights, "engage")

    assert "default-src 'none'" in page
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)=", page.split("plotly.js v")[0])


def test_the_command_writes_page_and_figures(write_log, tmp_path, capsys):
    log = write_log(tmp_path / "flight.tlog", end=False)

    with pytest.raises(SystemExit) as ended:
        main(["report", str(log), "--out", str(tmp_path / "r.html"), "--png", str(tmp_path / "png")])

    said = capsys.readouterr().out
    assert ended.value.code == 0
    assert "breaks off" in said
    assert (tmp_path / "r.html").stat().st_size < 8e6
    drawn = {path.name for path in (tmp_path / "png").iterdir()}
    assert drawn == {
        "altitude.png",
        "roll.png",
        "pitch.png",
        "yaw.png",
        "load.png",
        "link.png",
        "position.png",
    }
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in (tmp_path / "png").iterdir())


def test_a_log_is_never_overwritten_by_its_report(write_log, tmp_path, capsys):
    log = write_log(tmp_path / "flight.tlog")
    before = log.read_bytes()

    with pytest.raises(SystemExit) as ended:
        main(["report", str(log), "--out", str(log)])

    assert ended.value.code == 2
    assert "is what is to be read, which would be lost; name another file" in capsys.readouterr().err
    assert log.read_bytes() == before


def test_the_alignments_of_the_command_line_are_those_of_the_report():
    assert get_args(AlignName) == get_args(Alignment)
