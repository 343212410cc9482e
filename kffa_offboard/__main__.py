"""``python -m kffa_offboard``: the same as the command kffa-offboard."""

from kffa_offboard.cli import main

if __name__ == "__main__":
    main()
