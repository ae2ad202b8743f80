"""Drivers: one file or folder a device protocol. A driver imports no other driver but ``drivers.transport``."""
