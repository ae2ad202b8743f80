"""Commands of ``polishd device``: options only."""

from __future__ import annotations

from typing import Annotated, Literal

import typer
from typer import Argument, Option

from polishd.cli.command_group import CommandGroup
from polishd.util.command_line import Json

app = typer.Typer(
    cls=CommandGroup, help="Profiles of drives and sensors: the protocol of a Modbus or line device as data."
)

Profile = Annotated[str, Argument(metavar="NAME|FILE.toml", help="A shipped profile, or a file")]
Raw = Annotated[
    list[str] | None,
    Option("--raw", metavar="NAME=DATA", help="Decode raw data: force=0x04AE, or status='C 12.0' of a line"),
]


@app.command("list")
def list_profiles(as_json: Json = False) -> None:
    """List the shipped profiles."""
    from polishd.commissioning.device_profiles import list_verb

    list_verb(as_json=as_json)


@app.command()
def show(
    profile: Profile,
    toml: Annotated[bool, Option("--toml", help="Print the file, as a template for your own")] = False,
    as_json: Json = False,
) -> None:
    """Show a profile: source, settings at the device, values, commands."""
    from polishd.commissioning.device_profiles import show_verb

    show_verb(profile, toml=toml, as_json=as_json)


@app.command()
def check(profile: Profile, raw: Raw = None, as_json: Json = False) -> None:
    """Check a profile; show the bytes of its requests, and decoded values."""
    from polishd.commissioning.device_profiles import check_verb

    check_verb(profile, raw or [], as_json=as_json)


@app.command()
def new(
    kind: Annotated[Literal["actuator", "spindle", "force_sensor"], Argument(help="Kind of the device")],
    link: Annotated[Literal["modbus", "lines"], Option(help="Protocol of the device")] = "modbus",
    as_json: Json = False,
) -> None:
    """Print a commented template of a profile: polishd device new spindle > mine.toml."""
    from polishd.commissioning.device_profiles import new_verb

    new_verb(kind, link, as_json=as_json)


@app.command()
def scan(
    profile: Profile,
    address: Annotated[str, Argument(metavar="ADDRESS", help="Address: serial:PATH or tcp://host:port")],
    units: Annotated[int, Option(min=1, max=247, metavar="N", help="Number of Modbus units to try, from 1")] = 16,
    silence_s: Annotated[float, Option(min=0.05, max=5.0, metavar="S", help="Time limit of each answer")] = 0.3,
    as_json: Json = False,
) -> None:
    """Find the baud rate, parity and unit at which a device answers. It only reads, and moves nothing."""
    from polishd.commissioning.device_profiles import find_verb

    find_verb(profile, address, units, silence_s, as_json=as_json)
