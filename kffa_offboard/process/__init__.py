"""The daemon as a process: its service manager, its scheduling, and what it remembers of a flight."""
