"""docs/security.md names tests; each of them exists, and each threat has one."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")


def test_every_test_that_the_security_document_names_exists():
    named = set(re.findall(r"`(test_\w+)`", TEXT))
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    there = set(re.findall(r"def (test_\w+)\(", sources))
    assert len(named) > 20
    assert named <= there, sorted(named - there)


def test_every_threat_has_a_test():
    rows = [line for line in TEXT.splitlines() if line.startswith("| ") and not line.startswith("| Threat")]
    assert len(rows) > 15
    assert all(re.search(r"`test_\w+`", row) for row in rows), [row for row in rows if "`test_" not in row]
