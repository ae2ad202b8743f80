"""Driver of a FANUC controller with the Remote Motion Interface."""
