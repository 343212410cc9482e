"""The command sim-vehicle, also as ``python -m sim_vehicle``; Ctrl-C is met from the first moment on."""

import sys

INTERRUPTED = 130


def main() -> None:
    """Load the command line, which takes a while, and run it."""
    try:
        from sim_vehicle.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
