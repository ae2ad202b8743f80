"""Zernike terms in words of optics, and what would tell one that no pose does."""

from __future__ import annotations

from collections.abc import Iterable

FOLDS = {2: "astigmatism", 3: "trefoil", 4: "tetrafoil", 5: "pentafoil", 6: "hexafoil"}
RANKS = ("", "secondary ", "tertiary ")
RADIUS = "a reference of known radius or a flat of known power"
OTHER_FOLDS = "more angles that share no fold, and a lateral shift"
ROUND = "a lateral shift of the part, or a reference"


def name_of(n: int, m: int) -> str:
    """The family's name of a term, without its direction: astigmatism for (2, 2) and (2, -2)."""
    fold = abs(m)
    if (n, fold) == (2, 0):
        return "power"
    first = 4 if fold == 0 else 3 if fold == 1 else fold
    rank = (n - first) // 2
    family = {0: "spherical", 1: "coma"}.get(fold) or FOLDS.get(fold, f"{fold}-foil")
    return f"{RANKS[rank]}{family}" if rank < len(RANKS) else f"{family} of order {n}"


def term_name(n: int, m: int) -> str:
    """A single term: its family, and cos or sin where it has a direction."""
    return name_of(n, m) + (" cos" if m > 0 else " sin" if m < 0 else "")


def families(pairs: Iterable[tuple[int, int]]) -> list[str]:
    """Names of terms, each family once, lowest order first."""
    ordered = sorted({(n, abs(m)) for n, m in pairs}, key=lambda pair: (pair[0] + pair[1], pair[1]))
    return list(dict.fromkeys(name_of(n, m) for n, m in ordered))


def reference_for(n: int, m: int, angles_deg: Iterable[float] = ()) -> str:
    """What tells a term that the poses do not: power only a reference, m = 0 a shift, the rest another angle."""
    if (n, m) == (2, 0):
        return RADIUS
    if m == 0:
        return ROUND
    used = ", ".join(f"{angle:g}" for angle in angles_deg)
    turn = 180 / abs(m)
    return f"one more angle, {turn:g} deg from one of {used or 'those measured'}"
