"""Drives off the shelf on CANopen, as their EDS files describe them (CiA 402): docs/protocols/cia402.md."""
