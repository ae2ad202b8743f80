"""Draw the parts of a soak from the seed: surface, tolerance and script of each."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass

from tests.campaigns.soak.scripts import CALM, SCRIPTS, Script

RMS_NM = (10.0, 25.0)
PV_OF_RMS = (4.5, 6.5)
TOLERANCES_NM = (2.0, 3.0, 4.0, 5.0)


@dataclass(frozen=True, slots=True)
class Part:
    """Part of the soak."""

    number: int
    name: str
    """Name of part and job."""
    rms_nm: float
    """RMS of the initial surface in the clear aperture."""
    pv_nm: float
    tolerance_nm: float
    script: Script


def drawn(seed: int, number: int, only: Sequence[Script] = ()) -> Part:
    """Return the part of that number, always the same. ``only``: scripts to use in turn."""
    luck = random.Random(f"{seed} {number} part")
    rms_nm = luck.uniform(*RMS_NM)
    return Part(
        number=number,
        name=f"S{seed}-{number:04d}",
        rms_nm=round(rms_nm, 2),
        pv_nm=round(rms_nm * luck.uniform(*PV_OF_RMS), 1),
        tolerance_nm=luck.choice(TOLERANCES_NM),
        script=only[number % len(only)] if only else _script(seed, number),
    )


def _script(seed: int, number: int) -> Script:
    """Return a script without a fault after one that ends with a fault: two in a row would stop the queue."""
    script = _raw(seed, number)
    return CALM if script.needs_person and _raw(seed, number - 1).needs_person else script


def _raw(seed: int, number: int) -> Script:
    luck = random.Random(f"{seed} {number} script")
    return luck.choices(SCRIPTS, [script.share for script in SCRIPTS])[0]
