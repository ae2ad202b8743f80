"""Shared by drivers: addresses, lines, CAN, Modbus, streams, and the tracking of a running program."""
