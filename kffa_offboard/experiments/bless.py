"""``python -m kffa_offboard.experiments.bless``: take today's results of one seed for the golden ones."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from kffa_offboard.experiments import golden
from kffa_offboard.experiments.settings import load

GOLDEN = Path("tests/golden/paper-results.json")


def main(path: Path = GOLDEN) -> int:
    """Rewrite the golden results in the working copy; print what changed. 2 outside of a working copy."""
    if not path.parent.is_dir():
        print(
            f"error: {path.parent}: no such directory; run this at the root of the source tree",
            file=sys.stderr,
        )
        return 2
    before = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    results = golden.fly_golden(load())
    changes = list(golden.differences(before, results))
    if changes:
        golden.write(path, results)
    print("\n".join(changes) or "no change")
    return 0


if __name__ == "__main__":
    sys.exit(main())
