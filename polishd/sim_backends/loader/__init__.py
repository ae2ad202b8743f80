"""The simulated part loader."""
