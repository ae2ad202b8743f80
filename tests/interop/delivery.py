"""What every server of files has to take from us: the same for all of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.api import DeviceRefused
from polishd.drivers.transport.file_delivery import Delivery

USER, PASSWORD = "robot", "s3cret"
TEXT = b"G1 X1.25 Y-3.5 F60\n" * 50_000
"""Near a megabyte."""


def found(folder: Path) -> dict[str, bytes]:
    """All that is there."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


async def takes_programs(delivery: Delivery, folder: Path) -> None:
    """A new one, and another in its place; nothing else is left behind."""
    await delivery.put("part.nc", TEXT)
    assert found(folder) == {"part.nc": TEXT}
    await delivery.put("part.nc", b"M2\n")
    assert found(folder) == {"part.nc": b"M2\n"}


async def refuses(delivery: Delivery, folder: Path, why: str) -> None:
    """One clear error, and what was there before still is."""
    before = found(folder)
    with pytest.raises(DeviceRefused, match=why):
        await delivery.put("part.nc", b"M30\n")
    assert found(folder) == before
