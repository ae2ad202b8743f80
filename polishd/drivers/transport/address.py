"""Device addresses as the config writes them.

    tcp://host:port                    a TCP peer
    serial:PATH?baud=115200            a serial line or pseudo-terminal
    slcan:PATH?bitrate=500000          a CAN bus behind a serial adapter (also ``baud``)
    socketcand://host:port/channel     a CAN bus behind a socketcand server

Relative paths start from the folder that the caller names (the config's own).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import SplitResult, parse_qsl, urlsplit

from polishd.model.errors import ConfigError

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
    """A serial line, 8N1."""

    path: Path
    baud: int = 115_200

    def __str__(self) -> str:
        return f"serial:{self.path}"


@dataclass(frozen=True, slots=True)
class Slcan:
    """A CAN bus behind a serial adapter that speaks slcan."""

    path: Path
    bitrate: int = 500_000
    baud: int = 115_200

    def __str__(self) -> str:
        return f"slcan:{self.path}"


@dataclass(frozen=True, slots=True)
class Socketcand:
    """A CAN bus behind a socketcand server."""

    host: str
    port: int
    channel: str

    def __str__(self) -> str:
        return f"socketcand://{self.host}:{self.port}/{self.channel}"


Address = Tcp | SerialLine | Slcan | Socketcand


def parse_address(text: str, base_dir: Path) -> Address:
    """Read an address; ConfigError names the address and what is wrong with it."""
    try:
        return _parse(urlsplit(text), base_dir)
    except ValueError as error:
        raise ConfigError(f"address {text!r}: {error}") from error


def _parse(url: SplitResult, base_dir: Path) -> Address:
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
            return Socketcand(*_host_port(url), channel)
        case "serial":
            return SerialLine(_path(url, base_dir), **_numbers(options, {"baud"}))
        case "slcan":
            slcan = Slcan(_path(url, base_dir), **_numbers(options, {"bitrate", "baud"}))
            if slcan.bitrate not in CAN_BITRATES:
                raise ValueError(f"bitrate {slcan.bitrate} is none of {', '.join(map(str, CAN_BITRATES))}")
            return slcan
    raise ValueError("it starts with none of tcp:, serial:, slcan:, socketcand:")


def _options(url: SplitResult) -> dict[str, str]:
    if url.fragment:
        raise ValueError("it has a fragment (#)")
    pairs = parse_qsl(url.query, keep_blank_values=True, strict_parsing=True) if url.query else []
    if len(dict(pairs)) != len(pairs):
        raise ValueError("an option is given twice")
    return dict(pairs)


def _numbers(options: Mapping[str, str], known: set[str]) -> dict[str, int]:
    for name, value in options.items():
        if name not in known:
            raise ValueError(f"unknown option {name!r}, known: {', '.join(sorted(known))}")
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
