"""Summary of the rows of many cases: medians with intervals, paired differences, sensitivity, shares of failure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from polishd.studies.result_store import OVER, Row

SURE = 0.95
"""Confidence of all intervals."""
LABELS = ("scenario", "plant", "size_is", "name", "loop", "correction", "disturbance", "family")
"""Columns that label a row; cases are compared by the last one present."""
FIGURES: dict[str, tuple[str, ...]] = {
    "loop": ("true_rms_end_nm", "passes_to_tolerance"),
    "corrections": ("rms_nm", "pv_nm", "dwell_s"),
    "spots": ("removal_depth_nm", "volume_mm3", "jsd_x_y"),
    "paths": ("msf_nm", "line_peak", "rms_nm", "time_s"),
    "passes": ("pv_share", "slope", "correlation"),
}
"""Figures to summarize, by kind of study; sensitivity is computed for the first."""
SEED = "first_seed"
"""A key that is swept only for other draws; no figure depends on it."""
THIRDS = ("lowest third", "middle third", "highest third")
NEVER = math.inf
"""Passes to tolerance of a job that did not reach it: above all others, and a median of such is none."""


@dataclass(frozen=True, slots=True)
class MedianInterval:
    """A median and its interval with confidence ``SURE``; None: never reached, or not known."""

    median: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class LabelGroup:
    """All rows of one label."""

    label: Mapping[str, str]
    cases: int
    failed: int
    """Cases with an error, and jobs that did not reach tolerance."""
    share: tuple[float, float, float]
    """Share of failures, and its interval (Wilson's)."""
    errors: int
    figures: Mapping[str, MedianInterval]


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """One label against the first, with the same draws."""

    label: Mapping[str, str]
    against: str
    figure: str
    pairs: int
    lower: int
    """Pairs in which its figure is the lower one, ..."""
    same: int
    higher: int
    difference: MedianInterval
    """Its figure minus the other's, where both have one."""


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Correlation of a figure with a swept key: Spearman's rank correlation, -1 to 1."""

    label: Mapping[str, str]
    key: str
    figure: float | None
    fails: float | None
    """The same for failing (1) and not (0)."""


@dataclass(frozen=True, slots=True)
class FailureRegion:
    """Failures in a part of a key's values."""

    label: Mapping[str, str]
    key: str
    where: str
    cases: int
    share: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Summary:
    """The whole summary."""

    kind: str
    rows: int
    groups: tuple[LabelGroup, ...]
    paired: tuple[PairedDifference, ...]
    sensitivity: tuple[Sensitivity, ...]
    fails: tuple[FailureRegion, ...]

    def as_json(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)


def summarise(rows: Iterable[Row]) -> Summary:
    """Summarize the rows of a study, in their order."""
    known = [{**row, "passes_to_tolerance": _to_tolerance(row)} for row in rows]
    kind = kind_of(known)
    names = _told(known)
    by_label: dict[tuple[str, ...], list[Row]] = {}
    for row in known:
        if all(row.get(name) is not None for name in names):
            by_label.setdefault(tuple(str(row[name]) for name in names), []).append(row)
    groups = {label: dict(zip(names, label, strict=True)) for label in by_label}
    keys = [key for key in dict.fromkeys(key for row in known for key in row) if key.startswith(OVER)]
    keys = [key for key in keys if key != OVER + SEED]
    return Summary(
        kind=kind,
        rows=len(known),
        groups=tuple(_group(groups[label], mine, kind) for label, mine in by_label.items()),
        paired=tuple(_all_paired(by_label, groups, kind)),
        sensitivity=tuple(
            _sensitivity(groups[label], mine, key, kind) for label, mine in by_label.items() for key in keys
        ),
        fails=tuple(
            one for label, mine in by_label.items() for key in keys for one in _fails(groups[label], mine, key)
        ),
    )


def _told(rows: Sequence[Row]) -> list[str]:
    """Return the labels that differ between rows; without any, the last one present."""
    values = {name: {row[name] for row in rows if row.get(name) is not None} for name in LABELS}
    return [name for name in LABELS if len(values[name]) > 1] or [name for name in LABELS if values[name]][-1:]


def kind_of(rows: Sequence[Row]) -> str:
    """Return the kind of study of the rows."""
    if any(row.get("loop") is not None for row in rows):  # also of jobs none of which has a figure
        return "loop"
    return next(
        (kind for kind, figures in FIGURES.items() if any(row.get(figures[0]) is not None for row in rows)), "loop"
    )


def failed(row: Row) -> bool:
    """True for an error, and for a job that did not reach tolerance."""
    return bool(row.get("error")) or row.get("accepted") is False


def middle(values: Sequence[float]) -> MedianInterval:
    """Return the median and its interval, by ranks: no distribution is assumed."""
    from scipy.stats import binom

    ordered, n = sorted(values), len(values)
    if not n:
        return MedianInterval(None, None, None)
    median = float(np.median(ordered)) if not math.isinf(ordered[n // 2]) else NEVER
    below = int(binom.ppf((1 - SURE) / 2, n, 0.5))
    inside = below > 0
    low, high = (ordered[below - 1], ordered[n - below]) if inside else (None, None)
    return MedianInterval(*(None if one is None or math.isinf(one) else float(one) for one in (median, low, high)))


def share(count: int, of: int) -> tuple[float, float, float]:
    """Return a share, and its interval."""
    from scipy.stats import binomtest

    ends = binomtest(count, of).proportion_ci(SURE, method="wilson")
    return count / of, float(ends.low), float(ends.high)


def _to_tolerance(row: Row) -> float | None:
    if "accepted" not in row or row["accepted"] is None:
        return None
    return float(row["passes"]) if row["accepted"] else NEVER


def _group(label: Mapping[str, str], rows: Sequence[Row], kind: str) -> LabelGroup:
    bad = sum(map(failed, rows))
    figures = {name: middle([row[name] for row in rows if row.get(name) is not None]) for name in FIGURES[kind]}
    return LabelGroup(
        label, len(rows), bad, share(bad, len(rows)), sum(bool(row.get("error")) for row in rows), figures
    )


def _all_paired(
    by_label: Mapping[tuple[str, ...], Sequence[Row]], groups: Mapping[tuple[str, ...], Mapping[str, str]], kind: str
) -> Iterable[PairedDifference]:
    """Compare each label with the first one that agrees in all else."""
    first: dict[tuple[str, ...], tuple[str, ...]] = {}
    for label, rows in by_label.items():
        if not label:
            return
        other = first.setdefault(label[:-1], label)
        if other != label:
            for figure in FIGURES[kind]:
                yield _paired(groups[label], other[-1], rows, by_label[other], figure)


def _paired(
    label: Mapping[str, str], against: str, rows: Sequence[Row], others: Sequence[Row], figure: str
) -> PairedDifference:
    theirs = {(row["point"], row["seed"]): row.get(figure) for row in others}
    pairs = [
        (row[figure], other)
        for row in rows
        if row.get(figure) is not None and (other := theirs.get((row["point"], row["seed"]))) is not None
    ]
    both = [mine - other for mine, other in pairs if not math.isinf(mine) and not math.isinf(other)]
    return PairedDifference(
        label,
        against,
        figure,
        len(pairs),
        sum(mine < other for mine, other in pairs),
        sum(mine == other for mine, other in pairs),
        sum(mine > other for mine, other in pairs),
        middle(both),
    )


def _sensitivity(label: Mapping[str, str], rows: Sequence[Row], key: str, kind: str) -> Sensitivity:
    figure = FIGURES[kind][0]
    pairs = [(row[key], row[figure]) for row in rows if _is_number(row.get(key)) and row.get(figure) is not None]
    fails = [(row[key], float(failed(row))) for row in rows if _is_number(row.get(key))]
    return Sensitivity(label, key.removeprefix(OVER), _rank_correlation(pairs), _rank_correlation(fails))


def _rank_correlation(pairs: Sequence[tuple[float, float]]) -> float | None:
    from scipy.stats import spearmanr

    x, y = ([float(pair[one]) for pair in pairs] for one in (0, 1))
    if len(set(x)) < 2 or len(set(y)) < 2:
        return None
    return float(spearmanr(x, y).statistic)


def _fails(label: Mapping[str, str], rows: Sequence[Row], key: str) -> Iterable[FailureRegion]:
    """Divide by thirds of a key's values where it has many, by value where it has few."""
    have = [row for row in rows if row.get(key) is not None]
    values = [row[key] for row in have]
    if not values:
        return
    if len(set(map(str, values))) > len(THIRDS) and all(map(_is_number, values)):
        ends = np.quantile(values, [1 / 3, 2 / 3])
        wheres = [THIRDS[int(np.searchsorted(ends, value, side="left"))] for value in values]
        names: Iterable[str] = THIRDS
    else:
        wheres = [str(value) for value in values]
        names = dict.fromkeys(wheres)
    for name in names:
        mine = [row for row, where in zip(have, wheres, strict=True) if where == name]
        if mine:
            yield FailureRegion(
                label, key.removeprefix(OVER), name, len(mine), share(sum(map(failed, mine)), len(mine))
            )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
