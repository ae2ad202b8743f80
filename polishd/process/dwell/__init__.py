"""Dwell time: the problem, its solvers, and the certificate."""
