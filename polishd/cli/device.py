"""The verbs of ``polishd device``: options only. What they do lives in the modules beside."""

from __future__ import annotations

from typing import Annotated, Literal

import typer
from typer import Argument, Option

from polishd.util.command_line import CommandGroup, Json

app = typer.Typer(
    cls=CommandGroup, help="Profiles of drives and sensors: what a Modbus or line device speaks, as data."
)

Profile = Annotated[str, Argument(metavar="NAME|FILE.toml", help="One of polishd's own, or a file.")]
Raw = Annotated[
    list[str] | None,
    Option("--raw", metavar="NAME=WORDS", help="Say how this reads: force=0x04AE, or status='C 12.0' of an ask."),
]


@app.command("list")
def list_profiles(as_json: Json = False) -> None:
    """The profiles that polishd brings."""
    from polishd.commissioning.device_profiles import list_verb

    list_verb(as_json=as_json)


@app.command()
def show(
    profile: Profile,
    toml: Annotated[bool, Option("--toml", help="The file itself, to make one of your own from.")] = False,
    as_json: Json = False,
) -> None:
    """What a profile says: source, settings at the device, values, orders."""
    from polishd.commissioning.device_profiles import show_verb

    show_verb(profile, toml=toml, as_json=as_json)


@app.command()
def check(profile: Profile, raw: Raw = None, as_json: Json = False) -> None:
    """Check a profile, and say what follows from it: requests as they are sent, and how values read."""
    from polishd.commissioning.device_profiles import check_verb

    check_verb(profile, raw or [], as_json=as_json)


@app.command()
def new(
    kind: Annotated[Literal["actuator", "spindle", "force_sensor"], Argument(help="What it is.")],
    link: Annotated[Literal["modbus", "lines"], Option(help="What it speaks.")] = "modbus",
    as_json: Json = False,
) -> None:
    """A template with comments, for a profile of your own: polishd device new spindle > mine.toml."""
    from polishd.commissioning.device_profiles import new_verb

    new_verb(kind, link, as_json=as_json)


@app.command()
def scan(
    profile: Profile,
    address: Annotated[str, Argument(metavar="ADDRESS", help="serial:PATH or tcp://host:port.")],
    units: Annotated[int, Option(min=1, max=247, help="Modbus units to try, from 1.")] = 16,
    silence_s: Annotated[float, Option(min=0.05, max=5.0, help="So long each is given to answer.")] = 0.3,
    as_json: Json = False,
) -> None:
    """Look for the baud rate, parity and unit at which a device answers. Reads only, and moves nothing."""
    from polishd.commissioning.device_profiles import find_verb

    find_verb(profile, address, units, silence_s, as_json=as_json)
