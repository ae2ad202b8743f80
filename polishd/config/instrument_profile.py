"""Instruments' profiles: TOML to an ``Instrument``, and the record of the proof back into the file."""

from __future__ import annotations

import hashlib
import json
import tomllib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import tomlkit
from pydantic import AwareDatetime, BeforeValidator, Field, StringConstraints, model_validator

from polishd.config.fields import (
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
from polishd.config.toml_loader import TomlDocument, TomlSource, load_toml
from polishd.model.errors import ConfigError
from polishd.model.instrument import CommissioningRecord, Instrument, RegisterBy, SystemErrorRecord, UnmeasuredTerms
from polishd.process.metrology.commissioning import ArtefactBump
from polishd.util.files import write_atomic

# The tables of an instrument's profile: one frozen model each. What they mean: docs/instruments.md.

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


RECORD, SYSTEM = "commissioned", "system"
UNPROVED = {RECORD, SYSTEM, "repeatability", "unseen"}
"""What no artefact proves: it may be written, and mended, without voiding the proof."""
COMMENTS = {
    RECORD: "written by polishd map commission; void once a value above is changed",
    SYSTEM: "written by polishd calibrate instrument; void once the map, or a value that was commissioned, is changed",
}


@dataclass(frozen=True, slots=True)
class InstrumentProfile:
    """A profile as its file gives it."""

    path: Path
    instrument: Instrument
    """``commissioned`` only where the record is of the values that stand there now."""
    sha256: str
    """Of the values, defaults included, without the record: layout and comments do not count."""
    artefact: str
    """Name of the artefact that proves it; empty where the file describes none."""
    bumps: tuple[ArtefactBump, ...]
    """The artefact's."""
    unproved: str
    """Why no map of this instrument may drive polishing; empty where it may."""
    system: SystemErrorRecord | None
    """The record of its system map; None where there is none."""
    source: TomlSource
    """The file's text: says where a key stands, for errors."""

    def error(self, key: str, problem: str) -> ConfigError:
        """A ConfigError about a dotted key of the profile, with its place."""
        return ConfigError(self.source.error(tuple(key.split(".")), problem))


def load_profile(path: Path) -> InstrumentProfile:
    """Read an instrument's profile.

    Raises:
        ConfigError: it cannot be read, or one line per problem: ``FILE:LINE: table.key: what is wrong; what to do``.
    """
    raw, source = load_toml(path)
    given = ProfileFile.of(raw, source)
    values = given.model_dump(mode="json", exclude=UNPROVED)
    sha256 = hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
    record = None if given.commissioned is None else CommissioningRecord(**dict(given.commissioned))
    unproved = _unproved(path, record, sha256)
    instrument = _instrument(given, {key: value for key, value in raw.items() if key != RECORD})
    return InstrumentProfile(
        path=path,
        instrument=instrument if unproved else replace(instrument, commissioned=record),
        sha256=sha256,
        artefact="" if given.artefact is None else given.artefact.name,
        bumps=() if given.artefact is None else tuple(ArtefactBump(**dict(bump)) for bump in given.artefact.bumps),
        unproved=unproved,
        system=None if given.system is None else SystemErrorRecord(**dict(given.system)),
        source=source,
    )


def write_commissioned(path: Path, record: CommissioningRecord) -> None:
    """Put the proof into the profile's file; ConfigError as of ``_write``."""
    _write(path, RECORD, record)


def write_system(path: Path, record: SystemErrorRecord) -> None:
    """Put the record of the system map into the profile's file; ConfigError as of ``_write``."""
    _write(path, SYSTEM, record)


def _write(path: Path, table: str, record: CommissioningRecord | SystemErrorRecord) -> None:
    """Put a record into the profile's file, for an earlier one; all else stays as the user wrote it.

    Raises:
        ConfigError: the file cannot be written, or its layout does not let the record be put in; it is as it was.
    """
    before, source = load_toml(path)
    document = tomlkit.parse(source.text)
    if table not in document:
        document.append(None, tomlkit.nl())
        document.append(table, tomlkit.table().comment(COMMENTS[table]))
    for key, value in asdict(record).items():
        document[table][key] = round(value, 6) if isinstance(value, float) else value
    text = tomlkit.dumps(document)
    if tomllib.loads(text) != {**before, table: document[table].unwrap()}:
        raise ConfigError(f"{path}: the record cannot be put in without loss; remove [{table}] by hand, then again")
    try:
        write_atomic(path, text.encode())
    except OSError as error:
        raise ConfigError(
            f"{path}: the record cannot be written: {error.strerror}; the profile is as it was"
        ) from error


def _unproved(path: Path, record: CommissioningRecord | None, sha256: str) -> str:
    prove = f"measure the artefact, then: polishd map commission {path} MAP"
    if record is None:
        return f"{path}: the profile was never commissioned; {prove}"
    if record.profile_sha256 != sha256:
        return f"{path}: the profile was edited after it was commissioned ({record.at:%Y-%m-%d %H:%M}); {prove}"
    return ""


def _instrument(given: ProfileFile, raw: dict[str, Any]) -> Instrument:
    return Instrument(
        name=given.name,
        **dict(given.orientation),
        **dict(given.height),
        **dict(given.lateral),
        gives=frozenset(given.gives),
        serials=given.serials,
        aperture_mm=given.aperture.diameter_mm,
        aperture_tolerance_mm=given.aperture.tolerance_mm,
        fiducials_mm=given.fiducials.positions_mm,
        fiducial_tolerance_mm=given.fiducials.tolerance_mm,
        register_by=given.registration.by,
        max_shift_mm=given.registration.max_shift_mm,
        max_turn_deg=given.registration.max_turn_deg,
        max_drift_mm=given.registration.max_drift_mm,
        repeatability_nm=given.repeatability.rms_nm,
        unseen=UnmeasuredTerms(**dict(given.unseen)),
        raw=raw,
    )
