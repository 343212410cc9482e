"""docs/scenarios.md says of each segment what the configuration takes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest

from kffa_offboard.config_control import Table
from kffa_offboard.config_scenario import SegmentTable

TEXT = (Path(__file__).parents[1] / "docs" / "scenarios.md").read_text(encoding="utf-8")
SEGMENTS: tuple[type[Table], ...] = get_args(get_args(SegmentTable)[0])


def row_of(name: str) -> list[str]:
    """The cells of its row."""
    rows = [line.split("|")[1:-1] for line in TEXT.splitlines() if line.startswith("| `")]
    return next(row for row in rows if f"`{name}`" in row[0])


@pytest.mark.parametrize("segment", SEGMENTS)
def test_each_segment_has_its_row_with_all_keys_and_defaults(segment: type[Table]) -> None:
    (name,) = get_args(segment.model_fields["type"].annotation)
    keys = row_of(name)[1]
    assert set(re.findall(r"`([a-z_]+)`", keys)) - {"grab", "release"} == set(segment.model_fields) - {"type"}
    for key, field in segment.model_fields.items():
        if isinstance(field.default, float):
            (value,) = re.findall(rf"`{key}`(?: or `\w+`)? \(([\d.]+)\)", keys)
            assert float(value) == field.default


def test_there_is_no_row_for_anything_else() -> None:
    names = re.findall(r"^\| (`[a-z`, ]+`) \|", TEXT, re.MULTILINE)
    told = {name for cell in names for name in re.findall(r"[a-z]+", cell)} - {"type"}
    assert told == {get_args(segment.model_fields["type"].annotation)[0] for segment in SEGMENTS}
