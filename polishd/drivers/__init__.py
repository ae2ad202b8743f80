"""Drivers: one wire protocol each. A driver imports no other driver but ``drivers.transport``."""
