"""The two ways to a simulated CAN bus: slcan and socketcand."""

from __future__ import annotations

from polishd.sim_backends.common.can import SlcanHost, SocketcandHost, slcan_frame, slcan_line


def test_slcan_lines() -> None:
    frame = (0x205, bytes.fromhex("0109e80300000000"))
    assert slcan_line(frame) == b"t20580109e80300000000\r"
    assert slcan_frame(b"t20580109e80300000000") == frame
    assert slcan_frame(b"t2058010") is None
    assert slcan_frame(b"t20x0") is None


def test_slcan_adapter() -> None:
    received = []
    host = SlcanHost(lambda ident, data: received.append((ident, data)) or [(0x585, b"\x01")])
    assert host.feed(b"t2050\r") == b"\a"
    assert host.send([(0x705, b"\5")]) == b""
    assert host.feed(b"C\rS6\rO") == b"\r\r"
    assert host.feed(b"\r") == b"\r"
    assert host.feed(b"t205201ff\r") == b"z\rt585101\r"
    assert received == [(0x205, b"\x01\xff")]
    assert host.send([(0x705, b"\5")]) == b"t705105\r"
    assert host.feed(b"V\rN\rF\rjunk\r") == b"V1013\rNSIM1\rF00\r\a"


def test_socketcand_connection() -> None:
    received = []
    host = SocketcandHost(lambda ident, data: received.append((ident, data)) or [(0x585, b"\x01")])
    assert host.feed(b"< open can0 >< raw") == b"< ok >"
    assert host.send([(0x705, b"\5")]) == b""
    assert host.feed(b"mode >") == b"< ok >"
    assert host.send([(0x705, b"\5")]) == b"< frame 705 0.000000 05 >"
    assert host.feed(b"< send 205 2 1 FF >") == b"< frame 585 0.000000 01 >"
    assert received == [(0x205, b"\x01\xff")]
    assert host.feed(b"< send 205 3 1 FF >< dance >") == b"< error malformed frame >< error unknown command >"
