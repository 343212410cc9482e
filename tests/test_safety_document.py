"""docs/safety.md names tests; each of them exists."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_every_test_that_the_safety_document_names_exists():
    named = set(re.findall(r"`(test_\w+)`", (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")))
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    there = set(re.findall(r"def (test_\w+)\(", sources))
    assert len(named) > 25
    assert named <= there, sorted(named - there)


def test_every_hazard_has_a_test():
    rows = [
        line
        for line in (ROOT / "docs" / "safety.md").read_text(encoding="utf-8").splitlines()
        if line.startswith("|")
        and not line.startswith("|---")
        and not re.match(r"\| (Hazard|Condition) ", line)
    ]
    assert len(rows) > 35
    assert all(re.search(r"`test_\w+`", row) for row in rows), [row for row in rows if "`test_" not in row]
