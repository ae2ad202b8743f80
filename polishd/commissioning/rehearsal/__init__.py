"""The simulated copy of a cell: its draft, its devices, its part and its processes."""
