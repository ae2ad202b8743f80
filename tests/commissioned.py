"""Write commissioned instrument profiles for tests."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from polishd.commissioning.rehearsal.simulated_cell import with_values
from polishd.config.instrument_profile import load_profile, write_commissioned
from polishd.drivers.cia402.device_types import SIMULATED_EDS
from polishd.model.instrument import CommissioningRecord

SHIPPED = Path(__file__).resolve().parents[1] / "examples" / "instrument.toml"
AT = datetime(2026, 5, 4, 12, 0, tzinfo=UTC)


def forged(path: Path) -> Path:
    """Add the commissioning record to a profile, as if its values had been verified."""
    write_commissioned(path, CommissioningRecord(AT, "three bumps", "0" * 64, 0.99, 0.4, load_profile(path).sha256))
    return path


def commissioned(folder: Path, **tables: dict[str, Any]) -> Path:
    """Write the shipped profile with changes as commissioned ``instrument.toml``, and the EDS file of the cell."""
    (folder / "drive.eds").write_bytes(SIMULATED_EDS.read_bytes())
    path = folder / "instrument.toml"
    path.write_text(with_values(SHIPPED.read_text(), tables))
    return forged(path)
