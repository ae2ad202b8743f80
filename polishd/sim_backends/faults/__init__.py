"""Scripted faults: when each acts, what it does to a frame, and which of them a link can have."""
