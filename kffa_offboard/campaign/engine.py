"""Where the tasks run: on the cores of this machine (joblib) or on a Dask cluster that is already there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import Any, Literal

import kffa_offboard
from kffa_offboard.campaign.extras import need
from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.campaign.task import Table, Task, run
from kffa_offboard.errors import UserError

EngineName = Literal["local", "dask"]

CONNECT_S = 10


def run_local(campaign: Campaign, work: Sequence[Task], jobs: int) -> Iterator[tuple[Task, Table]]:
    """Results as they come, from `jobs` processes; in this one if there is nothing to share out."""
    if jobs == 0:
        raise UserError("--jobs 0: no process would fly; give 1 or more, or -1 for one on each core")
    if jobs == 1 or len(work) == 1:
        yield from (run(campaign, task) for task in work)
        return
    joblib = need("joblib", "a campaign on several cores")
    parallel = joblib.Parallel(n_jobs=min(jobs, len(work)), batch_size=1, return_as="generator_unordered")
    try:
        yield from parallel(joblib.delayed(run)(campaign, task) for task in work)
    except BaseException:  # stopped: the processes would go on, and then wait for more work
        need("joblib.externals.loky", "a campaign on several cores").get_reusable_executor().shutdown(
            kill_workers=True
        )
        raise


def run_dask(campaign: Campaign, work: Sequence[Task], scheduler: str) -> Iterator[tuple[Task, Table]]:
    """Results as they come from the cluster at `scheduler`, each task once.

    Tasks of a worker that dies go to the others. Raises UserError if there is no cluster, no worker, one with
    another version of this program, or a task lost its worker again and again.
    """
    distributed = need("distributed", "--engine dask")
    addressing = need("distributed.comm.addressing", "--engine dask")
    try:
        addressing.get_address_host_port(scheduler)  # a client that was refused its address fails again later
        client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UserError(
            f"--scheduler {scheduler}: no Dask scheduler answers ({error}); "
            "start one with `dask scheduler` and give its address, tcp://HOST:8786"
        ) from error
    with client:
        if not client.scheduler_info(n_workers=-1)["workers"]:
            raise UserError(
                f"--scheduler {scheduler}: the cluster has no worker; "
                f"start some with `dask worker {scheduler}`"
            )
        _check_versions(client, scheduler)
        # The campaign goes with every task: data of its own on the cluster could be lost with a worker.
        futures = [client.submit(run, campaign, task, key=_key(campaign, task)) for task in work]
        try:
            for future in distributed.as_completed(futures, loop=client.loop):
                yield future.result()
                future.release()
        except distributed.KilledWorker as error:
            raise UserError(
                f"--scheduler {scheduler}: {error.task} lost its worker {error.allowed_failures + 1} times; "
                "look at the workers' memory; what is done is kept, the same command goes on with the rest"
            ) from error
        finally:
            client.cancel([future for future in futures if not future.done()])


def _check_versions(client: Any, scheduler: str) -> None:
    """Raise UserError if a worker would fly with another version of this program."""
    found = client.run(attrgetter("__version__"), kffa_offboard, on_error="return")
    for worker, version in found.items():
        if version != kffa_offboard.__version__:
            told = version if isinstance(version, str) else f"that cannot be had ({version})"
            raise UserError(
                f"--scheduler {scheduler}: worker {worker} has kffa-offboard {told}, and this is "
                f"{kffa_offboard.__version__}; install the same version on both"
            )


def _key(campaign: Campaign, task: Task) -> str:
    """Name of a task among those of everybody on the cluster."""
    return f"{task.name}-{campaign.digest(task.controller)}"
