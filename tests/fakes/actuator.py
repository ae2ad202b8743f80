"""Fake voice-coil actuator according to the protocol documents, on Modbus RTU, Modbus TCP and ASCII."""

from __future__ import annotations

import struct
import time

from tests.fakes.wires import NumberedPeer, Peer

MOVE_S = 0.06
VENDOR, MODEL, SERIAL, FIRMWARE = "Fake Coils", "FC-50", "SN-0042", "1.2"


class Coil:
    """Actuator that moves, monitors its heartbeat and refuses commands."""

    def __init__(self) -> None:
        self.command = 0
        self.setpoint_n = 0.0
        self.watchdog_ms = 500
        self.heartbeat = 0
        self.fault = 0
        self.boots = 3
        self.stuck = False
        self.commands: list[int] = []
        self._position = 0.0
        self._at = self._fed = time.monotonic()

    def feed(self) -> None:
        self.update()
        self._fed = time.monotonic()

    def engage(self) -> bool:
        """Engage; return False where a fault forbids it."""
        self.update()
        self.commands.append(1)
        if self.fault:
            return False
        self.command = 1
        return True

    def retract(self) -> None:
        self.update()
        self.commands.append(0)
        self.command = 0
        self.fault &= ~1

    @property
    def state(self) -> int:
        self.update()
        if self.fault & 12:
            return 4
        if self.command:
            return 2 if self._position >= 1.0 else 1
        return 3 if self._position > 0.0 else 0

    @property
    def force_n(self) -> float:
        return self.setpoint_n if self.state == 2 else 0.0

    @property
    def position_um(self) -> int:
        return round(5000 * self._position)

    def update(self) -> None:
        now = time.monotonic()
        if self._position > 0.0 and now > self._fed + self.watchdog_ms / 1000:
            self.command, self.fault = 0, self.fault | 1
        step = 0.0 if self.stuck else (now - self._at) / MOVE_S
        self._position = min(max(self._position + (step if self.command else -step), 0.0), 1.0)
        self._at = now


class ModbusCoil(Peer):
    """Registers of the actuator. ``rtu`` selects the framing."""

    def __init__(self, coil: Coil, *, rtu: bool, unit: int = 1) -> None:
        super().__init__()
        self.coil = coil
        self.requests: list[bytes] = []
        self._rtu, self._unit = rtu, unit
        self._bytes = b""

    def on_connect(self) -> None:
        self._bytes = b""

    def on_bytes(self, data: bytes) -> None:
        self._bytes += data
        overhead, head = (4, 1) if self._rtu else (8, 7)
        while len(self._bytes) >= overhead + 4:  # all requests of the map are as long
            frame, self._bytes = self._bytes[: overhead + 4], self._bytes[overhead + 4 :]
            if self._rtu and crc16(frame) != 0:
                continue
            pdu = frame[head : head + 5]
            self.requests.append(pdu)
            answer = self._answer(pdu)
            if frame[head - 1] != self._unit:
                continue
            if self._rtu:
                body = bytes([self._unit]) + answer
                self.send(body + struct.pack("<H", crc16(body)))
            else:
                self.send(frame[:4] + struct.pack(">HB", len(answer) + 1, self._unit) + answer)

    def _answer(self, pdu: bytes) -> bytes:
        function, address, value = struct.unpack(">BHH", pdu)
        if function == 4:
            registers = self.registers()
            if not 1 <= value <= 125 or any(at not in registers for at in range(address, address + value)):
                return bytes([0x84, 2])
            words = [registers[at] & 0xFFFF for at in range(address, address + value)]
            return struct.pack(f">BB{value}H", 4, 2 * value, *words)
        if function == 6:
            code = self._write(address, value)
            return bytes([0x86, code]) if code else pdu
        return bytes([function | 0x80, 1])

    def _write(self, address: int, value: int) -> int:
        coil = self.coil
        if address not in range(4):
            return 2
        low, high = [(0, 1), (0, 5000), (100, 5000), (0, 0xFFFF)][address]
        if not low <= value <= high:
            return 3
        if address == 0 and value == 1:
            return 0 if coil.engage() else 4
        if address == 0:
            coil.retract()
        elif address == 1:
            coil.setpoint_n = value / 100
        elif address == 2:
            coil.watchdog_ms = value
        else:
            coil.feed()
            coil.heartbeat = value
        return 0

    def registers(self) -> dict[int, int]:
        coil = self.coil
        force, setpoint = round(100 * coil.force_n), round(100 * coil.setpoint_n)
        inputs = [coil.state, force, setpoint, coil.position_um, coil.fault, coil.heartbeat]
        table = dict(enumerate(inputs))
        for first, words, text in ((100, 8, VENDOR), (108, 8, MODEL), (116, 8, SERIAL), (124, 4, FIRMWARE)):
            raw = text.encode().ljust(2 * words, b"\0")
            table |= {first + at: int.from_bytes(raw[2 * at : 2 * at + 2], "big") for at in range(words)}
        return table | {128: coil.boots >> 16, 129: coil.boots & 0xFFFF}


class AsciiCoil(NumberedPeer):
    """Actuator on ASCII lines."""

    def __init__(self, coil: Coil) -> None:
        super().__init__()
        self.coil = coil

    def _answer(self, request: str) -> str:
        coil = self.coil
        name, _, value = request.partition(",")
        if name == "ID?":
            return f"ID,{VENDOR},{MODEL},{SERIAL},{FIRMWARE},{coil.boots}"
        if name == "ST?":
            return f"ST,{coil.state},{coil.force_n:.2f},{coil.setpoint_n:.2f},{coil.position_um},{coil.fault}"
        if name == "F":
            if not 0 <= float(value) <= 50:
                return "ERR,range,0 to 50 N"
            coil.setpoint_n = float(value)
        elif name == "ENG":
            if not coil.engage():
                return "ERR,fault,a fault is set"
        elif name == "RET":
            coil.retract()
        elif name == "HB":
            coil.feed()
        elif name == "WD":
            coil.watchdog_ms = int(value)
        else:
            return "ERR,unknown,what?"
        return "OK"


def crc16(data: bytes) -> int:
    """Return the Modbus CRC, which is 0 over a whole frame."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc
