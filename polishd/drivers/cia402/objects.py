"""The objects of a drive that are used here, as CiA 301 and CiA 402 number them."""

from __future__ import annotations

from polishd.drivers.cia402.codec import Address

DEVICE_TYPE = Address(0x1000)
ERROR_REGISTER = Address(0x1001)
CONSUMER_HEARTBEAT = Address(0x1016, 1)
"""Whose heartbeat the drive listens for (bits 16 to 22), and how long it bears its absence, ms."""
PRODUCER_HEARTBEAT = Address(0x1017)
"""Period of the drive's own heartbeat, ms."""
VENDOR, PRODUCT, REVISION, SERIAL = (Address(0x1018, sub) for sub in (1, 2, 3, 4))

ABORT_CONNECTION = Address(0x6007)
"""What the drive does when it hears nothing more."""
ERROR_CODE = Address(0x603F)
CONTROL_WORD = Address(0x6040)
STATUS_WORD = Address(0x6041)
QUICK_STOP_OPTION = Address(0x605A)
MODE = Address(0x6060)
MODE_NOW = Address(0x6061)
POSITION = Address(0x6064)
VELOCITY = Address(0x606C)
TARGET_TORQUE = Address(0x6071)
MAX_TORQUE = Address(0x6072)
TORQUE = Address(0x6077)
TARGET_POSITION = Address(0x607A)
MAX_MOTOR_SPEED = Address(0x6080)
PROFILE_VELOCITY = Address(0x6081)
ACCELERATION = Address(0x6083)
DECELERATION = Address(0x6084)
QUICK_STOP_DECELERATION = Address(0x6085)
TORQUE_SLOPE = Address(0x6087)
TARGET_VELOCITY = Address(0x60FF)
SUPPORTED_MODES = Address(0x6502)

PROFILE_402 = 402
"""Low half of DEVICE_TYPE."""
POSITION_MODE, VELOCITY_MODE, TORQUE_MODE = 1, 3, 4
ABORT_DISABLES, ABORT_QUICK_STOPS = 2, 3
STOP_AND_DISABLE = 2
"""QUICK_STOP_OPTION: decelerate on the quick stop ramp, then switch on disabled."""
