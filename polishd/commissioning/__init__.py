"""What makes a cell ready: its first files, calibration, rehearsal against simulators, device profiles."""
