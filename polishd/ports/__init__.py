"""What a device is, as typing protocols. Real and simulated devices are the same driver with another address."""

from polishd.ports.clock import Clock
from polishd.ports.devices import Device, ForceActuator, ForceSensor, Metrology, Monitor, PartLoader, Robot, Spindle
from polishd.ports.stream import ByteStream

__all__ = [
    "ByteStream",
    "Clock",
    "Device",
    "ForceActuator",
    "ForceSensor",
    "PartLoader",
    "Metrology",
    "Monitor",
    "Robot",
    "Spindle",
]
