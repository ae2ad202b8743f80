"""The robot link, and the servers of a Universal Robots controller."""

from __future__ import annotations

import asyncio
import json
import math
import random
import re
import struct
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any
from zlib import crc32

from polishd.api import DeviceRefused, LinkError, ProtocolError, RobotTimes
from polishd.drivers.fanuc_rmi.protocol import RmiSession
from polishd.drivers.kuka_kvp.program import READ_NAMES, KukaSample
from polishd.drivers.kuka_kvp.protocol import KvpLink
from polishd.drivers.robot_link.driver import RobotLinkConnection
from polishd.drivers.robot_link.protocol import FrameType
from polishd.drivers.transport.address import Tcp
from polishd.drivers.universal_robots import driver
from polishd.drivers.universal_robots.rtde import OUTPUTS, RtdeConnection, UrRegisters
from tests.campaigns.codecs.faulty_peer import WEIGHTS, Talk
from tests.campaigns.codecs.lines import HOST

BOOT = "boot-1"


def link_frame(kind: int, payload: bytes) -> bytes:
    """A frame of the robot link, as its page says."""
    head = struct.pack(">BI", kind, len(payload))
    body = b"PL" + head[:1] + bytes([crc32(head) & 0xFF]) + head[1:] + payload
    return body + struct.pack(">I", crc32(body))


class RobotLink(Talk):
    """An order, and its ACK with the robot's state. Frames have a checksum; what they say is JSON."""

    name = "robot link"
    driver = "robot_link"
    least = 0.2  # most nonsense with a right checksum ends the connection

    def __init__(self, address: Tcp = HOST, **how: Any) -> None:
        super().__init__(**how)
        self._address = address
        self._connection: RobotLinkConnection | None = None
        self._said: deque[bytes] = deque(maxlen=9)

    async def open(self) -> None:
        times = RobotTimes(silence_s=self.silence_s, watchdog_s=1.0)
        self._connection = RobotLinkConnection(self._address, "writer", None, times)
        await self._connection.open("test")

    async def close(self) -> None:
        if self._connection is not None:
            await self._connection.close()

    async def ask(self) -> Any:
        assert self._connection is not None
        progress = (await self._connection.command(FrameType.HOLD, {})).progress
        buffer_s = progress.buffer_s if math.isfinite(self._connection.progress.buffer_s) else math.nan
        return progress.state, progress.accepted, progress.executed, progress.stops, buffer_s

    def replies(self, data: bytes) -> Iterable[bytes]:
        while data:
            kind, size = data[2], struct.unpack_from(">I", data, 4)[0]
            data = data[12 + size :]
            if kind == FrameType.HELLO:
                about = dict.fromkeys(("vendor", "model", "serial", "firmware"), "x")
                more = {"protocol": 1, "boot_id": BOOT, "window": 100, "watchdog_s": 10.0, "lease": "l"}
                yield link_frame(FrameType.WELCOME, json.dumps({**about, **more, "status": self._status()}).encode())
            elif kind == FrameType.HOLD:
                self._said.append(
                    link_frame(FrameType.ACK, json.dumps({"of": FrameType.HOLD, "status": self._status()}).encode())
                )
                yield self._said[-1]

    def _status(self) -> dict[str, Any]:
        number = next(self.numbers)
        self.truth = ("held", number + 2, number, number + 1, number / 8)
        keys = ("state", "accepted", "executed", "stops", "buffer_s")
        return {**dict(zip(keys, self.truth, strict=True)), "program_sha256": "", "boot_id": BOOT, "detail": ""}

    def refusal(self, reply: bytes) -> bytes:
        of = FrameType.HELLO if reply[2] == FrameType.WELCOME else FrameType.HOLD
        return link_frame(FrameType.NAK, json.dumps({"of": of, "code": "state", "text": "no"}).encode())

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        """What has a right checksum is ours. An ACK has no number: an older one, or a double, may answer the next."""
        return sent.count(reply) <= 1 and not any(one in sent for one in self._said if one != reply)

    def damages(self, rng: random.Random, reply: bytes) -> Sequence[bytes]:
        """Sound frames with nonsense in them: each ends the connection, or answers nothing."""
        content = json.loads(reply[8:-4])
        status = content["status"]
        wrong: list[dict[str, Any]] = [
            {"buffer_s": rng.choice([math.nan, math.inf, -math.inf, "1", None, True, -1.0])},
            {"accepted": rng.choice([-1, 1.5, "7", None, True])},
            {"stops": rng.choice([-1, 2.5, [], True])},
            {"state": rng.choice(["", "HELD", 3, ["held"], None])},
            {"boot_id": rng.choice([7, "boot-2"])},
        ]
        said = [json.dumps(content | {"status": status | one}) for one in wrong]
        said += [json.dumps(content | {"status": rng.choice([None, [], "held", 5])})]
        said += [json.dumps(content).replace(str(status["buffer_s"]), rng.choice(["1e999", "1" + "0" * 400]), 1)]
        said += ["", "[" * 3000, "[]", "7", "{", '"held"', json.dumps(content)[:-1]]
        if reply[2] == FrameType.WELCOME:
            watchdog = rng.choice([math.nan, math.inf, 0, -1, None, "1", True])
            said += [
                json.dumps(content | {"watchdog_s": watchdog}),
                json.dumps(content | {"window": rng.choice([0, True, 1.5])}),
            ]
        return [link_frame(reply[2], one.encode()) for one in said] + [link_frame(rng.randrange(0x88, 256), b"{}")]


DOUBLES = ("timestamp", "target_speed_fraction", "speed_scaling")
TYPES = dict.fromkeys(DOUBLES, "DOUBLE") | {"target_TCP_speed": "VECTOR6D", "runtime_state": "UINT32"}
FORMS = {"DOUBLE": ">d", "UINT32": ">I", "INT32": ">i"}


class Rtde(Talk):
    """Samples come by themselves. Neither number nor checksum: what can be checked is kind, length, time and range."""

    name = "Universal Robots, RTDE"
    driver = "universal_robots"
    resyncs = False
    ends = True
    least = 0.1  # five good answers in a row open it, and nonsense ends it
    kinds = frozenset(WEIGHTS) - {"late", "refused"}
    period_s = 0.01

    def __init__(self, address: Tcp = HOST, **how: Any) -> None:
        super().__init__(**how)
        registers = UrRegisters()
        self.link = RtdeConnection(address, 100.0, registers, self.silence_s, self._take)
        self._names = (*OUTPUTS, *registers.outputs())
        self._timer: asyncio.TimerHandle | None = None
        self._own: list[bytes] = []

    async def _take(self, _sample: object) -> None:
        """The samples are read from the link."""

    async def open(self) -> None:
        await self.link.open()

    async def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        await self.link.close()

    async def ask(self) -> Any:
        count = self.link.count
        await self.link.until(lambda: self.link.count != count)
        last = self.link.last
        return last.block, last.time_s

    def replies(self, data: bytes) -> Iterable[bytes]:
        while data:
            size, kind = struct.unpack_from(">HB", data)
            payload, data = data[3:size], data[size:]
            match chr(kind):
                case "V":
                    yield self._package("V", b"\1")
                case "v":
                    yield self._package("v", struct.pack(">4I", 5, 11, 0, 0))
                case "O":
                    types = [TYPES.get(name, "INT32") for name in self._names]
                    yield self._package("O", b"\1" + ",".join(types).encode())
                case "I":
                    yield self._package("I", b"\2" + ",".join(["INT32"] * (payload.count(b",") + 1)).encode())
                case "S":
                    self._timer = asyncio.get_running_loop().call_later(self.period_s, self._tick)
                    yield self._package("S", b"\1")

    def _tick(self) -> None:
        number = next(self.numbers)
        self.truth = (number % 100_000, number / 100)
        self._timer = asyncio.get_running_loop().call_later(self.period_s, self._tick)
        self.say(self._sample(number))

    def _sample(self, number: int, **other: float) -> bytes:
        values: dict[str, Any] = {
            "timestamp": number / 100, "runtime_state": 2, "robot_mode": 7, "safety_mode": 1, "speed_scaling": 1.0,
            "target_speed_fraction": 1.0, "output_int_register_25": number % 100_000, **other,
        }  # fmt: skip
        data = b""
        for name in self._names:
            value, kind = values.get(name, 0), TYPES.get(name, "INT32")
            data += struct.pack(">6d", *[value] * 6) if kind == "VECTOR6D" else struct.pack(FORMS[kind], value)
        return self._package("U", b"\1" + data)

    def _package(self, kind: str, payload: bytes) -> bytes:
        return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        """Only its own damages: a stream that is shifted could say anything."""
        return sent in self._own

    def damages(self, rng: random.Random, reply: bytes) -> Sequence[bytes]:
        kind, payload = chr(reply[2]), reply[3:]
        longer = payload + rng.randbytes(rng.randrange(1, 9))
        self._own = [
            self._package(kind, payload[: rng.randrange(len(payload))]),
            self._package(kind, longer),
            self._package(rng.choice("xyzQ"), payload),
            self._package("M", rng.randbytes(20)),
            struct.pack(">HB", rng.randrange(3), reply[2]) + payload,
            struct.pack(">HB", 0xFFFF, reply[2]) + payload,
        ]
        if kind == "U":
            number = next(self.numbers)
            name = rng.choice(["timestamp", "target_speed_fraction", "speed_scaling", "target_TCP_speed"])
            self._own += [
                self._package("U", bytes([rng.choice([0, 2, 3, 255])]) + payload[1:]),
                self._sample(number, **{name: rng.choice([math.nan, math.inf, -math.inf])}),
                self._sample(number, target_speed_fraction=rng.choice([7.0, -1.0, 1e200])),
            ]
            if self.link._recent:
                self._own.append(self._sample(max(round(100 * self.link._recent[-1].time_s) - rng.randrange(900), 0)))
        elif kind in "OI":
            self._own += [self._package(kind, reply[3:4] + b"DOUBLE,NONSENSE"), self._package(kind, b"")]
        return self._own


class Dashboard(Talk):
    """One question a connection: its greeting, and a yes or no."""

    name = "Universal Robots, dashboard"
    driver = "universal_robots"
    resyncs = False
    least = 0.3
    greeting = b"Connected: Universal Robots Dashboard Server\n"
    answer = re.compile(rb"([\w ]+: )?(true|false)", re.IGNORECASE)

    def __init__(self, address: Tcp = HOST, **how: Any) -> None:
        super().__init__(**how)
        self._address = address

    async def open(self) -> None:
        """Each question opens its own."""

    async def close(self) -> None:
        """It has closed it."""

    def greets(self) -> Iterable[bytes]:
        yield self.greeting

    def replies(self, data: bytes) -> Iterable[bytes]:
        self.truth = next(self.numbers) % 2 == 0
        yield b"Program running: %b\n" % (b"true" if self.truth else b"false")

    def refusal(self, reply: bytes) -> bytes:
        return b"" if reply == self.greeting else b"error: not now\n"

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        lines = [line.strip() for line in sent.split(b"\n")[:-1]]
        answers = (
            lines[1:] if reply == self.greeting and lines and lines[0].startswith(self.greeting[:-1]) else lines[:1]
        )
        wrong = (line for line in answers if line != reply.strip())
        return not any(self.answer.fullmatch(line) or b"not " in line.lower() for line in wrong)

    async def ask(self) -> Any:
        answer = await driver.ask(self._address, "running", self.silence_s)
        return driver.yes(answer)


class FanucRmi(Talk):
    """Status, pose and an executed instruction. Only the answer to an instruction has a number; nothing a checksum."""

    name = "FANUC, Remote Motion Interface"
    driver = "fanuc_rmi"
    least = 0.15  # a value is three answers, opening is two, and nonsense ends it
    resyncs = False
    ends = True

    def __init__(self, address: Tcp = HOST, **how: Any) -> None:
        super().__init__(**how)
        self._address = address
        self._session: RmiSession | None = None
        self._executed: list[tuple[int, int]] = []
        self._sequence = 0
        self._status, self._pose = 0, (0.0,) * 6

    async def open(self) -> None:
        times = RobotTimes(silence_s=self.silence_s, watchdog_s=0.1)
        self._session = RmiSession(self._address, times, lambda *answer: self._executed.append(answer))
        await self._session.open()

    async def close(self) -> None:
        if self._session is not None:
            await self._session.close()

    async def ask(self) -> Any:
        session = self._session
        assert session is not None
        self._executed.clear()
        self._sequence += 1
        try:
            snapshot = await session.look()
            await session.send(self._sequence, {"Instruction": "FRC_WaitTime", "Time": 0.0})
            await session.until(lambda: bool(self._executed), self.silence_s)
            if not self._executed:
                raise LinkError("the instruction is not answered")  # as the daemon, by the robot's progress
        except ProtocolError as error:
            raise LinkError(str(error)) from error  # as the polled connection ends
        if self._executed[0][1]:
            raise DeviceRefused("the instruction was refused")
        return snapshot.status.next_sequence, snapshot.pose, [*self._executed]

    def replies(self, data: bytes) -> Iterable[bytes]:
        for line in data.splitlines():
            request = json.loads(line)
            kind = next(kind for kind in ("Communication", "Command", "Instruction") if kind in request)
            yield self._line({kind: request[kind], "ErrorID": 0, **self._answer(request)})

    def _answer(self, request: dict[str, Any]) -> dict[str, Any]:
        number = next(self.numbers)
        if "Instruction" in request:
            self.truth = (self._status, self._pose, [(request["SequenceID"], 0)])
            return {"SequenceID": request["SequenceID"]}
        if request.get("Command") == "FRC_GetStatus":
            self._status = number
            zeros = dict.fromkeys(("TPMode", "RMIMotionStatus", "ProgramStatus", "SingleStepMode"), 0)
            return {"ServoReady": 1, **zeros, "NextSequenceID": number, "Override": 100}
        if request.get("Command") == "FRC_ReadCartesianPosition":
            self._pose = (number / 8, *(float(number % 1000 + at) for at in range(5)))
            return {"TimeTag": number, "Position": dict(zip("XYZWPR", self._pose, strict=True))}
        return {"PortNumber": self._address.port, "MajorVersion": 5, "MinorVersion": 0}

    def refusal(self, reply: bytes) -> bytes:
        return self._line({**json.loads(reply), "ErrorID": 2556941})

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        """A line that has the form of the answer could be the right one, whatever its numbers are."""
        good = json.loads(reply)
        return all(line + b"\n" == reply or not self._is_form(line, good) for line in sent.split(b"\n"))

    def damages(self, rng: random.Random, reply: bytes) -> Sequence[bytes]:
        content = json.loads(reply)
        nonsense = rng.choice([None, True, "1", "\u0661", [], {}, math.nan, math.inf, 1.5e300, "x"])
        wrong: list[dict[str, Any]] = [{"ErrorID": rng.choice([None, True, "0", 0.5, []])}]
        if "Position" in content:
            wrong += [{"Position": rng.choice([None, [], 7])}]
            wrong += [{"Position": {**content["Position"], rng.choice("XYZWPR"): nonsense}}]
        if "ServoReady" in content:
            wrong += [{rng.choice(["ServoReady", "TPMode", "ProgramStatus", "NextSequenceID"]): nonsense}]
        if "SequenceID" in content:
            wrong += [{"SequenceID": content["SequenceID"] + rng.choice([-1, 1, 100])}, {"SequenceID": nonsense}]
        if "PortNumber" in content:
            wrong += [{"PortNumber": rng.choice([0, -1, 65536, True, "1", None])}]
        lines = [self._line({**content, **one}) for one in wrong]
        texts = [b"[" * 3000, b"[]", b"7", b"{", b"{}", b"{}" * 9, b"1" * 4000, b'{"Command":[]}', b"{" + b"a" * 5000]
        return [*lines, *(text + b"\r\n" for text in texts)]

    @staticmethod
    def _line(message: dict[str, Any]) -> bytes:
        return json.dumps(message).encode("ascii") + b"\r\n"

    def _is_form(self, line: bytes, good: Any) -> bool:
        try:
            found = json.loads(line)
        except (ValueError, RecursionError):
            return False
        if "SequenceID" in good and isinstance(found, dict) and found.get("SequenceID") != good["SequenceID"]:
            return False
        return _is_like(found, good)


def _is_like(found: Any, good: Any) -> bool:
    """It has the same texts, and numbers of the same kind where numbers belong."""
    if isinstance(good, dict):
        return isinstance(found, dict) and all(
            key in ("TimeTag", "MajorVersion", "MinorVersion") or (key in found and _is_like(found[key], value))
            for key, value in good.items()
        )
    if isinstance(good, str):
        return bool(found == good)
    whole = type(found) is int
    return whole if type(good) is int else (whole or type(found) is float) and abs(found) <= 1e9


KVP_TEXTS = {
    "$PRO_STATE1": "#P_ACTIVE", "$PRO_NAME1[]": '"POLISHD"', "$PRO_STATE0": "#P_ACTIVE", "$MODE_OP": "#AUT",
    "$OV_PRO": "100", "$PERI_RDY": "TRUE", "$STOPMESS": "FALSE", "$ROB_STOPPED": "FALSE",
}  # fmt: skip


class KukaProxy(Talk):
    """A reading of all variables. An answer has the number of its request, and no checksum."""

    name = "KUKA, C3 Bridge"
    driver = "kuka_kvp"
    resyncs = False
    ends = True

    def __init__(self, address: Tcp = HOST, **how: Any) -> None:
        super().__init__(**how)
        self._address = address
        self._link: KvpLink | None = None
        self._number = 0
        """Of the last request."""

    async def open(self) -> None:
        self._link = await KvpLink.connect(self._address, self.silence_s)

    async def close(self) -> None:
        if self._link is not None:
            await self._link.close()

    async def ask(self) -> Any:
        assert self._link is not None
        try:
            return KukaSample.of(await self._link.read(READ_NAMES))
        except ProtocolError as error:
            raise LinkError(str(error)) from error  # as the polled connection ends

    def replies(self, data: bytes) -> Iterable[bytes]:
        while data:
            self._number, size = struct.unpack_from(">HH", data)
            data = data[4 + size :]
            number = next(self.numbers)
            texts = KVP_TEXTS | {name: str(number + at) for at, name in enumerate(READ_NAMES) if name not in KVP_TEXTS}
            self.truth = KukaSample.of(texts)
            yield self._frame(6, self._values(texts[name] for name in READ_NAMES))

    def refusal(self, reply: bytes) -> bytes:
        payload = self._values(["", *[""] * (len(READ_NAMES) - 1)], code=0)
        return self._frame(6, payload, b"\0\0\0")

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        """An answer of the right number, kind and count could be the right one, whatever its digits are."""
        size = 4 + int.from_bytes(sent[2:4]) if len(sent) >= 4 else len(sent) + 1
        rest = sent[size:]
        if rest and rest[:2] in (b"", rest[:1], struct.pack(">H", (self._number + 1) & 0xFFFF)):
            return False
        is_answer = size <= len(sent) and sent[:2] == reply[:2] and sent[4:6] == reply[4:6]
        return sent[:size] == reply or not is_answer or not self._is_whole(sent[6 : size - 3])

    def damages(self, rng: random.Random, reply: bytes) -> Sequence[bytes]:
        payload, texts = reply[5:-3], [*KVP_TEXTS.values()]
        numbers = ["1", "1x", "", "1.5", "#A", "\u0661", "1_0", " 1", "+1"]
        return [
            self._frame(6, payload, number=self._number ^ 1 << rng.randrange(16)),
            self._frame(rng.choice([0, 1, 5, 7, 10, 255]), payload),
            self._frame(6, bytes([payload[0] ^ 1]) + payload[1:]),
            self._frame(6, payload[: rng.randrange(len(payload))]),
            self._frame(6, payload + rng.randbytes(rng.randrange(1, 9))),
            self._frame(6, b""),
            struct.pack(">HH", self._number, rng.choice([0, 1, 2, 3, 0x8001, 0xFFFF])) + reply[4:],
            self._frame(6, self._values([*texts, *(rng.choice(numbers[1:]) for _ in READ_NAMES[len(texts) :])])),
        ]

    def _frame(self, kind: int, payload: bytes, foot: bytes = b"\0\1\1", number: int | None = None) -> bytes:
        head = struct.pack(">HHB", self._number if number is None else number, 1 + len(payload) + len(foot), kind)
        return head + payload + foot

    def _values(self, texts: Iterable[str], code: int = 1) -> bytes:
        wide = [bytes([code]) + struct.pack(">H", len(text)) + text.encode("utf-16-le") for text in texts]
        return bytes([len(READ_NAMES)]) + b"".join(wide)

    def _is_whole(self, values: bytes) -> bool:
        """As many values as there are variables, to the last byte, and numbers where numbers belong."""
        found = []
        for _ in READ_NAMES:
            if len(values) < 3:
                return False
            size = 2 * int.from_bytes(values[1:3])
            found.append(values[3 : 3 + size].decode("utf-16-le", "replace"))
            values = values[3 + size :] if len(values) >= 3 + size else b""
        return not values and all(re.fullmatch(r"-?\d+", text, re.ASCII) for text in found[len(KVP_TEXTS) :])
