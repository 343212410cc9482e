"""Flying a recorded flight again: the same service, driven from the log instead of the link."""
