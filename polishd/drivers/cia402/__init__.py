"""CiA 402 drives on CANopen, described by their EDS files: docs/protocols/cia402.md."""
