"""Robot models: kinematics, compliance along a path, motion, calibration."""
