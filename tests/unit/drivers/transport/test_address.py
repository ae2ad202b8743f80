"""Addresses: what is read, and that nothing is guessed."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.api import ConfigError
from polishd.drivers.transport.address import Address, SerialLine, SlcanAddress, SocketcandAddress, Tcp, parse_address

HERE = Path("/etc/cell")


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("tcp://127.0.0.1:28500", Tcp("127.0.0.1", 28500)),
        ("tcp://robot.local:1", Tcp("robot.local", 1)),
        ("tcp://[::1]:502", Tcp("::1", 502)),
        ("serial:sim/actuator?baud=9600", SerialLine(HERE / "sim/actuator", 9600)),
        ("serial:/dev/ttyUSB0", SerialLine(Path("/dev/ttyUSB0"), 115_200)),
        ("serial:x?baud=19200&parity=even&stop_bits=2", SerialLine(HERE / "x", 19_200, "even", 2)),
        ("slcan:sim/spindle?bitrate=250000&baud=57600", SlcanAddress(HERE / "sim/spindle", 250_000, 57_600)),
        ("slcan:/dev/ttyACM0", SlcanAddress(Path("/dev/ttyACM0"), 500_000, 115_200)),
        ("socketcand://localhost:29536/can0", SocketcandAddress("localhost", 29536, "can0")),
    ],
)
def test_addresses_are_read(text: str, address: Address) -> None:
    assert parse_address(text, HERE) == address


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "starts with none of"),
        ("robot:28500", "starts with none of"),
        ("udp://host:1", "starts with none of"),
        ("/dev/ttyUSB0", "starts with none of"),
        ("tcp://host", "host and port"),
        ("tcp://:502", "host and port"),
        ("tcp:host:502", "tcp://host:port"),
        ("tcp://host:0", "host and port"),
        ("tcp://host:70000", "0-65535"),
        ("tcp://host:port", "port"),
        ("tcp://host:1/path", "tcp://host:port"),
        ("tcp://host:1?baud=9600", "tcp://host:port"),
        ("tcp://me@host:1", "user name"),
        ("serial:", "serial:PATH"),
        ("serial://dev/ttyUSB0", "serial:PATH"),
        ("serial:x?baud=fast", "no positive number"),
        ("serial:x?baud=0", "no positive number"),
        ("serial:x?baud=-9600", "no positive number"),
        ("serial:x?parity=mark", "parity 'mark' is none of none, even, odd"),
        ("serial:x?stop_bits=3", "stop_bits is 1 or 2"),
        ("serial:x?bitrate=500000", "unknown option 'bitrate'"),
        ("serial:x?baud=1&baud=2", "given twice"),
        ("serial:x?baud", "bad query"),
        ("serial:x#1", "fragment"),
        ("slcan:x?bitrate=123456", "is none of"),
        ("socketcand://host:1", "/channel"),
        ("socketcand://host:1/a/b", "/channel"),
        ("socketcand://host/can0", "host and port"),
    ],
)
def test_bad_addresses_are_config_errors(text: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason) as error:
        parse_address(text, HERE)
    assert repr(text) in str(error.value)


@pytest.mark.parametrize("text", ["tcp://a:1", "serial:/dev/ttyS0", "slcan:/dev/ttyS0", "socketcand://a:1/can0"])
def test_addresses_say_what_they_are(text: str) -> None:
    assert str(parse_address(text, HERE)) == text


def test_what_an_address_leaves_out_is_as_usual() -> None:
    usual = SerialLine(Path(), 9600, "odd", 2)
    assert parse_address("serial:x", HERE, usual) == SerialLine(HERE / "x", 9600, "odd", 2)
    assert parse_address("serial:x?baud=4800&parity=none", HERE, usual) == SerialLine(HERE / "x", 4800, "none", 2)


@pytest.mark.parametrize(
    ("line", "settings", "bits"),
    [(SerialLine(HERE), "115200 8N1", 10), (SerialLine(HERE, 9600, "even", 2), "9600 8E2", 12)],
)
def test_settings_as_people_write_them(line: SerialLine, settings: str, bits: int) -> None:
    assert line.settings == settings
    assert line.byte_s == pytest.approx(bits / line.baud)
