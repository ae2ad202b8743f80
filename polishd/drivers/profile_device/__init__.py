"""Drives and sensors as data: a profile says what a device speaks, and one engine drives it (docs/devices.md)."""
