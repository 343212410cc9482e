"""What is kept of a campaign: a directory of Parquet files, one for each task, and what it was flown with.

A file appears when its task is done, complete or not at all, so a campaign that was stopped can be read, and
goes on with what is missing.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kffa_offboard import __version__
from kffa_offboard.campaign.extras import need
from kffa_offboard.campaign.measure import FAILURES
from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.campaign.task import Table, Task
from kffa_offboard.control.controllers import ControllerName
from kffa_offboard.errors import UserError

MANIFEST, FLIGHTS = "campaign.json", "flights"


class Store:
    """The directory of one campaign."""

    def __init__(self, directory: Path, campaign: Campaign) -> None:
        """Make the directory, or go on in one where the same campaign was flown.

        Raises UserError if another campaign's flights are there.
        """
        self._arrow = need("pyarrow", "a campaign's Parquet files")
        self._parquet = need("pyarrow.parquet", "a campaign's Parquet files")
        self.directory, self._campaign = directory, campaign
        (directory / FLIGHTS).mkdir(parents=True, exist_ok=True)
        before = self._manifest()
        for controller in campaign.services:
            known = before.get("controllers", {}).get(controller, campaign.digest(controller))
            if known != campaign.digest(controller):
                raise UserError(
                    f"--out {directory}: holds another campaign's flights with {controller}; choose another "
                    "directory, or remove it"
                )
        digests = before.get("controllers", {}) | {name: campaign.digest(name) for name in campaign.services}
        self._write(
            MANIFEST,
            {
                "version": __version__,
                "numpy": np.__version__,
                "controllers": digests,
                "control_s": campaign.control_s,
                "settings": campaign.file.model_dump(mode="json"),
            },
        )

    def _manifest(self) -> dict[str, Any]:
        try:
            found: dict[str, Any] = json.loads((self.directory / MANIFEST).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except ValueError as error:
            raise UserError(
                f"{self.directory / MANIFEST}: is damaged ({error}); "
                f"choose another --out, or remove {self.directory}"
            ) from error
        return found

    def _write(self, name: str, document: Any) -> None:
        text = json.dumps(document, indent=1, ensure_ascii=False)
        (self.directory / name).write_text(text + "\n", encoding="utf-8")

    def _path(self, task: Task) -> Path:
        return self.directory / FLIGHTS / f"{task.name}.parquet"

    def missing(self, work: Sequence[Task]) -> list[Task]:
        """Those of the tasks that are not done yet."""
        return [task for task in work if not self._path(task).exists()]

    def keep(self, task: Task, table: Table) -> None:
        """Write the flights of a task; a task that comes again changes nothing."""
        columns = {
            "controller": np.full(task.count, task.controller),
            **table,
            "failure": np.array(FAILURES)[table["failure"]],
        }
        temporary = self._path(task).with_suffix(".partial")
        self._parquet.write_table(self._arrow.table(columns), temporary)
        os.replace(temporary, self._path(task))

    def read(self, controller: ControllerName, flights: int) -> dict[str, Any]:
        """Columns ``(N,)`` of the kept flights of a controller with numbers below `flights`, in order."""
        paths = sorted((self.directory / FLIGHTS).glob(f"{controller}-????????-????????.parquet"))
        tables = [self._parquet.read_table(path) for path in paths]
        if not tables:
            return {"flight": np.zeros(0, dtype=np.int64)}
        joined = self._arrow.concat_tables(tables)
        columns = {name: joined[name].to_numpy() for name in joined.column_names}
        # A campaign that was made longer has flown its last, incomplete task again, with more flights.
        _, first = np.unique(columns["flight"], return_index=True)
        first = first[columns["flight"][first] < flights]
        return {name: values[first] for name, values in columns.items()}

    def write_summary(self, summary: Any) -> None:
        """Keep the summary as summary.json."""
        self._write("summary.json", summary)
