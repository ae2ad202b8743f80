"""The tables of an instrument's profile: one frozen model each. What they mean: docs/instruments.md."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AwareDatetime, BeforeValidator, Field, StringConstraints, model_validator

from polishd.config.document import Document
from polishd.config.values import Angle, Pair, Positive, Section, Share, Text, Texts, as_tuple
from polishd.model.instrument import Instrument, RegisterBy

_PLAIN = Instrument("")
Places = Annotated[tuple[Pair, ...], BeforeValidator(as_tuple)]
Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Given = Annotated[tuple[Literal["surface", "orientation"], ...], BeforeValidator(as_tuple)]
MIN_FIDUCIALS = 3


class OrientationTable(Section):
    """How the instrument's arrays lie on the part: flipped left-right first, then turned counter-clockwise."""

    mirror: bool = _PLAIN.mirror
    rotation_deg: Literal[0, 90, 180, 270] = _PLAIN.rotation_deg


class HeightTable(Section):
    """What the numbers mean."""

    sign: Literal[1, -1] = _PLAIN.sign
    factor: Positive = _PLAIN.factor
    unit_nm: Positive | None = _PLAIN.unit_nm


class LateralTable(Section):
    """The pitch of files that give none, and how far one that a file gives may be from it."""

    pitch_mm: Positive | None = _PLAIN.pitch_mm
    pitch_tolerance: Share = _PLAIN.pitch_tolerance


class ApertureTable(Section):
    """The outline that maps of the part show; without a diameter: the part's own aperture."""

    diameter_mm: Positive | None = _PLAIN.aperture_mm
    tolerance_mm: Positive = _PLAIN.aperture_tolerance_mm


class FiducialsTable(Section):
    """Marks on the part."""

    positions_mm: Places = _PLAIN.fiducials_mm
    tolerance_mm: Positive = _PLAIN.fiducial_tolerance_mm


class RegistrationTable(Section):
    """By what each map is laid on the part, and how far off it may have lain."""

    by: RegisterBy = _PLAIN.register_by
    max_shift_mm: Positive = _PLAIN.max_shift_mm
    max_turn_deg: Annotated[float, Field(gt=0, le=45)] = _PLAIN.max_turn_deg
    max_drift_mm: Positive = _PLAIN.max_drift_mm


class BumpTable(Section):
    """A Gaussian bump of the artefact; a hollow where its height is negative."""

    x_mm: float
    y_mm: float
    sigma_x_mm: Positive
    sigma_y_mm: Positive
    height_nm: float
    angle_deg: Angle = 0.0


class ArtefactTable(Section):
    """The artefact that proves the profile."""

    name: Text
    bumps: Annotated[tuple[BumpTable, ...], BeforeValidator(as_tuple), Field(min_length=1)]


class RecordTable(Section):
    """What ``polishd map commission`` wrote."""

    at: AwareDatetime
    artefact: Text
    map_sha256: Sha256
    correlation: Annotated[float, Field(ge=-1, le=1)]
    next_best: Annotated[float, Field(ge=-1, le=1)]
    profile_sha256: Sha256


class ProfileFile(Document):
    """The whole file."""

    name: Text
    serials: Texts = _PLAIN.serials
    gives: Given = ()
    orientation: OrientationTable = OrientationTable()
    height: HeightTable = HeightTable()
    lateral: LateralTable = LateralTable()
    aperture: ApertureTable = ApertureTable()
    fiducials: FiducialsTable = FiducialsTable()
    registration: RegistrationTable = RegistrationTable()
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
