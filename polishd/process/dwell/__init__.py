"""Dwell time: the problem, its solvers, and the certificate.

For numpy arrays: `arrays.dwell_from_arrays` (docs/dwell.md). For a problem: the solvers `newton_cg`, `interior_point`
and `douglas_rachford`, the `curve` of residual against time, and `budget` for a total time or a target.
"""
