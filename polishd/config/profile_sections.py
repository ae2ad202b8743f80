"""The tables of an instrument's profile: one frozen model each. What they mean: docs/instruments.md."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AwareDatetime, BeforeValidator, Field, StringConstraints, model_validator

from polishd.config.document import TomlDocument
from polishd.config.values import (
    Angle,
    BumpSection,
    ConfigSection,
    NotNegative,
    Pair,
    Positive,
    Share,
    Text,
    Texts,
    as_tuple,
)
from polishd.model.instrument import Instrument, RegisterBy

_PLAIN = Instrument("")
Places = Annotated[tuple[Pair, ...], BeforeValidator(as_tuple)]
Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Given = Annotated[tuple[Literal["surface", "orientation"], ...], BeforeValidator(as_tuple)]
MIN_FIDUCIALS = 3


class OrientationTable(ConfigSection):
    """How the instrument's arrays lie on the part: flipped left-right first, then turned counter-clockwise."""

    mirror: bool = _PLAIN.mirror
    """Whether arrays are flipped left-right, ..."""
    rotation_deg: Literal[0, 90, 180, 270] = _PLAIN.rotation_deg
    """... then turned counter-clockwise: the part as the tool sees it, x right, y up."""


class HeightTable(ConfigSection):
    """What the numbers mean."""

    sign: Literal[1, -1] = _PLAIN.sign
    """Multiplies every height; -1 where high is negative. [1]"""
    factor: Positive = _PLAIN.factor
    """Multiplies every height; 0.5 where files give wavefronts in reflection as they are. [1]"""
    unit_nm: Positive | None = _PLAIN.unit_nm
    """Nanometres per unit, for files that name no unit."""


class LateralTable(ConfigSection):
    """The pitch of files that give none, and how far one that a file gives may be from it."""

    pitch_mm: Positive | None = _PLAIN.pitch_mm
    """Pitch of files that give none; one that a file gives must agree."""
    pitch_tolerance: Share = _PLAIN.pitch_tolerance
    """How far one that a file gives may be off, relative. [1]"""


class ApertureTable(ConfigSection):
    """The outline that maps of the part show; without a diameter: the part's own aperture."""

    diameter_mm: Positive | None = _PLAIN.aperture_mm
    """Diameter of the outline that maps of the part show; left out: the part's own aperture."""
    tolerance_mm: Positive = _PLAIN.aperture_tolerance_mm
    """How far the outline may be off that."""


class FiducialsTable(ConfigSection):
    """Marks on the part."""

    positions_mm: Places = _PLAIN.fiducials_mm
    """(x, y) on the part of three or more marks in no symmetric arrangement."""
    tolerance_mm: Positive = _PLAIN.fiducial_tolerance_mm
    """How far a mark may be off its place after the fit."""


class RegistrationTable(ConfigSection):
    """By what each map is laid on the part, and how far off it may have lain."""

    by: RegisterBy = _PLAIN.register_by
    """What tells where the part lies: nothing (the array's centre is the part's), its outline, its marks, or both,
    which must agree."""
    max_shift_mm: Positive = _PLAIN.max_shift_mm
    """Most that the part may lie off the array's centre; a map with more is refused."""
    max_turn_deg: Annotated[float, Field(gt=0, le=45)] = _PLAIN.max_turn_deg
    """Most that it may be turned."""
    max_drift_mm: Positive = _PLAIN.max_drift_mm
    """Most shift against the last map of the same part."""


class RepeatabilityTable(ConfigSection):
    """How well the instrument repeats itself: no part of the proof, but all figures are read beside it."""

    rms_nm: Positive | None = _PLAIN.repeatability_nm
    """RMS of what one map of a part has and the mean of many has not, levelled, in one set-up; left out: not known."""


class UnseenTable(ConfigSection):
    """How large the instrument's own error may be where nothing has told it: one standard deviation, nm RMS.

    No part of the proof. A reference that was measured makes a number smaller: a sphere of known radius `power_nm`.
    """

    power_nm: NotNegative = _PLAIN.unseen.power_nm
    """Power, which no turn and no shift of the part tells."""
    astigmatism_nm: NotNegative = _PLAIN.unseen.astigmatism_nm
    """Astigmatism, in each of its two directions."""
    coma_nm: NotNegative = _PLAIN.unseen.coma_nm
    """Coma, likewise."""
    spherical_nm: NotNegative = _PLAIN.unseen.spherical_nm
    """Spherical aberration."""
    other_nm: NotNegative = _PLAIN.unseen.other_nm
    """Each other Zernike term: of radial order 4, of other orders n times (4 / n)^2."""
    shorter_nm: NotNegative = _PLAIN.unseen.shorter_nm
    """All waves shorter than the terms together, where there is no system map; with one its poses tell it."""


class SystemTable(ConfigSection):
    """What ``polishd calibrate instrument`` wrote: the instrument's own error, which is taken off each map."""

    map: Text
    """File of the system map, from the profile's folder."""
    at: AwareDatetime
    """When it was made."""
    map_sha256: Sha256
    """Of that file: another one is refused."""
    profile_sha256: Sha256
    """Of the profile's values by which its maps were read: once one is changed, the map is refused."""


class BumpTable(BumpSection):
    """A Gaussian bump of the artefact; a hollow where its height is negative."""

    angle_deg: Angle = 0.0
    """How its own x is turned, counter-clockwise."""


class ArtefactTable(ConfigSection):
    """The artefact that proves the profile."""

    name: Text
    """The artefact's name, for the record."""
    bumps: Annotated[tuple[BumpTable, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    """Its bumps: no turn, flip or negation of them may look like the original."""


class RecordTable(ConfigSection):
    """What ``polishd map commission`` wrote."""

    at: AwareDatetime
    """When it was proved."""
    artefact: Text
    """Name of the artefact that proved it."""
    map_sha256: Sha256
    """Of the map that proved it."""
    correlation: Annotated[float, Field(ge=-1, le=1)]
    """Of that map with the artefact. [1]"""
    next_best: Annotated[float, Field(ge=-1, le=1)]
    """Of the best other turn, flip or negation. [1]"""
    profile_sha256: Sha256
    """Of the profile's values that were proved: once one is changed, the record is void."""


class ProfileFile(TomlDocument):
    """The whole file."""

    name: Text
    """The instrument's name."""
    serials: Texts = _PLAIN.serials
    """Words of what `polishd map` shows as "instrument"; maps of any other are refused. Zygo's numbers
    also by their last 16 bits, as `.dat` has them. Empty: any."""
    gives: Given = ()
    """What this profile answers for files that do not say it: that heights are of the surface, and how arrays lie."""
    orientation: OrientationTable = OrientationTable()
    height: HeightTable = HeightTable()
    lateral: LateralTable = LateralTable()
    aperture: ApertureTable = ApertureTable()
    fiducials: FiducialsTable = FiducialsTable()
    registration: RegistrationTable = RegistrationTable()
    repeatability: RepeatabilityTable = RepeatabilityTable()
    unseen: UnseenTable = UnseenTable()
    system: SystemTable | None = None
    artefact: ArtefactTable | None = None
    commissioned: RecordTable | None = None

    @model_validator(mode="after")
    def _has_marks(self) -> Self:
        count = len(self.fiducials.positions_mm)
        if count < MIN_FIDUCIALS and self.registration.by in {"fiducials", "both"}:
            raise ValueError(
                f'registration: by = "{self.registration.by}" needs at least {MIN_FIDUCIALS} fiducials.positions_mm; '
                f"there are {count}"
            )
        return self
