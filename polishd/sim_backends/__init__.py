"""Simulated devices, each a process with the real protocol, and their plant: written apart from what they test."""
