"""What people do without a cell: maps, programs, calibration, studies, the physics, plans."""
