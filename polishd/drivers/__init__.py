"""Drivers: one file or folder for each device protocol. A driver imports no other driver except ``transport``."""
