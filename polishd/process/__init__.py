"""Pure functions on arrays: robot, removal, dwell, metrology, toolpath, identification."""
