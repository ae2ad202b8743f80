"""``polishd map commission``: prove an instrument's profile with a map of its artefact, and record it in the file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from polishd.console.map_files import map_from, own_readers, require_picture
from polishd.daemon.instrument_file import Profile, load_profile, write_commissioned
from polishd.model.errors import ConfigError
from polishd.model.instrument import Commissioned
from polishd.model.surface import SurfaceMap
from polishd.process.commissioning import Proof, artefact_heights, prove
from polishd.process.instrument import as_profiled


@dataclass(frozen=True, slots=True)
class Proved:
    """A profile, the map that proves it, and how well."""

    profile: Profile
    surface: SurfaceMap
    """As the profile turns and scales it."""
    proof: Proof
    record: Commissioned


def commission_verb(profile: Path, surface: Path, out: Path | None, *, as_json: bool) -> None:
    """Prove and record; a table and, with ``out``, a picture.

    Raises:
        BadMap: the map does not show the artefact as the profile has it; the file is as it was.
        ConfigError: the profile or the picture's file is wrong.
    """
    from polishd.console.verbs import emit

    require_picture(out)
    proved = prove_profile(profile, surface)
    if out is not None:
        from polishd.console.pictures import save_picture

        save_picture(out, _picture(proved))
    facts = {"profile": str(profile), **asdict(proved.proof), **asdict(proved.record)}
    emit(facts, as_json=as_json, table=lambda: _table(proved))


def prove_profile(profile: Path, surface: Path) -> Proved:
    """Prove a profile by a map of its artefact, and write the record into its file; errors as of the verb."""
    given = load_profile(profile)
    if not given.bumps:
        raise ConfigError(f"{profile}: [artefact] is missing; describe the artefact's bumps (docs/instruments.md)")
    seen = as_profiled(map_from(surface, own_readers()), given.instrument)
    proof = prove(seen, given.bumps)
    record = Commissioned(
        at=datetime.now(UTC).replace(microsecond=0),
        artefact=given.artefact,
        map_sha256=seen.sha256,
        correlation=proof.correlation,
        next_best=proof.next_best,
        profile_sha256=given.sha256,
    )
    write_commissioned(profile, record)
    return Proved(given, seen, proof, record)


def _table(proved: Proved) -> object:
    from polishd.console.tables import key_table

    proof, (x, y) = proved.proof, proved.proof.shift_mm
    rows = (
        ("artefact", proved.profile.artefact),
        ("correlation", f"{proof.correlation:.4f}"),
        ("next best", f"{proof.next_best:.4f} ({proof.next_best_name})"),
        ("height, map over artefact", f"{proof.scale:.4f}"),
        ("size, map over artefact", f"{proof.pitch_ratio:.4f}"),
        ("pitch", f"{proved.surface.grid.pitch_mm:.6g} mm"),
        ("artefact's place", f"({x:+.2f}, {y:+.2f}) mm, turned {proof.turn_deg:+.2f} deg"),
    )
    return key_table(f"{proved.profile.instrument.name}: commissioned", rows)


def _picture(proved: Proved) -> bytes:
    """PNG: the artefact as it is expected, and as it is seen, on one scale."""
    import numpy as np

    from polishd.plugins.run_report.style import DIVERGING, figure, png, polishd_style

    seen = proved.surface
    expected = np.where(seen.valid, artefact_heights(proved.profile.bumps, seen.grid), np.nan)
    limit = float(np.nanmax(np.abs(expected)))
    half_x, half_y = seen.grid.nx * seen.grid.pitch_mm / 2, seen.grid.ny * seen.grid.pitch_mm / 2
    proof = proved.proof
    found = f"As it is seen: correlates {proof.correlation:.3f}, next {proof.next_best:.3f}"
    with polishd_style():
        page = figure(8.4, 3.8)
        axes = page.subplots(1, 2)
        for ax, height, title in zip(axes, (expected, seen.height_nm), ("The artefact", found), strict=True):
            levelled = height - np.nanmedian(height)
            ax.imshow(levelled, cmap=DIVERGING, vmin=-limit, vmax=limit, extent=(-half_x, half_x, -half_y, half_y))
            ax.set(title=title, xlabel="x, mm", ylabel="y, mm")
        page.colorbar(axes[0].images[0], ax=list(axes), shrink=0.85, label="nm")
        return png(page)
