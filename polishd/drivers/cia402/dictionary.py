"""A drive's objects as its EDS file (CiA 306) describes them. The only file that knows ``canopen``."""

from __future__ import annotations

import configparser
import io
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from polishd.api import ConfigError, DeviceRefused, ProtocolError
from polishd.drivers.cia402.codec import Address

if TYPE_CHECKING:
    from canopen.objectdictionary import ObjectDictionary, ODVariable

MOST_BYTES = 4
"""Of an object that an expedited transfer carries."""


@dataclass(frozen=True, slots=True)
class DictionaryEntry:
    """A number of the drive."""

    name: str
    size: int
    """Bytes."""
    signed: bool
    readable: bool
    writable: bool
    low: int
    high: int
    """What may be written: by its type, and by the file's limits."""
    default: int | None


class Dictionary:
    """The numbers that a drive has, from its EDS file."""

    def __init__(self, path: Path, entries: Mapping[Address, DictionaryEntry], lines: Mapping[int, int]) -> None:
        """``lines``: where in the file each index is."""
        self._path = path
        self._entries = entries
        self._lines = lines

    def __contains__(self, address: Address) -> bool:
        return address in self._entries

    def __getitem__(self, address: Address) -> DictionaryEntry:
        """ConfigError where the file has no such number."""
        if address not in self._entries:
            raise ConfigError(f"{self._place(address)}: it has no number {address}, which this drive is worked with")
        return self._entries[address]

    def require(self, *, read: Iterable[Address], write: Iterable[Address]) -> None:
        """ConfigError for the first that is missing, or that does not allow it."""
        for address in read:
            if not self[address].readable:
                raise ConfigError(f"{self._place(address)}: {address} ({self[address].name}) cannot be read")
        for address in write:
            if not self[address].writable:
                raise ConfigError(f"{self._place(address)}: {address} ({self[address].name}) cannot be written")

    def encode(self, address: Address, value: int) -> bytes:
        """The value as it is sent; DeviceRefused where the drive cannot hold it."""
        entry = self[address]
        if not entry.low <= value <= entry.high:
            raise DeviceRefused(f"{address} ({entry.name}) holds {entry.low} to {entry.high}, not {value}")
        return value.to_bytes(entry.size, "little", signed=entry.signed)

    def decode(self, address: Address, data: bytes, *, sized: bool) -> int:
        """The value of what came; ProtocolError where it has not the object's size."""
        entry = self[address]
        if len(data) != entry.size and (sized or len(data) < entry.size):
            raise ProtocolError(f"{address} ({entry.name}) came in {len(data)} bytes, its EDS file says {entry.size}")
        return int.from_bytes(data[: entry.size], "little", signed=entry.signed)

    def _place(self, address: Address) -> str:
        line = self._lines.get(address.index)
        return f"{self._path}:{line}" if line else str(self._path)


def read_dictionary(path: Path, node: int) -> Dictionary:
    """Read an EDS file; ConfigError says what is wrong with it, and where as far as that is known."""
    import canopen
    from canopen.objectdictionary import eds

    try:
        text = _decoded(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if "[DeviceInfo]" not in text:
        raise ConfigError(f"{path}: is no EDS file of CiA 306: it has no section [DeviceInfo]")
    try:
        found = eds.import_eds(io.StringIO(text), node)  # type: ignore[no-untyped-call]
    except (configparser.Error, canopen.ObjectDictionaryError, ValueError, LookupError) as error:
        raise ConfigError(f"{path}: is no EDS file of CiA 306: {' '.join(str(error).split())}") from error
    return Dictionary(path, dict(_numbers(found)), _lines(text))


def emergency_text(code: int) -> str:
    """What an error code of a drive means, as far as CiA 301 says."""
    from canopen.emcy import EmcyError

    known = {
        0x8110: "messages were lost: CAN overrun",
        0x8120: "the bus is bad: CAN in error passive mode",
        0x8130: "watchdog ran out: no heartbeat of the controller",
        0x8140: "recovered from bus-off",
    }
    return known.get(code) or EmcyError(code, 0, b"", 0.0).get_desc().lower() or "unknown error"


def abort_text(code: int) -> str:
    """Why a transfer was refused."""
    from canopen.sdo.exceptions import SdoAbortedError

    return str(SdoAbortedError.CODES.get(code, "no reason that CiA 301 knows")).lower()


def _decoded(data: bytes) -> str:
    """Drives' makers write UTF-8 or, more often, Windows' Latin."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _lines(text: str) -> dict[int, int]:
    heads = (re.fullmatch(r"\[([0-9A-Fa-f]{4})\]\s*", line) for line in text.splitlines())
    return {int(head[1], 16): at for at, head in enumerate(heads, start=1) if head}


def _numbers(found: ObjectDictionary) -> Iterator[tuple[Address, DictionaryEntry]]:
    from canopen.objectdictionary import ODVariable
    from canopen.objectdictionary.datatypes import INTEGER_TYPES

    for index in found:
        node = found[index]
        for variable in [node] if isinstance(node, ODVariable) else [node[sub] for sub in node]:
            if variable.data_type in INTEGER_TYPES and len(variable) <= 8 * MOST_BYTES:
                yield Address(index, variable.subindex), _entry(variable)


def _entry(variable: ODVariable) -> DictionaryEntry:
    from canopen.objectdictionary.datatypes import SIGNED_TYPES

    bits, signed = len(variable), variable.data_type in SIGNED_TYPES
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    least = low if variable.min is None else max(low, variable.min)
    most = high if variable.max is None else min(high, variable.max)
    if least >= most:  # makers' tools leave both limits at 0 where there are none
        least, most = low, high
    return DictionaryEntry(
        name=variable.name,
        size=bits // 8,
        signed=signed,
        readable=variable.readable,
        writable=variable.writable,
        low=least,
        high=most,
        default=variable.default if isinstance(variable.default, int) else None,
    )
