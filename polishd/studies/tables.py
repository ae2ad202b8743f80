"""Tables and sentences of studies, for people. Programs read the output of ``--json``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from polishd.config.study import PassesStudy, SpotsStudy
from polishd.rendering.terminal import figure_table, key_table
from polishd.studies.case_runner import LoopRow, LoopRows
from polishd.studies.corrections import (
    DIVERGENCE_BASE,
    PLANTS,
    TABLE_IV,
    TABLE_IV_RATIO,
    CorrectionComparison,
    CorrectionRow,
    tie_words,
)
from polishd.studies.spots import READINGS, Passes, SpotRow, shape_words

MOST_NOTES = 12
PLANT_WORDS = {"eq49": "plant eq. 49: R0 diag(gamma)", "depth": "plant depth: each point's spot at its own depth"}


def correction_tables(title: str, compared: CorrectionComparison) -> list[Table]:
    """Return one table for each plant, the paper's Table IV beside it."""
    return [_correction_table(f"{title}, {PLANT_WORDS[plant]}", compared, plant) for plant in PLANTS]


def _correction_table(title: str, compared: CorrectionComparison, plant: str) -> Table:
    columns = ("correction", "PV nm", "RMS nm", "/ none", "less piston", "LSF nm", "dwell s", "wall s")
    rows = [
        (row.correction, *_correction_cells(row, compared.ratio(plant, row.correction)))
        for row in compared.rows
        if row.plant == plant
    ]
    return figure_table(title, (*columns, "paper PV", "RMS"), rows)


def _correction_cells(row: CorrectionRow, ratio: float) -> list[str]:
    paper = TABLE_IV.get(row.correction)
    return [
        f"{row.pv_nm:.3f}",
        f"{row.rms_nm:.4f}",
        f"{ratio:.4f}",
        f"{row.rms_piston_removed_nm:.4f}",
        f"{row.band_rms_nm:.4f}",
        f"{row.dwell_s:.1f}",
        f"{row.wall_s:.1f}",
        *(("", "") if paper is None else (f"{paper[0]:.2f}", f"{paper[1]:.2f}")),
    ]


def correction_notes(compared: CorrectionComparison) -> list[str]:
    """Return the ties, our ratio beside the paper's, and notes on the solutions."""
    ours = ", ".join(f"{name} {compared.ratio('depth', name):.3g}" for name in ("linear", "power", "exact"))
    return [
        *tie_words(compared),
        f"RMS over that of none, plant depth: {ours}; the paper's Table IV has {TABLE_IV_RATIO:g} for linear",
        "the paper publishes neither its start nor its plant: its rows are printed beside ours, not reproduced",
        *compared.notes,
    ]


def spot_tables(study: SpotsStudy, rows: tuple[SpotRow, ...]) -> list[Table]:
    """Return one table for each reading of the size, the paper's figures beside ours."""
    return [
        _spot_table(f"{study.title}, {study.seconds:g} s, size = {reading}", [r for r in rows if r.size_is == reading])
        for reading in READINGS
    ]


def _spot_table(title: str, rows: list[SpotRow]) -> Table:
    ours = ("#", "mm", "rpm", "N", "dip", "depth um", "a mm", "peak nm", "mm3", "pole/a", "x", "JSD x-y")
    return figure_table(title, (*ours, "D-PE %", "V-PE %", "JSD"), map(_spot_cells, rows))


def _spot_cells(row: SpotRow) -> list[str]:
    spot, figures = row.section, row.figures
    paper = (spot.paper_depth_error_percent, spot.paper_volume_error_percent, spot.paper_jsd)
    return [
        row.name,
        f"{spot.size_mm:g}",
        f"{spot.rpm:g}",
        f"{spot.force_n:g}",
        f"{spot.dip_deg:g}",
        f"{figures.depth_mm * 1e3:.1f}",
        f"{figures.contact_radius_mm:.3f}",
        f"{row.removal_depth_nm:.0f}",
        f"{row.volume_mm3:.5f}",
        f"{figures.pole_mm / figures.contact_radius_mm:.2f}",
        "M" if figures.m_shaped else "bell",
        f"{row.divergence:.2g}",
        *("" if value is None else f"{value:g}" for value in paper),
    ]


def spot_notes(rows: tuple[SpotRow, ...]) -> list[str]:
    """Explain the columns that could be misread."""
    return [
        *shape_words(rows),
        f"JSD x-y is the Jensen-Shannon divergence of our x profile from our y profile, log base {DIVERGENCE_BASE:g}",
        "D-PE, V-PE and JSD are the paper's, of its measured spots from its own model; it does not state its log base",
        "it prints no depth, volume or profile of a spot: nothing here can be held against those three",
    ]


def passes_table(study: PassesStudy, passes: Passes) -> Table:
    """Return removal and its correlation with gamma."""
    inside = passes.gamma[passes.metric_mask]
    uneven = f"PV {passes.pv_nm:.3f} nm ({passes.pv_nm / passes.mean_nm:.2%}), RMS {passes.rms_nm:.3f} nm"
    rows = [
        ("passes", f"{passes.passes} of {study.dwell_s:g} s at each point"),
        ("gamma", f"{inside.min():.4f} to {inside.max():.4f} over the clear aperture"),
        ("removal", f"mean {passes.mean_nm:.2f} nm, where equal dwell should remove evenly"),
        ("nonuniformity", uneven),
        ("correlation with gamma", f"{passes.correlation:.6f}"),
        ("slope of log removal on log gamma", f"{passes.slope:.4f} (Hertz 1.5; eq. 48-49 take it for 1)"),
    ]
    return key_table(f"{study.title}: equal dwell", rows)


def loop_table(title: str, looped: LoopRows) -> Table:
    """Return one row for each scenario and loop."""
    columns = ("scenario", "loop", "jobs", "accepted", "passes", "after pass 1 nm", "true RMS nm")
    return figure_table(
        title, (*columns, "falsely", "named rightly", "as expected", "CPU s"), map(_loop_cells, looped.rows)
    )


def _loop_cells(row: LoopRow) -> list[str]:
    return [
        row.scenario,
        row.loop,
        str(row.runs),
        str(row.accepted),
        "not reached" if row.passes_median is None else f"{row.passes_median:g}",
        "" if row.first_pass_nm_median is None else f"{row.first_pass_nm_median:.2f}",
        "" if row.true_rms_nm_median is None else f"{row.true_rms_nm_median:.2f}",
        str(row.false_accepts),
        str(row.named_rightly),
        f"{row.held} of {row.forecasts}" if row.forecasts else "",
        f"{row.cpu_s_median:.1f}",
    ]


def _share(looped: LoopRows) -> str:
    held, of = (sum(getattr(row, name) for row in looped.rows) for name in ("held", "forecasts"))
    return f"{held / of:.0%} of {of}" if of else "none came so far"


def loop_notes(looped: LoopRows) -> list[str]:
    """Explain the columns, and list why loops stopped."""
    stopped = {f"{run.scenario}, {run.loop}, seed {run.seed}: {run.why}": None for run in looped.runs if run.why}
    shown = list(stopped)[:MOST_NOTES]
    more = [f"... and {len(stopped) - len(shown)} more that were stopped"] if len(stopped) > len(shown) else []
    return [
        "passes, RMS and CPU are medians; passes count to tolerance, true RMS is the part's own at the job's end",
        "falsely: accepted, and the part itself is out of tolerance; named rightly: what is wrong, and nothing else",
        f"as expected: passes that left what their plan had expected with a chance of nine in ten ({_share(looped)})",
        *shown,
        *more,
    ]


def error_notes(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return why cases have no figures, and how many of each."""
    why = Counter(str(row["error"]) for row in rows if row.get("error"))
    lines = [f"{count} of them: {words}" for words, count in why.most_common(MOST_NOTES)]
    return [f"{sum(why.values())} of {len(rows)} cases have an error instead of figures:", *lines] if why else []
