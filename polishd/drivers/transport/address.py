"""Device addresses as the config writes them.

    tcp://host:port                    a TCP peer
    serial:PATH?baud=115200            a serial line or pseudo-terminal (also ``parity=none|even|odd``, ``stop_bits``)
    slcan:PATH?bitrate=500000          a CAN bus behind a serial adapter (also ``baud``)
    socketcand://host:port/channel     a CAN bus behind a socketcand server

Relative paths start from the folder that the caller passes (the config's folder).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, cast
from urllib.parse import SplitResult, parse_qsl, urlsplit

from polishd.model.errors import ConfigError

Parity = Literal["none", "even", "odd"]
PARITIES = ("none", "even", "odd")
CAN_BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 750_000, 1_000_000)


@dataclass(frozen=True, slots=True)
class Tcp:
    """A TCP peer."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"tcp://{self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class SerialLine:
    """A serial line of eight data bits."""

    path: Path
    baud: int = 115_200
    parity: Parity = "none"
    stop_bits: int = 1

    def __str__(self) -> str:
        return f"serial:{self.path}"

    @property
    def settings(self) -> str:
        """The usual notation: ``9600 8E1``."""
        return f"{self.baud} 8{self.parity[0].upper()}{self.stop_bits}"

    @property
    def byte_s(self) -> float:
        """Time of one byte on the line: start, data, parity and stop bits."""
        return (9 + (self.parity != "none") + self.stop_bits) / self.baud


@dataclass(frozen=True, slots=True)
class SlcanAddress:
    """A CAN bus behind a serial adapter that speaks slcan."""

    path: Path
    bitrate: int = 500_000
    baud: int = 115_200

    def __str__(self) -> str:
        return f"slcan:{self.path}"


@dataclass(frozen=True, slots=True)
class SocketcandAddress:
    """A CAN bus behind a socketcand server."""

    host: str
    port: int
    channel: str

    def __str__(self) -> str:
        return f"socketcand://{self.host}:{self.port}/{self.channel}"


Address = Tcp | SerialLine | SlcanAddress | SocketcandAddress


def parse_address(text: str, base_dir: Path, usual: SerialLine | None = None) -> Address:
    """Parse an address; ConfigError names the address and its error.

    ``usual`` supplies the settings of a serial line that the address omits.
    """
    try:
        return _parse(urlsplit(text), base_dir, usual or SerialLine(Path()))
    except ValueError as error:
        raise ConfigError(f"address {text!r}: {error}") from error


def line_address(text: str, base_dir: Path, who: str, usual: SerialLine | None = None) -> SerialLine | Tcp:
    """Parse the address of a byte stream; ConfigError if ``who`` does not support it."""
    address = parse_address(text, base_dir, usual)
    if isinstance(address, SerialLine | Tcp):
        return address
    raise ConfigError(f"address {text!r}: {who} is reached over serial: or tcp://")


def tcp_address(text: str, base_dir: Path, who: str) -> Tcp:
    """Parse the address of a TCP peer; ConfigError if ``who`` does not support it."""
    address = parse_address(text, base_dir)
    if isinstance(address, Tcp):
        return address
    raise ConfigError(f"address {text!r}: {who} runs over tcp:// only")


def can_address(text: str, base_dir: Path, who: str) -> SlcanAddress | SocketcandAddress:
    """Parse the address of a CAN bus; ConfigError if ``who`` does not support it."""
    address = parse_address(text, base_dir)
    if isinstance(address, SlcanAddress | SocketcandAddress):
        return address
    raise ConfigError(f"address {text!r}: {who} runs over slcan: or socketcand:// only")


def _parse(url: SplitResult, base_dir: Path, usual: SerialLine) -> Address:
    options = _options(url)
    match url.scheme:
        case "tcp":
            if url.path or options:
                raise ValueError("write tcp://host:port")
            return Tcp(*_host_port(url))
        case "socketcand":
            channel = url.path.strip("/")
            if not channel or "/" in channel or options:
                raise ValueError("write socketcand://host:port/channel")
            return SocketcandAddress(*_host_port(url), channel)
        case "serial":
            return _serial(replace(usual, path=_path(url, base_dir)), options)
        case "slcan":
            slcan = SlcanAddress(_path(url, base_dir), **_numbers(options, {"bitrate", "baud"}))
            if slcan.bitrate not in CAN_BITRATES:
                raise ValueError(f"bitrate {slcan.bitrate} is none of {', '.join(map(str, CAN_BITRATES))}")
            return slcan
    raise ValueError("it starts with none of tcp:, serial:, slcan:, socketcand:. Write it as one of them")


def _serial(line: SerialLine, options: dict[str, str]) -> SerialLine:
    _known(options, {"baud", "parity", "stop_bits"})
    parity = options.pop("parity", line.parity)
    if parity not in PARITIES:
        raise ValueError(f"parity {parity!r} is none of {', '.join(PARITIES)}")
    numbers = {"baud": line.baud, "stop_bits": line.stop_bits, **_numbers(options, {"baud", "stop_bits"})}
    found = SerialLine(line.path, numbers["baud"], cast("Parity", parity), numbers["stop_bits"])
    if found.stop_bits > 2:
        raise ValueError(f"stop_bits is 1 or 2, not {found.stop_bits}")
    return found


def _options(url: SplitResult) -> dict[str, str]:
    if url.fragment:
        raise ValueError("it has a fragment (#)")
    pairs = parse_qsl(url.query, keep_blank_values=True, strict_parsing=True) if url.query else []
    if len(dict(pairs)) != len(pairs):
        raise ValueError("an option is given twice")
    return dict(pairs)


def _known(options: Mapping[str, str], known: set[str]) -> None:
    for name in options:
        if name not in known:
            raise ValueError(f"unknown option {name!r}, known: {', '.join(sorted(known))}")


def _numbers(options: Mapping[str, str], known: set[str]) -> dict[str, int]:
    _known(options, known)
    for name, value in options.items():
        if not (value.isascii() and value.isdigit() and int(value) > 0):
            raise ValueError(f"{name} is no positive number: {value!r}")
    return {name: int(value) for name, value in options.items()}


def _host_port(url: SplitResult) -> tuple[str, int]:
    if not url.hostname or not url.port:
        raise ValueError("host and port are needed")
    if url.username is not None:
        raise ValueError("it has a user name")
    return url.hostname, url.port


def _path(url: SplitResult, base_dir: Path) -> Path:
    if url.netloc or not url.path:
        raise ValueError(f"write {url.scheme}:PATH")
    return base_dir / url.path


def garbled(address: SerialLine | Tcp, came: bytes, silence_s: float, other: str = "") -> str:
    """Describe bytes that arrived instead of an answer, with their likely cause; ``other`` names a further cause."""
    within = f"within {silence_s:g} s" + (f" at {address.settings}" if isinstance(address, SerialLine) else "")
    text = came.decode("latin-1").strip()
    if text.isascii() and text.isprintable():
        return f"{text[:40]!r} {within} is not an answer. Check {f'{other} and ' if other else ''}the device."
    serial = isinstance(address, SerialLine)
    todo = "baud rate, parity and stop bits" if serial else "the address and the device"
    shown = f"{came[:8].hex(' ')}{' ...' if len(came) > 8 else ''}"
    return f"{len(came)} bytes {within} are not an answer ({shown}). Check {todo}."


def silent(address: SerialLine | Tcp, silence_s: float, other: str = "") -> str:
    """Describe a missing answer with its likely cause: ``within 0.3 s at 9600 8N1; see ...``; ``other`` adds one."""
    if isinstance(address, SerialLine):
        looked, causes = f" at {address.settings}", ["baud rate", "parity", *filter(None, [other])]
    else:
        looked, causes = "", ["port", *filter(None, [other])]
    named = " and ".join(filter(None, [", ".join(causes[:-1]), causes[-1]]))
    return f"within {silence_s:g} s{looked}. Check power, {named}."
