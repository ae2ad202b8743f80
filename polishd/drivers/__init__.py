"""Drivers, one file or folder a device protocol; a driver imports no other driver but ``drivers.transport``."""
