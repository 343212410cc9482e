"""The comparison: one vehicle, one load, the autopilot's own height hold and the daemon's controllers."""
