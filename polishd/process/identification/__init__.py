"""Identification: compare what was removed with what was planned, and name and fit the cause."""
