"""Fits of the cell's numbers to measurements."""
