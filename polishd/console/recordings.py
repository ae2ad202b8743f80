"""``polishd record``: what a recording of a cell's wires holds."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

from rich.console import Group

from polishd.ports.tap import WireMessage
from polishd.ports.wire_file import Recording, read_recording
from polishd.show.tables import emit, key_table, record_table

COLUMNS = ("device", "link", "opened", "out", "in", "from s", "to s", "longest silence s")


def show_verb(file: Path, *, as_json: bool) -> None:
    """A table of its links; ConfigError where the file is no recording."""
    found = read_recording(file)
    links = _links(found)
    header = {key: value for key, value in found.header.items() if key not in ("polishd_wire", "devices")}
    facts = [*header.items(), *(("missing", note) for note in found.notes)]
    emit(
        {**header, "devices": found.header.get("devices", {}), "links": links, "missing": list(found.notes)},
        as_json=as_json,
        table=lambda: Group(key_table(file.name, facts), record_table("links", COLUMNS, map(_row, links))),
    )


def _links(found: Recording) -> list[dict[str, Any]]:
    by_link: dict[tuple[str, str], list[WireMessage]] = {}
    for one in found.passed:
        by_link.setdefault((one.role, one.link), []).append(one)
    return [{"device": role, "link": link, **_counts(passed)} for (role, link), passed in by_link.items()]


def _row(link: dict[str, Any]) -> tuple[object, ...]:
    """Of COLUMNS."""
    ways = (f"{link[way]} ({link[f'bytes_{way}']} B)" for way in ("out", "in"))
    times = (link[key] for key in ("first_s", "last_s", "longest_silence_s"))
    return (link["device"], link["link"], link["opened"], *ways, *times)


def _counts(passed: list[WireMessage]) -> dict[str, Any]:
    """``longest_silence_s``: of what came, while the link was open."""
    out, came = ([one for one in passed if one.way == way] for way in ("out", "in"))
    heard = [one for one in passed if one.way != "out"]
    gaps = [after.at_s - before.at_s for before, after in pairwise(heard) if after.way == "in" and before.way != "end"]
    return {
        "opened": sum(one.way == "open" for one in passed),
        "out": len(out),
        "bytes_out": sum(len(one.data) for one in out),
        "in": len(came),
        "bytes_in": sum(len(one.data) for one in came),
        "first_s": round(passed[0].at_s, 3),
        "last_s": round(passed[-1].at_s, 3),
        "longest_silence_s": round(max(gaps, default=0.0), 3),
    }
