"""The dwell-time problem: its statement, solvers, bounds and certificates."""
