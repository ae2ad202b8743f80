"""Instruments' profiles: TOML to an ``Instrument``, and the record of the proof back into the file."""

from __future__ import annotations

import hashlib
import json
import tomllib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import tomlkit

from polishd.config.document import load_toml
from polishd.config.places import TomlSource
from polishd.config.profile_sections import ProfileFile
from polishd.files import write_atomic
from polishd.model.errors import ConfigError
from polishd.model.instrument import CommissioningRecord, Instrument, SystemErrorRecord, UnmeasuredTerms
from polishd.process.commissioning import ArtefactBump

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
