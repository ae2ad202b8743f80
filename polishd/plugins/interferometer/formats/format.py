"""Common part of all map formats: name, version, magic numbers, and the making of a map from what was read."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polishd.api import MapError, SurfaceMap, SurfaceReader
from polishd.model.surface import FloatArray, MapStep
from polishd.plugins.interferometer.formats.common import NOTHING, SAID, HeightUnit, Pitch, oddities, sha256_of

NOT_SAID = "the file does not say that this is a surface"


@dataclass(frozen=True, slots=True)
class Format:
    """A map format; its reader and writer are functions of its module."""

    name: str
    version: int
    """Of the reader: higher where the same file gives another map than before."""
    magic: tuple[bytes, ...] = ()
    """First bytes of such a file."""

    def sniff(self, head: bytes, path: Path) -> bool:  # noqa: ARG002  a reader may also judge by name
        """True where the file starts with one of the magic numbers."""
        return head.startswith(self.magic)

    def reader(
        self,
        read: Callable[[Path], SurfaceMap],
        *suffixes: str,
        sniff: Callable[[bytes, Path], bool] | None = None,
        write: Callable[[SurfaceMap], bytes] | None = None,
        dates: bool = True,
    ) -> SurfaceReader:
        """The declaration for the plugin; ``sniff`` where a magic number does not identify the format."""
        return SurfaceReader(self.name, sniff or self.sniff, read, suffixes, write, dates)

    def surface(
        self,
        path: Path,
        content: bytes | str,
        height_nm: FloatArray,
        *,
        height: HeightUnit = SAID,
        lateral: Pitch,
        doubts: Mapping[str, str] = NOTHING,
        warnings: tuple[str, ...] = (),
        unsaid: frozenset[str] | set[str] = frozenset(),
        **about: Any,
    ) -> SurfaceMap:
        """The map of heights that were checked: what their unit and pitch leave open comes before what else is.

        ``content``: the file's, or its sha256 where that is all that is left of it. ``doubts``: what the file leaves to
        the profile, and what to warn of until that answers; ``unsaid``: what it leaves without a word.
        """
        left = {**height.doubts, **lateral.doubts, **doubts}
        return SurfaceMap(
            height_nm=height_nm,
            pitch_mm=lateral.mm,
            pitches_mm=lateral.both_mm,
            sha256=content if isinstance(content, str) else sha256_of(content),
            path=path,
            warnings=(*left.values(), *oddities(height_nm, lateral), *warnings),
            unsaid=frozenset(unsaid | left.keys()),
            doubts=left,
            reader_version=self.version,
            **{"format": self.name} | about,
        )


# A map's history in the texts of the files that are written here: a line of JSON behind a mark, or a few words.

MARK = "polishd history: "
WRITTEN, BRIEF_BYTES = "written by polishd", 82
BRIEF = re.compile(
    rf"{WRITTEN} (?P<version>\S+): (?P<verb>\w+)(?P<mixed>; mixed)?(?:; profile (?P<name>.+))?", re.DOTALL
)


def line_of(surface: SurfaceMap) -> str | None:
    """The line that keeps it; None where there is none. MapError where it has grown beyond what is read back."""
    if surface.history is None:
        return None
    try:
        return MARK + surface.history.to_json()
    except ValueError as error:
        raise MapError(f"its history is too long: {error}; begin with the measured maps again") from error


def found_in(text: str) -> tuple[MapStep | None, tuple[str, ...]]:
    """The history in a text that may hold other lines, too, and a warning where it is broken: the heights are not."""
    lines = [line.strip() for line in text.splitlines()]
    kept = [line.removeprefix(MARK) for line in lines if line.startswith(MARK)]
    if not kept:
        return None, ()
    try:
        return MapStep.from_json(kept[-1]), ()
    except ValueError as error:
        reason = str(error).splitlines()[0]
        return None, (f"its history cannot be read: {reason}",)


def brief_of(surface: SurfaceMap) -> bytes:
    """What a comment of 82 letters holds of it: the last verb, and what no later reader may overlook, of any step."""
    step = surface.history
    if step is None:
        return WRITTEN.encode()
    options: dict[str, Any] = {}
    for one in step.steps:
        options |= one.options
    mixed = "; mixed" if options.get("mixed") else ""
    profile = f"; profile {options['profile']}" if "profile" in options else ""
    return f"{WRITTEN} {step.version}: {step.verb}{mixed}{profile}".encode("latin-1", "replace")[:BRIEF_BYTES]


def found_in_brief(comment: str) -> MapStep | None:
    """The step, without its inputs; None where the comment is another's, or says nothing."""
    found = BRIEF.fullmatch(comment)
    if found is None:
        return None
    options: dict[str, Any] = {"mixed": True} if found["mixed"] else {}
    return MapStep(found["verb"], found["version"], options | ({"profile": found["name"]} if found["name"] else {}), ())
