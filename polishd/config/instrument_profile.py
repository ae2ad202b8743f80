"""Instrument profiles: read the TOML file as an ``Instrument``, and write the commissioning record into it."""

from __future__ import annotations

import hashlib
import json
import tomllib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

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

# The tables of an instrument's profile: one frozen model each. docs/how-to/instruments.md describes them.

_PLAIN = Instrument("")
Places = Annotated[tuple[Pair, ...], BeforeValidator(as_tuple)]
Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Given = Annotated[tuple[Literal["surface", "orientation"], ...], BeforeValidator(as_tuple)]
MIN_FIDUCIALS = 3


class OrientationTable(ConfigSection):
    """Orientation of the instrument's arrays on the part: mirrored left-right first, then rotated counter-clockwise."""

    mirror: bool = _PLAIN.mirror
    """Mirror arrays left-right before the rotation."""
    rotation_deg: Literal[0, 90, 180, 270] = _PLAIN.rotation_deg
    """Rotation of arrays counter-clockwise, to the part as the tool sees it: x right, y up."""


class HeightTable(ConfigSection):
    """Meaning of the heights."""

    sign: Literal[1, -1] = _PLAIN.sign
    """Factor of every height; -1 if high is negative. [1]"""
    factor: Positive = _PLAIN.factor
    """Factor of every height; 0.5 if files give wavefronts in reflection. [1]"""
    unit_nm: Positive | None = _PLAIN.unit_nm
    """Nanometers per unit, for files without a unit."""


class LateralTable(ConfigSection):
    """Pitch of files without one, the unit of coordinates, and the tolerance."""

    pitch_mm: Positive | None = _PLAIN.pitch_mm
    """Pitch of files without one. The pitch of a file must agree with it."""
    coordinate_unit_mm: Positive | None = _PLAIN.coordinate_unit_mm
    """Millimeters per unit of the coordinates, for lists of points without a unit. They have a pitch then."""
    pitch_tolerance: Share = _PLAIN.pitch_tolerance
    """Largest relative deviation of a file's pitch. [1]"""


class ApertureTable(ConfigSection):
    """The outline that maps of the part show."""

    diameter_mm: Positive | None = _PLAIN.aperture_mm
    """Diameter of the outline that maps of the part show. Left out: the part's aperture."""
    tolerance_mm: Positive = _PLAIN.aperture_tolerance_mm
    """Largest deviation of the outline from it."""


class FiducialsTable(ConfigSection):
    """Marks on the part."""

    positions_mm: Places = _PLAIN.fiducials_mm
    """Positions (x, y) on the part of three or more marks in an asymmetric arrangement."""
    tolerance_mm: Positive = _PLAIN.fiducial_tolerance_mm
    """Largest deviation of a mark from its position after the fit."""


class RegistrationTable(ConfigSection):
    """Registration of each map on the part, and its limits."""

    by: RegisterBy = _PLAIN.register_by
    """Reference of the part's position: none (the array's center is the part's), its outline, its marks, or both, which
    must agree."""
    max_shift_mm: Positive = _PLAIN.max_shift_mm
    """Largest distance of the part from the array's center. A map with a larger one is refused."""
    max_turn_deg: Annotated[float, Field(gt=0, le=45)] = _PLAIN.max_turn_deg
    """Largest rotation of the part."""
    max_drift_mm: Positive = _PLAIN.max_drift_mm
    """Largest shift from the last map of the same part."""


class RepeatabilityTable(ConfigSection):
    """Repeatability of the instrument. It is not part of the commissioning; reports show it next to the figures."""

    rms_nm: Positive | None = _PLAIN.repeatability_nm
    """RMS difference between one map and the mean of many, leveled, in one set-up. Left out: unknown."""


class UnseenTable(ConfigSection):
    """Instrument error in terms that no test has measured: one standard deviation, nm RMS.

    It is not part of the commissioning. A measured reference reduces a value: a sphere of known radius `power_nm`.
    """

    power_nm: NotNegative = _PLAIN.unseen.power_nm
    """Power, which rotations and shifts of the part cannot show."""
    astigmatism_nm: NotNegative = _PLAIN.unseen.astigmatism_nm
    """Astigmatism, in each of its two directions."""
    coma_nm: NotNegative = _PLAIN.unseen.coma_nm
    """Coma, in each of its two directions."""
    spherical_nm: NotNegative = _PLAIN.unseen.spherical_nm
    """Spherical aberration."""
    other_nm: NotNegative = _PLAIN.unseen.other_nm
    """Each other Zernike term of radial order 4; for other orders n it is multiplied by (4 / n)^2."""
    shorter_nm: NotNegative = _PLAIN.unseen.shorter_nm
    """All waves shorter than these terms together, if there is no system map. A system map's poses determine it."""


class SystemTable(ConfigSection):
    """Record of ``polishd calibrate instrument``: the instrument's error, which is subtracted from each map."""

    map: Text
    """File of the system map, from the profile's folder."""
    at: AwareDatetime
    """Time of the calibration."""
    map_sha256: Sha256
    """Digest of that file. Another file is refused."""
    profile_sha256: Sha256
    """Digest of the profile's values with which its maps were read. The map is refused after a value has changed."""


class BumpTable(BumpSection):
    """A Gaussian bump of the artefact; a hollow if its height is negative."""

    angle_deg: Angle = 0.0
    """Rotation of its x axis, counter-clockwise."""


class ArtefactTable(ConfigSection):
    """The artefact that commissions the profile."""

    name: Text
    """The artefact's name, for the record."""
    bumps: Annotated[tuple[BumpTable, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    """Its bumps. They must differ clearly from each of their rotations, mirror images and negations."""


class RecordTable(ConfigSection):
    """Record of ``polishd map commission``."""

    at: AwareDatetime
    """Time of the commissioning."""
    artefact: Text
    """Name of the artefact."""
    map_sha256: Sha256
    """Digest of the artefact's map."""
    correlation: Annotated[float, Field(ge=-1, le=1)]
    """Correlation of that map with the artefact. [1]"""
    next_best: Annotated[float, Field(ge=-1, le=1)]
    """Correlation with the best other rotation, mirror image or negation. [1]"""
    profile_sha256: Sha256
    """Digest of the profile's commissioned values. The record is void after a value has changed."""


class ProfileFile(TomlDocument):
    """The file of an instrument's profile."""

    name: Text
    """The instrument's name."""
    serials: Texts = _PLAIN.serials
    """Serial numbers, as `polishd map` shows them under "instrument". Maps of other instruments are refused. The last
    16 bits of a Zygo number fit, too, as in `.dat`. Empty: any instrument."""
    gives: Given = ()
    """Facts that the profile adds for files without them: heights are of the surface, and the orientation of arrays."""
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
"""Tables that may change without voiding the commissioning record."""
COMMENTS = {
    RECORD: "written by polishd map commission; void after a value above has changed",
    SYSTEM: "written by polishd calibrate instrument; void after the map or a commissioned value has changed",
}


@dataclass(frozen=True, slots=True)
class InstrumentProfile:
    """A profile as read from its file."""

    path: Path
    instrument: Instrument
    """``commissioned`` is set only if the record fits the present values."""
    sha256: str
    """Digest of the values with defaults, without the record. Layout and comments do not count."""
    artefact: str
    """Name of the artefact; empty if the file has none."""
    bumps: tuple[ArtefactBump, ...]
    """Bumps of the artefact."""
    unproved: str
    """Reason why maps of this instrument cannot be used for polishing; empty if they can."""
    system: SystemErrorRecord | None
    """Record of the system map, or None."""
    source: TomlSource
    """The file's text, used to locate errors."""

    def error(self, key: str, problem: str) -> ConfigError:
        """Return a ConfigError about a dotted key of the profile, with its location."""
        return ConfigError(self.source.error(tuple(key.split(".")), problem))


def load_profile(path: Path) -> InstrumentProfile:
    """Read an instrument's profile.

    Raises:
        ConfigError: the file cannot be read, or one line per problem: ``FILE:LINE: table.key: problem; what to do``.
    """
    raw, source = load_toml(path)
    given = ProfileFile.of(raw, source)
    values = given.model_dump(mode="json", exclude=UNPROVED)
    if given.lateral.coordinate_unit_mm is None:  # records of profiles from before this key stay valid
        del values["lateral"]["coordinate_unit_mm"]
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
    """Write the commissioning record into the profile's file; raise ConfigError as ``_write``."""
    _write(path, RECORD, record)


def write_system(path: Path, record: SystemErrorRecord) -> None:
    """Write the record of the system map into the profile's file; raise ConfigError as ``_write``."""
    _write(path, SYSTEM, record)


def _write(path: Path, table: str, record: CommissioningRecord | SystemErrorRecord) -> None:
    """Write a record into the profile's file, in place of an earlier one, and keep everything else.

    Raises:
        ConfigError: the file cannot be written, or its layout does not allow it; the file is unchanged.
    """
    import tomlkit  # this import is slow

    before, source = load_toml(path)
    document = tomlkit.parse(source.text)
    if table not in document:
        document.append(None, tomlkit.nl())
        document.append(table, tomlkit.table().comment(COMMENTS[table]))
    for key, value in asdict(record).items():
        document[table][key] = round(value, 6) if isinstance(value, float) else value
    text = tomlkit.dumps(document)
    if tomllib.loads(text) != {**before, table: document[table].unwrap()}:
        raise ConfigError(
            f"{path}: the record cannot be written without changing other values; remove [{table}] and repeat"
        )
    try:
        write_atomic(path, text.encode())
    except OSError as error:
        raise ConfigError(
            f"{path}: the record cannot be written: {error.strerror}. The profile is unchanged"
        ) from error


def _unproved(path: Path, record: CommissioningRecord | None, sha256: str) -> str:
    advice = f"measure the artefact, then run: polishd map commission {path} MAP"
    if record is None:
        return f"{path}: the profile was never commissioned; {advice}"
    if record.profile_sha256 != sha256:
        return f"{path}: the profile was edited after it was commissioned ({record.at:%Y-%m-%d %H:%M}); {advice}"
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
