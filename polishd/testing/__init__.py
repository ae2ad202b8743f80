"""Conformance suites for drivers as a pytest plugin, replay of recordings, and hardware in the loop."""
