"""A simulated FANUC controller with the Remote Motion Interface."""
