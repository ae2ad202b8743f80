"""The register map: numbers in, nouns out. Raises ProtocolError on numbers that the map does not have."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import Identity, ProtocolError
from polishd.drivers.voice_coil.device import Reading, State

# holding registers
COMMAND, SETPOINT, WATCHDOG, HEARTBEAT = 0, 1, 2, 3
RETRACT, ENGAGE = 0, 1

# input registers: first, count
INPUTS = (0, 6)
IDENTITY = (100, 30)

REFUSALS = {
    1: "function not supported",
    2: "address not known",
    3: "value out of range",
    4: "refused: a fault is set",
}


def setpoint_register(force_n: float) -> int:
    """Newton to hundredths."""
    return round(100.0 * force_n)


def reading(registers: Sequence[int]) -> tuple[Reading, int]:
    """Input registers 0 to 5: the reading, and the heartbeat that the actuator heard last."""
    state, force, setpoint, position, fault, heartbeat = registers
    if state not in tuple(State):
        raise ProtocolError(f"state {state} is none of the actuator's")
    return Reading(State(state), _signed(force) / 100.0, setpoint / 100.0, position, fault), heartbeat


def identity(registers: Sequence[int]) -> Identity:
    """Input registers 100 to 129."""
    vendor, model, serial = (_text(registers[at : at + 8]) for at in (0, 8, 16))
    boots = registers[28] << 16 | registers[29]
    return Identity(vendor, model, serial, _text(registers[24:28]), boot_id=str(boots))


def _signed(register: int) -> int:
    return register - 0x10000 if register & 0x8000 else register


def _text(registers: Sequence[int]) -> str:
    raw = b"".join(register.to_bytes(2, "big") for register in registers).rstrip(b"\0")
    try:
        return raw.decode("ascii")
    except UnicodeDecodeError:
        raise ProtocolError(f"identity text is not ASCII: {raw!r}") from None
