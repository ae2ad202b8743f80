"""``polishd device find``: at which settings of the line a device answers. Reads only."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from polishd.config.device_profile import DeviceProfile
from polishd.drivers.profiled.make import address_of, wire_of
from polishd.drivers.profiled.shelf import profile_of
from polishd.drivers.transport.address import PARITIES, SerialLine, Tcp
from polishd.model.errors import DeviceError, DeviceRefused, LinkError, ProtocolError
from polishd.show.tables import emit, stderr, stdout
from polishd.threads import run_loop

BAUDS = (9600, 19_200, 38_400, 57_600, 115_200, 4800)
Place = tuple[SerialLine | Tcp, int | None]
"""An address with its settings, and a Modbus unit."""


def find_verb(name: str, address: str, units: int, silence_s: float, *, as_json: bool) -> None:
    """Try them all; tell where somebody answered, and how."""
    profile = profile_of(name, Path())
    given = address_of(profile, address, Path())
    places = list(dict.fromkeys(_places(profile, given, units)))
    with stderr.status(f"trying {len(places)} settings") as status:
        found = run_loop(_try_all(profile, places, silence_s, status.update))
    emit({"found": [{"at": at, "says": says} for at, says in found]}, as_json=as_json)
    if not as_json:
        for at, says in found:
            stdout.print(f"{at}: {says}", markup=False)
    if not found:
        tried = "every baud rate and parity" if isinstance(given, SerialLine) else f"units 1 to {units}"
        raise LinkError(f"{given}: nobody answers at {tried}; see power, wires (A and B exchanged?), and its line mode")


def _places(profile: DeviceProfile, given: SerialLine | Tcp, units: int) -> Iterator[Place]:
    """The profile's own first, then other speeds and parities, then other units at the profile's own."""
    unit = profile.modbus.unit if profile.modbus else None
    yield given, unit
    if isinstance(given, SerialLine):
        for baud in BAUDS:
            for parity in PARITIES:
                yield replace(given, baud=baud, parity=parity), unit  # type: ignore[arg-type]
    if unit is not None:
        for other in range(1, units + 1):
            yield given, other


async def _try_all(
    profile: DeviceProfile, places: list[Place], silence_s: float, tell: Callable[[str], object]
) -> list[tuple[str, str]]:
    found = []
    for at, (address, unit) in enumerate(places, start=1):
        where = _said(address, unit)
        tell(f"{at} of {len(places)}: {where}")
        says = await _try(profile, address, unit, silence_s)
        if says:
            found.append((where, says))
    return found


async def _try(profile: DeviceProfile, address: SerialLine | Tcp, unit: int | None, silence_s: float) -> str:
    """What the device said; empty where none did. A port that does not open is an error."""
    wire = wire_of(profile, address, silence_s, unit=unit)
    await wire.connect()
    try:
        await wire.read(profile.polled)
    except (DeviceRefused, ProtocolError) as error:
        return f"a device answers, but not as the profile says: {error}"
    except DeviceError:
        return ""
    finally:
        await wire.disconnect()
    return f"answers as profile {profile.name!r} says"


def _said(address: SerialLine | Tcp, unit: int | None) -> str:
    settings = ""
    if isinstance(address, SerialLine):
        settings = f"?baud={address.baud}&parity={address.parity}&stop_bits={address.stop_bits}"
    return f"{address}{settings}" + ("" if unit is None else f", unit {unit}")
