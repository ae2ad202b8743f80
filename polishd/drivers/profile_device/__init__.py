"""Drives and sensors as data: a profile describes a device's protocol, and one driver runs it (docs/devices.md)."""
