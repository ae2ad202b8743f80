"""Settings of an instrument that its files do not state, and the records that prove them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal

RegisterBy = Literal["none", "aperture", "fiducials", "both"]


@dataclass(frozen=True, slots=True)
class CommissioningRecord:
    """The proof of a profile: an artefact with an asymmetric bump was measured and found the right way round."""

    at: datetime
    artefact: str
    """Name of the artefact."""
    map_sha256: str
    correlation: float
    """Hash of the map with the artefact, after the profile."""
    next_best: float
    """The best correlation of any other of the 8 turns and flips, plain or negated."""
    profile_sha256: str
    """Hash of the proved values; a profile that was edited since is not commissioned."""


@dataclass(frozen=True, slots=True)
class UnmeasuredTerms:
    """Prior size of the instrument's undetermined terms: one standard deviation, nm RMS.

    Those of a transmission flat of a twentieth of a wave: much power and astigmatism, less of what polishing evens out.
    """

    power_nm: float = 5.0
    astigmatism_nm: float = 5.0
    """Size of each of its two terms, as of all that have a direction."""
    coma_nm: float = 2.0
    spherical_nm: float = 1.0
    other_nm: float = 0.5
    """Size of a term of radial order 4; other orders n scale with (4 / n)^2, as polished surfaces do."""
    shorter_nm: float = 0.5
    """RMS of all waves shorter than the terms, where no poses tell how much they left."""

    def of(self, n: int, m: int) -> float:
        """Return the prior size of a Zernike term above tilt."""
        named = {(2, 0): self.power_nm, (2, 2): self.astigmatism_nm, (3, 1): self.coma_nm, (4, 0): self.spherical_nm}
        return named.get((n, abs(m)), self.other_nm * (4 / n) ** 2)


@dataclass(frozen=True, slots=True)
class SystemErrorRecord:
    """Record of a system map: the instrument's error from maps of a turned part."""

    map: str
    """Its file, as the profile names it."""
    at: datetime
    map_sha256: str
    profile_sha256: str
    """Hash of the profile's values for those maps; with other values the system map does not apply."""


@dataclass(frozen=True, slots=True)
class Instrument:
    """An instrument's profile: how its arrays lie on the part, and what its numbers mean.

    A map is flipped left-right where ``mirror``, then turned by ``rotation_deg`` counter-clockwise; its heights are
    multiplied by ``sign`` and ``factor``. The result is the part as the tool sees it: x right, y up, high positive.
    """

    name: str
    mirror: bool = False
    rotation_deg: Literal[0, 90, 180, 270] = 0
    sign: Literal[1, -1] = 1
    factor: float = 1.0
    """Multiplies every height: 0.5 for wavefronts in reflection that a file gives as they are."""
    unit_nm: float | None = None
    """nm per unit of heights in files that name no unit."""
    pitch_mm: float | None = None
    """Pitch of files that give none. One that a file gives must agree within ``pitch_tolerance``."""
    coordinate_unit_mm: float | None = None
    """mm per unit of coordinates in files that list points and name no unit."""
    pitch_tolerance: float = 0.02
    gives: frozenset[str] = frozenset()
    """Entries of ``SurfaceMap.unsaid`` that the profile answers without a number ("surface", "orientation")."""
    serials: tuple[str, ...] = ()
    """Instruments (``SurfaceMap.instrument``) that this profile is of; empty: any."""
    aperture_mm: float | None = None
    """Diameter of the outline that maps of the part show; None: the part's own aperture."""
    aperture_tolerance_mm: float = 1.0
    fiducials_mm: tuple[tuple[float, float], ...] = ()
    """(x, y) on the part of at least three marks in no symmetric arrangement."""
    fiducial_tolerance_mm: float = 0.5
    register_by: RegisterBy = "none"
    max_shift_mm: float = 2.0
    max_turn_deg: float = 2.0
    max_drift_mm: float = 0.5
    """Most shift against the last map of the same part."""
    repeatability_nm: float | None = None
    """RMS of what one map of a part has and the mean of many has not; None: not known."""
    unseen: UnmeasuredTerms = UnmeasuredTerms()
    commissioned: CommissioningRecord | None = None
    raw: Mapping[str, Any] = field(default_factory=dict)
    """The values as the file gives them."""
