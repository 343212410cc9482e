"""The command kffa-offboard, also as ``python -m kffa_offboard``; Ctrl-C is met from the first moment on."""

import os
import sys

INTERRUPTED = 130


def main() -> None:
    """Load the command line, which takes a while, and run it.

    OpenBLAS gets one thread unless the environment says otherwise: matrices here are small, and threads of
    its own only wait, and spin while they do.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from kffa_offboard.cli import main as run

        run()
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
