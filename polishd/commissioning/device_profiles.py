"""Device profiles without a cell: list, show and check them, and find the settings of a device."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType

from polishd.config.device_profile import TRIED, DeviceProfile
from polishd.config.device_profile_checks import profile_of, shipped
from polishd.drivers.profile_device import build
from polishd.drivers.profile_device.build import address_of, wire_of
from polishd.drivers.transport.address import PARITIES, SerialLine, Tcp
from polishd.model.errors import ConfigError, DeviceError, DeviceRefused, LinkError, ProtocolError
from polishd.rendering.terminal import emit, key_table, record_table, stderr, stdout
from polishd.util.files import toml_text
from polishd.util.threads import run_loop

# ``polishd device list``, ``show``, ``check`` and ``new``.

TEMPLATES = Path(__file__).with_name("templates")
KINDS = {"actuator": "actuator", "spindle": "spindle", "force_sensor": "force sensor"}


def list_verb(*, as_json: bool) -> None:
    """List name, device, kind, link, and tests of each profile."""
    columns = ("name", "device", "kind", "link", "tried")
    profiles = [profile_of(name, Path()) for name in shipped()]
    rows = [(one.name, one.title, KINDS[one.kind], one.link, TRIED[one.tried]) for one in profiles]
    answer = {"profiles": [dict(zip(columns, row, strict=True)) for row in rows]}
    emit(answer, as_json=as_json, table=lambda: record_table("device profiles", columns, rows))


def show_verb(name: str, *, toml: bool, as_json: bool) -> None:
    """Show a profile for people, or its file."""
    profile = profile_of(name, Path())
    if toml:
        _give_text(profile.source.text, as_json=as_json)
        return
    answer = facts(profile)
    emit(answer, as_json=as_json, table=lambda: _tables(profile, answer))


def check_verb(name: str, raws: Sequence[str], *, as_json: bool) -> None:
    """Show what follows from a profile, and decode raw examples."""
    profile = profile_of(name, Path())
    answer = facts(profile)
    reads = {text: _read(profile, text) for text in raws}
    answer["reads"] = reads
    warnings = _warnings(profile)
    answer["warnings"] = warnings
    emit(answer, as_json=as_json, table=lambda: _tables(profile, answer))
    if not as_json:
        for text, found in reads.items():
            stdout.print(f"{text} reads {', '.join(f'{key} {value}' for key, value in found.items())}", markup=False)
        for warning in warnings:
            stdout.print(f"warning: {warning}", markup=False)


def new_verb(kind: str, link: str, *, as_json: bool) -> None:
    """Print a template."""
    _give_text(toml_text(TEMPLATES / f"{kind}_{link}.toml"), as_json=as_json)


def facts(profile: DeviceProfile) -> dict[str, Any]:
    """Return what follows from a profile, for JSON."""
    line = profile.serial
    found: dict[str, Any] = {
        "profile": profile.name,
        "device": profile.title,
        "kind": KINDS[profile.kind],
        "link": profile.link,
        "manual": profile.manual,
        "tried": TRIED[profile.tried],
        "serial line": f"{line.baud} 8{line.parity[0].upper()}{line.stop_bits}",
        "one look, ms": round(1000 * build.poll_s(profile), 1),
        "settings": list(profile.settings),
    }
    if profile.actuator:
        found["without power it"] = profile.actuator.unpowered
    values, orders = dict(build.scales(profile)), dict(build.orders(profile))
    return {**found, "values": values, "orders": {"look": " | ".join(build.polls(profile)), **orders}}


def _tables(profile: DeviceProfile, answer: Mapping[str, Any]) -> RenderableType:
    plain = [(key, value) for key, value in answer.items() if isinstance(value, str | float)]
    parts: list[RenderableType] = [key_table(profile.name, plain)]
    if profile.settings:
        parts.append(record_table("to be set at the device", ("setting",), [(one,) for one in profile.settings]))
    parts.append(record_table("values", ("name", "where and what"), answer["values"].items()))
    sent = "RTU, as manuals print it" if profile.modbus else "line"
    parts.append(record_table("requests", ("order", sent), answer["orders"].items()))
    return Group(*parts)


def _read(profile: DeviceProfile, text: str) -> dict[str, str]:
    name, equals, raw = text.partition("=")
    if not equals:
        raise ConfigError(f"--raw {text!r}: write NAME=DATA, such as force=0x04AE")
    return {key: build.said(key, value) for key, value in build.read_raw(profile, name, raw).items()}


def _warnings(profile: DeviceProfile) -> list[str]:
    """Return warnings on values that are allowed but may be a mistake."""
    found = []
    commands = profile.commands
    if profile.kind != "force_sensor" and not commands.watchdog:
        watchdog_s = (profile.actuator or profile.spindle).watchdog_s  # type: ignore[union-attr]
        found.append(f"no commands.watchdog: set {watchdog_s:g} s at the device, or it goes on if polishd stops")
    if build.poll_s(profile) > 0.1:
        found.append(f"one look takes {1000 * build.poll_s(profile):.0f} ms; raise serial.baud")
    if "TODO" in profile.source.text:
        found.append("it still contains TODO")
    if profile.spindle and not commands.reverse:
        found.append("no commands.reverse: the spindle turns forward only")
    return found


def _give_text(text: str, *, as_json: bool) -> None:
    """Print a file's text unchanged, for redirection into a file."""
    emit({"toml": text}, as_json=as_json)
    if not as_json:
        stdout.print(text, markup=False, highlight=False, soft_wrap=True, end="")


# ``polishd device scan``: find the settings at which a device answers. It only reads.

BAUDS = (9600, 19_200, 38_400, 57_600, 115_200, 4800)
Place = tuple[SerialLine | Tcp, int | None]
"""An address with its settings, and a Modbus unit."""


def find_verb(name: str, address: str, units: int, silence_s: float, *, as_json: bool) -> None:
    """Try all settings, and print those with an answer."""
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
        raise LinkError(f"{given}: no answer at {tried}; check power, wiring (A and B exchanged?) and its mode")


def _places(profile: DeviceProfile, given: SerialLine | Tcp, units: int) -> Iterator[Place]:
    """Yield the profile's settings, then other baud rates and parities, then other units at the profile's settings."""
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
    profile: DeviceProfile, places: list[Place], silence_s: float, show: Callable[[str], object]
) -> list[tuple[str, str]]:
    found = []
    for at, (address, unit) in enumerate(places, start=1):
        where = _settings(address, unit)
        show(f"{at} of {len(places)}: {where}")
        says = await _try(profile, address, unit, silence_s)
        if says:
            found.append((where, says))
    return found


async def _try(profile: DeviceProfile, address: SerialLine | Tcp, unit: int | None, silence_s: float) -> str:
    """Return the result of one try; empty without an answer. A port that does not open is an error."""
    wire = wire_of(profile, address, silence_s, unit=unit)
    await wire.connect()
    try:
        await wire.read(profile.polled)
    except (DeviceRefused, ProtocolError) as error:
        return f"a device answers, but not as in the profile: {error}"
    except DeviceError:
        return ""
    finally:
        await wire.disconnect()
    return f"answers as in profile {profile.name!r}"


def _settings(address: SerialLine | Tcp, unit: int | None) -> str:
    settings = ""
    if isinstance(address, SerialLine):
        settings = f"?baud={address.baud}&parity={address.parity}&stop_bits={address.stop_bits}"
    return f"{address}{settings}" + ("" if unit is None else f", unit {unit}")
