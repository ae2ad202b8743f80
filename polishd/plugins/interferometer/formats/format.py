"""What all map formats have alike: a name, a version, magic numbers, and how a map is made of what was read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polishd.api import SurfaceMap, SurfaceReader
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import sha256_of
from polishd.plugins.interferometer.formats.scales import NOTHING, SAID, HeightUnit, Pitch

NOT_SAID = "the file does not say that this is a surface"


@dataclass(frozen=True, slots=True)
class Format:
    """A map format; its reader and writer are functions of its module."""

    name: str
    version: int
    """Of the reader: higher where the same file gives another map than before."""
    magic: tuple[bytes, ...] = ()
    """What such a file starts with."""

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
        """What the plugin declares; ``sniff`` where a magic number is not all that tells the format."""
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
            warnings=(*left.values(), *warnings),
            unsaid=frozenset(unsaid | left.keys()),
            doubts=left,
            reader_version=self.version,
            **{"format": self.name} | about,
        )
