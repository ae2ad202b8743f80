"""Drives and sensors as data: a profile describes the protocol, one driver runs it (docs/how-to/devices.md)."""
