"""What is kept of a campaign: a directory of Parquet files, one for each task, and what it was flown with.

A file appears when its task is done, complete or not at all, so a campaign that was stopped can be read, and
goes on with what is missing.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from kffa_offboard import __version__
from kffa_offboard.campaign.conditions import Conditions
from kffa_offboard.campaign.extras import need
from kffa_offboard.campaign.measure import FAILURES, Outcomes
from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.campaign.task import Table, Task
from kffa_offboard.control.controllers import ControllerName
from kffa_offboard.errors import UserError

MANIFEST, FLIGHTS = "campaign.json", "flights"
COLUMNS = {
    "controller",
    "flight",
    *(field.name for table in (Conditions, Outcomes) for field in fields(table)),
}


class Store:
    """The directory of one campaign."""

    def __init__(self, directory: Path, campaign: Campaign) -> None:
        """Make the directory, or go on in one where the same campaign was flown.

        Raises UserError if another campaign's flights are there, another version's, or what are none.
        """
        self._arrow = need("pyarrow", "a campaign's Parquet files")
        self._parquet = need("pyarrow.parquet", "a campaign's Parquet files")
        self.directory, self._campaign = directory, campaign
        (directory / FLIGHTS).mkdir(parents=True, exist_ok=True)
        before = self._manifest()
        if any((directory / FLIGHTS).glob("*.parquet")):
            self._check_version(before)
        for controller in campaign.services:
            known = before.get("controllers", {}).get(controller, campaign.digest(controller))
            if known != campaign.digest(controller):
                raise UserError(
                    f"--out {directory}: holds another campaign's flights with {controller}; choose another "
                    "directory, or remove it"
                )
            for path in self._parts(controller):
                self._flights(path)
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
            raise self._damaged(str(error)) from error
        if not isinstance(found, dict) or not isinstance(found.get("controllers"), dict):
            raise self._damaged("it names no controllers")
        return found

    def _damaged(self, why: str) -> UserError:
        return UserError(
            f"{self.directory / MANIFEST}: is damaged ({why}); "
            f"choose another --out, or remove {self.directory}"
        )

    def _check_version(self, before: dict[str, Any]) -> None:
        """Raise UserError if the flights that are there are of another program than this."""
        if not before:
            raise UserError(
                f"--out {self.directory}: holds flights and no {MANIFEST} that says what was flown; choose "
                "another directory, or remove it"
            )
        version = before.get("version")
        if version != __version__:
            raise UserError(
                f"--out {self.directory}: holds flights of kffa-offboard {version}, and this is "
                f"{__version__}; choose another directory, remove it, or go on with version {version}"
            )

    def _write(self, name: str, document: Any) -> None:
        text = json.dumps(document, indent=1, ensure_ascii=False)
        _replace(self.directory / name, lambda draft: draft.write_text(text + "\n", encoding="utf-8"))

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
        rows = self._arrow.table(columns)
        _replace(self._path(task), lambda draft: self._parquet.write_table(rows, draft))

    def read(self, controller: ControllerName, flights: int) -> dict[str, Any]:
        """Columns ``(N,)`` of the kept flights of a controller with numbers below `flights`, in order."""
        tables = [self._parquet.read_table(path) for path in self._parts(controller)]
        if not tables:
            return {"flight": np.zeros(0, dtype=np.int64)}
        joined = self._arrow.concat_tables(tables)
        columns = {name: joined[name].to_numpy() for name in joined.column_names}
        # A campaign that was made longer has flown its last, incomplete task again, with more flights.
        _, first = np.unique(columns["flight"], return_index=True)
        first = first[columns["flight"][first] < flights]
        return {name: values[first] for name, values in columns.items()}

    def _parts(self, controller: ControllerName) -> list[Path]:
        return sorted((self.directory / FLIGHTS).glob(f"{controller}-????????-????????.parquet"))

    def _flights(self, path: Path) -> None:
        """Raise UserError if a file does not hold the flights that its name says."""
        controller, first, last = path.stem.rsplit("-", 2)
        try:
            kept = self._parquet.ParquetFile(path)
            names = set(kept.schema_arrow.names)
            rows = kept.read()
        except (OSError, ValueError) as error:
            why = str(error).split(": ", 1)[-1].splitlines()[0]
        else:
            if names != COLUMNS:
                why = f"its columns are {', '.join(sorted(names)[:3])}, ..."
            elif set(rows["controller"].to_pylist()) == {controller} and rows["flight"].to_pylist() == list(
                range(int(first), int(last) + 1)
            ):
                return
            else:
                why = "the flights in it have other numbers or another controller than its name says"
        raise UserError(
            f"{path}: is damaged or not of this campaign ({why}); remove it, and the same command flies its "
            "flights again"
        )

    def write_summary(self, summary: Any) -> None:
        """Keep the summary as summary.json."""
        self._write("summary.json", summary)


def _replace(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file complete or not at all, even if the disk is full or the machine goes down."""
    draft = path.with_suffix(f".{os.getpid()}.partial")  # a second process may fly the same
    try:
        write(draft)
        with draft.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)
