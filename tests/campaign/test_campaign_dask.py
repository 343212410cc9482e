"""A campaign on a Dask cluster of two workers on loopback, one of which is killed."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kffa_offboard
from kffa_offboard.campaign import engine
from kffa_offboard.campaign.engine import run_dask
from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.campaign.store import Store
from kffa_offboard.campaign.task import run, tasks
from kffa_offboard.errors import UserError

distributed: Any = pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

STARTED_S = 60.0


@contextmanager
def worker(scheduler: str, directory: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A worker process of its own, without a nanny that would start it again."""
    options = ["--no-nanny", "--nthreads", "1", "--no-dashboard", "--local-directory", str(directory)]
    options += ["--host", "127.0.0.1", "--death-timeout", "60"]
    process = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", scheduler, *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    with distributed.LocalCluster(
        n_workers=0, host="127.0.0.1", scheduler_port=0, dashboard_address=None, protocol="tcp"
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.timeout(300)  # two interpreters start on a machine that may be busy
def test_a_killed_worker_loses_nothing_and_nothing_counts_twice(
    scheduler: str, shortened: Callable[..., Campaign], tmp_path: Path
) -> None:
    campaign = shortened({"flight": {"settle_s": 2.5}}, "kffa-ladrc")  # long enough to be caught flying
    flights, width = 40, 4
    work = list(tasks(campaign, flights, width))
    store = Store(tmp_path / "out", campaign)
    came = []
    with ExitStack() as stack:
        workers = [stack.enter_context(worker(scheduler, tmp_path / str(k))) for k in range(2)]
        client = stack.enter_context(distributed.Client(scheduler, set_as_default=False))
        client.wait_for_workers(2, timeout=STARTED_S)
        pids = client.run(os.getpid)
        for task, table in run_dask(campaign, work, scheduler):
            came.append(task)
            store.keep(task, table)
            if len(came) == 1:
                busy = [address for address, keys in client.processing().items() if keys]
                (killed,) = (process for process in workers if process.pid == pids[busy[0]])
                killed.send_signal(signal.SIGKILL)
                killed.wait()
        assert len(client.scheduler_info(n_workers=-1)["workers"]) == 1
    assert sorted(came, key=lambda task: task.first) == work
    kept = store.read("kffa-ladrc", flights)
    assert kept["flight"].tolist() == list(range(flights))
    _, alone = run(campaign, replace(work[-1], first=36))
    for name, values in alone.items():
        if name != "failure":
            np.testing.assert_array_equal(kept[name][36:], values, err_msg=name)


def test_no_scheduler_or_no_worker_is_said_in_a_line(
    scheduler: str, campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = list(tasks(campaign, 1, 1))
    monkeypatch.setattr(engine, "CONNECT_S", 0.2)
    with pytest.raises(UserError, match=r"no Dask scheduler answers .* start one with `dask scheduler`"):
        next(run_dask(campaign, work, "tcp://127.0.0.1:1"))
    monkeypatch.setattr(engine, "CONNECT_S", 10)
    with pytest.raises(UserError, match="the cluster has no worker; start some with `dask worker"):
        next(run_dask(campaign, work, scheduler))


@pytest.mark.parametrize("address", ["10.0.0.1", "localhost:x", "dask://10.0.0.1:8786"])
def test_what_is_no_address_is_said_and_no_client_is_made_for_it(
    address: str, campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client that could not begin shows a traceback when it is forgotten."""
    monkeypatch.setattr(distributed, "Client", lambda *args, **kwargs: pytest.fail("a client was made"))
    with pytest.raises(
        UserError, match=rf"--scheduler {address}: no Dask scheduler answers \(.*tcp://HOST:8786"
    ):
        next(run_dask(campaign, list(tasks(campaign, 1, 1)), address))


@pytest.mark.timeout(300)
def test_a_worker_of_another_version_is_refused(
    scheduler: str, campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (
        worker(scheduler, tmp_path),
        distributed.Client(scheduler, set_as_default=False) as client,
    ):
        client.wait_for_workers(1, timeout=STARTED_S)
        theirs = re.escape(kffa_offboard.__version__)
        monkeypatch.setattr(kffa_offboard, "__version__", "9.8.7")
        with pytest.raises(
            UserError, match=rf"has kffa-offboard {theirs}, and this is 9\.8\.7; install the same"
        ):
            next(run_dask(campaign, list(tasks(campaign, 1, 1)), scheduler))
