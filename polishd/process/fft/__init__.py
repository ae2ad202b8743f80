"""Compiled Fourier transforms for the dwell solvers."""
