"""Two-dimensional transforms in float32 by compiled code, for solvers that do little else (decision 0035)."""
