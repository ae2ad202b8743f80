"""``polishd map commission``: prove an instrument's profile with a map of its artefact, and record the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from rich.table import Table

from polishd.config.instrument_profile import InstrumentProfile, load_profile, write_commissioned
from polishd.maps.map_files import MapSource, mask_lines, mask_records, printable, require_picture
from polishd.model.errors import ConfigError, MapError
from polishd.model.instrument import CommissioningRecord
from polishd.model.surface import SurfaceMap
from polishd.process.metrology.commissioning import ProfileProof, artefact_heights
from polishd.process.metrology.commissioning import prove_profile as prove
from polishd.rendering.terminal import emit, key_table


@dataclass(frozen=True, slots=True)
class CommissioningResult:
    """A profile, the map that proves it, and the differences."""

    profile: InstrumentProfile
    surface: SurfaceMap
    """The map as turned and scaled by the profile."""
    proof: ProfileProof
    record: CommissioningRecord


def commission_verb(
    profile: Path,
    surface: Path,
    out: Path | None,
    cell: Path | None = None,
    masks: Sequence[str] | None = None,
    *,
    as_json: bool,
) -> None:
    """Prove and record; a table and, with ``out``, a picture, which is drawn where nothing is proved, too.

    Raises:
        MapError: the map does not show the artefact as the profile has it; the profile's file is as it was.
        ConfigError: the profile or the picture's file is wrong.
    """
    require_picture(out)
    proved = prove_profile(profile, surface, out, cell, masks)
    facts = {"profile": str(profile), **asdict(proved.proof), **asdict(proved.record)}
    facts["at"] = proved.record.at.isoformat()
    facts["masks"] = mask_records(proved.surface)
    emit(facts, as_json=as_json, table=lambda: _table(proved), lines=mask_lines([printable(surface.name)], [facts]))


def prove_profile(
    profile: Path,
    surface: Path,
    out: Path | None = None,
    cell: Path | None = None,
    masks: Sequence[str] | None = None,
) -> CommissioningResult:
    """Prove a profile by a map of its artefact, and write the record into its file; arguments as in the verb."""
    given = load_profile(profile)
    if not given.bumps:
        raise ConfigError(
            f"{profile}: [artefact] is missing; describe the artefact's bumps (docs/how-to/instruments.md)"
        )
    seen = MapSource.of(cell, profile, None, masks, partly=False, system=False).read(surface)
    try:
        proof = prove(seen, given.bumps)
    except MapError as error:
        _draw(out, given, seen, "As it is seen: not proved")
        raise MapError(f"{surface}: {error}") from error
    except ConfigError as error:
        raise ConfigError(f"{profile}: {error}") from error
    record = CommissioningRecord(
        at=datetime.now(UTC).replace(microsecond=0),
        artefact=given.artefact,
        map_sha256=seen.sha256,
        correlation=proof.correlation,
        next_best=proof.next_best,
        profile_sha256=given.sha256,
    )
    _draw(out, given, seen, f"As it is seen: correlates {proof.correlation:.3f}, next {proof.next_best:.3f}")
    write_commissioned(profile, record)
    return CommissioningResult(given, seen, proof, record)


def _table(proved: CommissioningResult) -> Table:
    proof = proved.proof
    x, y, turn = (round(value, 2) + 0.0 for value in (*proof.shift_mm, proof.turn_deg))  # + 0.0: no "-0.00"
    rows = (
        ("artefact", proved.profile.artefact),
        ("correlation", f"{proof.correlation:.4f}"),
        ("next best", f"{proof.next_best:.4f} ({proof.next_best_name})"),
        ("height, map over artefact", f"{proof.scale:.4f}"),
        ("size, map over artefact", f"{proof.pitch_ratio:.4f}"),
        ("pitch", f"{proved.surface.grid.pitch_mm:.6g} mm"),
        ("artefact's place", f"({x:+.2f}, {y:+.2f}) mm, turned {turn:+.2f} deg"),
    )
    return key_table(f"{proved.profile.instrument.name}: commissioned", rows)


def _draw(out: Path | None, profile: InstrumentProfile, seen: SurfaceMap, title: str) -> None:
    if out is None or seen.pitch_mm is None or not seen.valid.any():
        return
    from polishd.maps.pictures import artefact_picture
    from polishd.rendering.plots import save_picture

    save_picture(out, artefact_picture(artefact_heights(profile.bumps, seen.grid), seen, title))
