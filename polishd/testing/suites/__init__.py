"""Conformance suites, one a device interface; the docstring of each test states the requirement."""
