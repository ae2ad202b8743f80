"""The devices of the daemon's cell: polling, readiness, time limits, recording."""
