"""Devices on lines of text: numbered and with a checksum, or plain."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import AsyncGenerator, Iterable
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

from polishd.api import PlainLines
from polishd.config.device_profile_checks import profile_of
from polishd.drivers.linuxcnc.protocol import AXES, RshConnection
from polishd.drivers.loader_line import LoaderLine
from polishd.drivers.monitor_line import MonitorLine
from polishd.drivers.profile_device import build
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.model.devices import LoaderTimes, MonitorTimes, SensorTimes
from tests.campaigns.codecs.faulty_peer import Talk
from tests.fakes.devices_by_profile import shipped

LINE = SerialLine(Path("line"), 115200)
HOST = Tcp("127.0.0.1", 1)
NUMBERS = (b"TIME ", b"PROGRAM_LINE ", b"ABS_CMD_POS ")
"""What LinuxCNC answers by numbers; the rest is words, of which another may be right as well."""


class Numbered(Talk):
    """Late answers come to the next connection, too: the line is the same."""

    identity = "ID,maker,model,42,1.0,boot"

    def __init__(self, address: SerialLine | Tcp = LINE, **how: Any) -> None:
        super().__init__(**how)
        self.address = address
        self._number = b""

    @abstractmethod
    def answer(self, request: str) -> str:
        """The body; sets the truth."""

    def replies(self, data: bytes) -> Iterable[bytes]:
        for line in data.splitlines():
            self._number, _, request = line[1 : line.rindex(b"*")].partition(b",")
            body = self.identity if request == b"ID?" else self.answer(request.decode())
            yield self._line(body)

    def refusal(self, reply: bytes) -> bytes:
        return self._line("ERR,refused")

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        for line in sent.split(b"\n"):
            text, _, check = line[line.rfind(b"$") + 1 :].rstrip(b"\r").rpartition(b"*")
            number = text.partition(b",")[0]
            due = number.isdigit() and int(number) >= int(self._number)  # of this request, or of one that will be asked
            sound = check == b"%02X" % reduce(xor, text, 0) and due
            if sound and b"$%b*%b" % (text, check) != reply.strip():
                return False
        return True

    def _line(self, body: str) -> bytes:
        text = self._number + b"," + body.encode("ascii")
        return b"$%b*%02X\r\n" % (text, reduce(xor, text, 0))


class Sampled(Numbered):
    """A device whose values come by a generator."""

    device: Any
    _values: AsyncGenerator[Any] | None = None

    async def open(self) -> None:
        await self.device.open()

    async def close(self) -> None:
        values, self._values = self._values, None
        if values is not None:
            await values.aclose()
        await self.device.close()

    async def next(self, values: AsyncGenerator[Any]) -> Any:
        """Of the generator under way, or of that one."""
        self._values = values if self._values is None else self._values
        try:
            return await anext(self._values)
        except BaseException:
            self._values = None
            raise


PROFILE = profile_of("force_sensor_line", Path())


class ForceSensor(Sampled):
    name = "force sensor"
    driver = "profile_device"

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self.device = build.force_sensor(PROFILE, self.address, SensorTimes(silence_s=self.silence_s))

    def answer(self, request: str) -> str:
        number = next(self.numbers)
        text = f"{number // 1000:+06d}.{number % 1000:04d}"
        self.truth = float(text)
        return f"F,0,{number % 65536},{text},0"

    async def ask(self) -> float:
        return float((await self.next(self.device.samples())).force_n)


class Monitor(Sampled):
    name = "monitor"
    driver = "monitor_line"
    signals = ("flow", "guard-2", "p_1")

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self.device = MonitorLine(self.address, MonitorTimes(silence_s=self.silence_s))

    def answer(self, request: str) -> str:
        what, _, which = request.partition(",")
        if what == "LS?":
            return f"LS,{which}" + (f",{self.signals[int(which)]}" if int(which) < len(self.signals) else "")
        number = next(self.numbers)
        self.truth = (which, float(number))
        return f"V,{which},{number}"

    async def ask(self) -> tuple[str, float]:
        signal = await self.next(self.device.signals())
        return signal.name, signal.value


class Loader(Sampled):
    name = "loader"
    driver = "loader_line"

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self.device = LoaderLine(self.address, LoaderTimes(silence_s=self.silence_s))

    def answer(self, request: str) -> str:
        self.truth = f"part {next(self.numbers)}"
        return f"ST,0,0,{self.truth.replace(' ', '%20')}"

    async def ask(self) -> str | None:
        return await self.device.loaded()


class VoiceCoil(Numbered):
    name = "voice coil, lines"
    driver = "profile_device"

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self._wire = build.wire_of(shipped("voice_coil_serial"), self.address, self.silence_s)

    async def open(self) -> None:
        await self._wire.connect()

    async def close(self) -> None:
        await self._wire.disconnect()

    def answer(self, request: str) -> str:
        number = next(self.numbers)
        self.truth = number / 100
        return f"ST,2,{number / 100:.2f},12.00,{number % 10_000},0"

    async def ask(self) -> Any:
        return (await self._wire.read(["force"]))["force"]


class Plain(Talk):
    """Without numbers and checksums: the first line is the answer, or is none."""

    resyncs = False
    ending = b"\n"
    pattern: re.Pattern[bytes]
    refused: re.Pattern[bytes]

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        for line in sent.split(b"\n")[:-1]:
            if text := line.strip():
                is_answer = self.pattern.fullmatch(text) or self.refused.match(text)
                return not is_answer or text == reply.strip()
        return True


class ForceGauge(Plain):
    name = "force gauge by profile, plain lines"
    driver = "profile_device"
    pattern, refused = re.compile(rb"[-+]?\d+(\.\d+)? N"), re.compile(rb"\*(10|11|12|22)$")

    def __init__(self, address: SerialLine | Tcp = LINE, **how: Any) -> None:
        super().__init__(**how)
        self._wire = build.wire_of(shipped("mark10_series5"), address, self.silence_s)

    async def open(self) -> None:
        await self._wire.connect()

    async def close(self) -> None:
        await self._wire.disconnect()

    def replies(self, data: bytes) -> Iterable[bytes]:
        for _ in range(data.count(b"?C\r\n")):
            self.truth = next(self.numbers) % 9000 / 20
            yield b"%.2f N\n" % self.truth

    def refusal(self, reply: bytes) -> bytes:
        return b"*10\n"

    async def ask(self) -> Any:
        return (await self._wire.read(["force"]))["force"]


class OwnLines(Plain):
    name = "lines of polishd.api"
    driver = "transport"
    pattern, refused = re.compile(rb"F\d+"), re.compile(rb"NO")

    def __init__(self, address: SerialLine | Tcp = HOST, **how: Any) -> None:
        super().__init__(**how)
        self._lines = PlainLines(address, self.silence_s, hello="?", refusal="NO")

    async def open(self) -> None:
        await self._lines.open()

    async def close(self) -> None:
        await self._lines.close()

    def replies(self, data: bytes) -> Iterable[bytes]:
        for _ in range(data.count(b"?\n")):
            self.truth = next(self.numbers)
            yield b"F%d\r\n" % self.truth

    def refusal(self, reply: bytes) -> bytes:
        return b"NO, fault\r\n"

    async def ask(self) -> int:
        return await self._lines.read("?", _number)


def _number(answer: str) -> int:
    if re.fullmatch(r"F\d+", answer, re.ASCII) is None:
        raise ValueError("no number")
    return int(answer[1:])


class LinuxCnc(Talk):
    """Its answers name what they answer, and bear no number."""

    name = "LinuxCNC"
    driver = "linuxcnc"
    ends = True
    least = 0.05  # six answers are one look

    def __init__(self, address: Tcp = HOST, **how: Any) -> None:
        super().__init__(**how)
        self._address = address
        self._connection: RshConnection | None = None
        self._asked = b""
        self._answered: dict[bytes, bytes] = {}

    async def open(self) -> None:
        self._answered.clear()
        self._connection = RshConnection(self._address, ("EMC", "EMCTOO"), self.silence_s)
        await self._connection.open()

    async def close(self) -> None:
        if self._connection is not None:
            await self._connection.close()

    def replies(self, data: bytes) -> Iterable[bytes]:
        for request in data.split(b"\r\n")[:-1]:
            self._asked = request
            verb, *words = request.upper().split()
            if verb == b"HELLO":
                yield b"HELLO ACK linuxcncrsh 1.1\r\n"
            elif words == [b"VERBOSE", b"ON"]:
                yield b"SET VERBOSE ACK\r\n"
            elif verb == b"GET":
                self._answered[words[0]] = self._value(words[0])
                self.truth = tuple(self._answered.values())
                yield words[0] + b" " + self._answered[words[0]] + b"\r\n"

    def _value(self, name: bytes) -> bytes:
        number = next(self.numbers)
        match name:
            case b"ABS_CMD_POS":
                return b" ".join(b"%.6f" % (number + at / 8) for at in range(AXES))
            case b"PROGRAM_STATUS":
                return (b"IDLE", b"RUNNING", b"PAUSED")[number % 3]
            case b"OPERATOR_DISPLAY":
                return b"polishd %d" % number
            case b"FEED_OVERRIDE":
                return b"%d" % (number % 200)
        return b"%d" % number

    def refusal(self, reply: bytes) -> bytes:
        verb, name, *_ = *self._asked.upper().split(), b""
        return b"%b NAK\r\n" % (verb if verb == b"HELLO" else verb + b" " + name)

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        name, said = reply.split(b" ")[0] + b" ", [line.strip() for line in sent.split(b"\n")[:-1]]
        if reply.strip() in said[:-1]:  # what follows it would answer the next request
            return False
        for text in said:
            if not text.startswith(name) or text == reply.strip():
                continue
            words = text.split()[1:]
            as_many = len(words) == reply.count(b" ") and all(map(_is_number, words))
            if as_many or name not in NUMBERS:
                return False
        return True

    async def ask(self) -> Any:
        assert self._connection is not None
        look = await self._connection.look()
        position = b" ".join(b"%.6f" % one for one in look.position)
        line, status = b"%d" % look.line, look.status.upper().encode()
        override = b"%d" % round(100 * look.override)
        return b"%d" % look.time_s, line, position, status, look.display.encode(), override


def _is_number(text: bytes) -> bool:
    return re.fullmatch(rb"[-+]?[\d_.]+(e[-+]?\d+)?", text, re.IGNORECASE) is not None
