"""Whether a map that is whole is the one that is waited for: of this part, new, in order, and plausible."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from polishd.api import StaleMap, SurfaceMap, WrongPart
from polishd.model.instrument import Instrument
from polishd.plugins.interferometer.files import FileIdentity
from polishd.plugins.interferometer.taken import MapRequest, TakenMaps, heights_digest
from polishd.process.instrument import require_profile

LATEST_S = 2.0**35
"""Some file systems can date a file later than datetime can hold; that is a thousand years from now."""


@dataclass(frozen=True, slots=True)
class MapAcceptanceRules:
    """What every map is held against."""

    part_id: str
    accept_unnamed: bool
    clock_tolerance_s: float
    instrument: Instrument | None


def source_of(surface: SurfaceMap) -> str:
    """Part and instrument: times are in order only among maps of the same."""
    return f"{surface.part_id} | {surface.instrument}"


def require_plausible(surface: SurfaceMap, rules: MapAcceptanceRules) -> None:
    """WrongPart where it shows another part; BadMap where the profile, or none, cannot be applied to it."""
    if not surface.part_id and not rules.accept_unnamed:
        raise WrongPart(f"it does not say whose map it is; the part is {rules.part_id!r}")
    if surface.part_id and surface.part_id != rules.part_id:
        raise WrongPart(f"it shows part {surface.part_id!r}, the part is {rules.part_id!r}")
    require_profile(surface, rules.instrument)  # the daemon applies it, a refusal is ours


def require_new(
    surface: SurfaceMap, seen: tuple[Path, FileIdentity], ask: MapRequest, taken: TakenMaps, rules: MapAcceptanceRules
) -> None:
    """StaleMap, in words for: duplicate, out of order, stale. A name with the token of the ask is new in any case.

    WrongPart where it names no part, and has the heights of a map that was taken for another one.
    """
    path, identity = seen
    if surface.sha256 == ask.after or surface.sha256 in taken:
        raise StaleMap(f"duplicate: the same content was taken before (sha256 {surface.sha256[:12]}…)")
    if not surface.part_id and (other := taken.other_part(heights_digest(surface), rules.part_id)):
        raise WrongPart(
            f"it does not say whose map it is, and has the heights of a map that was taken for part {other!r}; the "
            f"part is {rules.part_id!r}"
        )
    if ask.token in path.name:
        return
    nevertheless = (
        f". If that is a clock's mistake and the map is the one to use, move it back as {path.stem}-{ask.token}"
        f"{path.suffix} while it is waited for; else measure again"
    )
    measured, last = surface.measured_at, taken.last(source_of(surface))
    if measured is not None and last is not None and measured < last:
        raise StaleMap(
            f"out of order: measured at {measured.isoformat()}, before the last map that was taken, of "
            f"{last.isoformat()}, both by the instrument's clock{nevertheless}"
        )
    if ask.since is None:
        return
    tolerance = timedelta(seconds=rules.clock_tolerance_s)
    written = datetime.fromtimestamp(min(max(identity.mtime_ns / 1e9, 0), LATEST_S), UTC)
    at, how = (measured, "measured") if measured else (written, "its header has no date that counts; written")
    if at < ask.since - tolerance:
        raise StaleMap(
            f"stale: {how} at {at.isoformat()}, before it was asked for at {ask.since.isoformat()} by the folder's "
            f"clock{nevertheless}"
        )
    if ask.present.get(path.name) == identity and abs(written - ask.since) > tolerance:
        raise StaleMap(f"stale: it lay there when the map was asked for, at {ask.since.isoformat()}{nevertheless}")
