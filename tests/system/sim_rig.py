"""Run a simulated cell as a process, and speak its protocols with raw clients. Waits have a condition and a limit."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import serial

from polishd.sim_backends.common import framing as f
from polishd.sim_backends.common.framing import crc16, rtu
from tests.time_limits import SOON_S

ROOT = Path(__file__).resolve().parents[2]
SMALL = """
[plant]
aperture_mm = 40.0
[robot]
port = 0
watchdog_s = 3.0
"""


def wait_for(condition: Callable[[], Any], what: str, limit_s: float = SOON_S) -> Any:
    """Wait until the condition is true and return its value. AssertionError after the limit."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.005)
    raise AssertionError(f"waited {limit_s:g} s in vain: {what}")


def alive(pid: int) -> bool:
    """Return whether the process runs (a zombie does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


class Cell:
    """Running simulator of a cell, with its state folder."""

    def __init__(self, folder: Path, config: str = SMALL, *arguments: str) -> None:
        self.state = folder / "sim"
        self.toml = folder / "sim.toml"
        self.toml.write_text(config)
        self.arguments = [str(self.toml), *arguments]
        self.process = self._start()
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line.startswith("READY "):
            self.process.kill()
            self.process.communicate()
            raise AssertionError(f"the simulator said {line!r}")
        self.endpoints: dict[str, Any] = json.loads(line[6:])
        self.booted: list[subprocess.Popen[str]] = []
        self.clients: list[RobotClient | CoilClient | SlcanClient] = []

    @property
    def pids(self) -> dict[str, int]:
        """Process ids of the devices by name, from the supervisor's file."""
        pids: dict[str, int] = json.loads((self.state / "pids.json").read_text())
        return pids

    @property
    def maps(self) -> Path:
        """Folder of the interferometer's maps."""
        return self.state / "maps"

    def log(self) -> list[dict[str, Any]]:
        """Return the events of the simulator's log. An incomplete last line is left out."""
        path = self.state / "sim.log"
        lines = path.read_text().splitlines(keepends=True) if path.exists() else []
        return [json.loads(line) for line in lines if line.endswith("\n")]

    def events(self, *names: str) -> list[str]:
        """Return the names of the events so far in order: of all events, or of those with these names."""
        return [entry["event"] for entry in self.log() if not names or entry["event"] in names]

    def account(self) -> dict[str, Any]:
        """Return the record of contact time as last written."""
        account: dict[str, Any] = json.loads((self.state / "dwell_account.json").read_text())
        return account

    def robot(self, **hello: Any) -> RobotClient:
        """Connect to the robot; the connection is closed with the cell at the latest."""
        client = RobotClient(self.endpoints["robot"], **hello)
        self.clients.append(client)
        return client

    def coil(self) -> CoilClient:
        """Connect to the actuator."""
        client = CoilClient(self.state / "actuator")
        self.clients.append(client)
        return client

    def spindle(self) -> SlcanClient:
        """Connect to the spindle."""
        client = SlcanClient(self.state / "spindle")
        self.clients.append(client)
        return client

    def boot(self, device: str) -> None:
        """Start the process of one device, as after a power failure."""
        process = self._start("--device", device)
        self.booted.append(process)
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["ready"] == device

    def end(self) -> int:
        """End all processes that were started with SIGTERM and return the simulator's exit code."""
        for process in (*self.booted, self.process):
            process.send_signal(signal.SIGTERM)
        for process in (*self.booted, self.process):
            process.wait(SOON_S)
            if process.stdout is not None:
                process.stdout.close()
        return self.process.returncode

    def _start(self, *more: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "polishd.sim_backends", *self.arguments, *more]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)


@contextlib.contextmanager
def cell(folder: Path, config: str = SMALL, *arguments: str) -> Iterator[Cell]:
    """Run a cell for the duration of the block."""
    running = Cell(folder, config, *arguments)
    try:
        yield running
    finally:
        for client in running.clients:
            client.close()
        running.end()
        pids = running.pids.values() if (running.state / "pids.json").exists() else []
        for pid in pids:
            wait_for(lambda pid=pid: not alive(pid), f"process {pid} to end")


def announced(lines: Sequence[bytes], sha256: str = "ab" * 32) -> dict[str, Any]:
    """Return the content of a LOAD frame for a program."""
    blocks_sha256 = hashlib.sha256(b"".join(line + b"\n" for line in lines)).hexdigest()
    return {"program_sha256": sha256, "blocks_sha256": blocks_sha256, "blocks": len(lines), "approach_blocks": 0}


class RobotClient:
    """Raw client of the robot link."""

    def __init__(self, endpoint: str, role: str = "writer", executed_from: int = 0, lease: str = "") -> None:
        host, port = endpoint.removeprefix("tcp://").split(":")
        self.socket = socket.create_connection((host, int(port)), timeout=SOON_S)
        self.socket.settimeout(0.02)
        self.splitter = f.Splitter()
        self.executed: list[tuple[int, float, float]] = []
        self.status: dict[str, Any] = {}
        self.credit = (0, 0)
        self.others: list[tuple[int, bytes]] = []
        self.closed = False
        self.lease = lease
        hello = {"protocol": 1, "role": role, "client": "test", "executed_from": executed_from, "lease": lease}
        self.say(f.HELLO, hello)

    def say(self, kind: int, message: dict[str, Any]) -> None:
        """Send a frame with a JSON payload."""
        self.socket.sendall(f.pack_json(kind, message))

    def pump(self) -> None:
        """Process the frames that have arrived."""
        try:
            data = self.socket.recv(1 << 20)
        except TimeoutError:
            return
        except ConnectionError:
            data = b""
        self.closed = not data
        for kind, payload in self.splitter.feed(data):
            self._take(kind, payload)

    def _take(self, kind: int, payload: bytes) -> None:
        if kind == f.EXECUTED:
            self.executed += f.unpack_executed(payload)
        elif kind == f.ACCEPTED:
            accepted, room, _ = struct.unpack(">IId", payload)
            self.credit = (accepted, room)
        else:
            self.others.append((kind, payload))
        if kind == f.STATUS:
            self.status = json.loads(payload)
        elif kind in {f.ACK, f.WELCOME}:
            message = json.loads(payload)
            self.status, self.lease = message["status"], message.get("lease", self.lease)

    def until(self, condition: Callable[[], Any], what: str, *, ping: bool = True) -> Any:
        """Process frames until the condition is true and return its value."""

        def check() -> Any:
            self.pump()
            if ping:
                self.say(f.PING, {})
            return condition()

        return wait_for(check, what)

    def wait(self, kind: int) -> bytes:
        """Wait for a frame of that kind (not status, progress or credit) and return its payload."""
        found = self.until(lambda: [p for k, p in self.others if k == kind], f"frame 0x{kind:02x}")
        self.others = [(k, p) for k, p in self.others if k != kind]
        payload: bytes = found[0]
        return payload

    def state(self, state: str) -> None:
        """Wait until the robot is in that state."""
        self.until(lambda: self.status.get("state") == state, f"robot {state}, is {self.status}")

    def load(self, lines: list[bytes], sha256: str = "ab" * 32) -> None:
        """Load a program that fits into the window, and wait until it is accepted."""
        self.say(f.LOAD, announced(lines, sha256))
        self.wait(f.ACK)
        self.socket.sendall(f.pack_blocks(0, lines))
        self.until(lambda: self.credit[0] == len(lines), "blocks accepted")

    def resume(self, until: int | None = None) -> None:
        """Resume motion, up to a block where one is given, and wait for the acknowledgment."""
        self.say(f.RESUME, {"until": until, "stops": self.status["stops"]})
        self.wait(f.ACK)

    def close(self) -> None:
        """Close the connection."""
        self.socket.close()


MOST_WATCHDOG_MS = 5000
"""Longest watchdog time of the actuator: delays of a busy machine are shorter."""


class CoilClient:
    """Raw client of the actuator: Modbus RTU."""

    def __init__(self, path: Path, baud: int = 115200) -> None:
        self.line = serial.Serial(str(path), baud, timeout=SOON_S)

    def ask(self, pdu: bytes, size: int) -> bytes:
        """Send a request and return the PDU of the answer."""
        self.line.write(rtu(1, pdu))
        answer = self.line.read(size + 3)
        assert len(answer) == size + 3
        assert crc16(answer[:-2]) == struct.unpack("<H", answer[-2:])[0]
        return answer[1:-2]

    def write(self, address: int, value: int) -> None:
        """Write a register and check the echo."""
        pdu = struct.pack(">BHH", 6, address, value)
        assert self.ask(pdu, 5) == pdu

    def inputs(self) -> tuple[int, ...]:
        """Return state, force, set point, position, fault and heartbeat, as register values."""
        return struct.unpack(">2x6H", self.ask(struct.pack(">BHH", 4, 0, 6), 14))

    def press(self, force_n: float, beat: Callable[[], None] = lambda: None) -> None:
        """Engage with the longest watchdog time and wait for the force; call ``beat`` at each turn."""
        self.write(2, MOST_WATCHDOG_MS)
        self.write(1, round(force_n * 100))
        self.write(0, 1)

        def pressed() -> bool:
            self.write(3, 1)
            beat()
            state, force, *_ = self.inputs()
            return state == 2 and abs(force / 100.0 - force_n) < 0.1 * force_n

        wait_for(pressed, f"{force_n:g} N")

    def close(self) -> None:
        """Close the serial line."""
        self.line.close()


class SlcanClient:
    """Raw client of the spindle's CiA 402 drive: SDO transfers on slcan; ``seen`` has the answers by identifier."""

    def __init__(self, path: Path) -> None:
        self.line = serial.Serial(str(path), 115200, timeout=0.02)
        self.line.write(b"C\rS6\rO\r")
        self.seen: dict[str, str] = {}
        self.rest = b""
        self._rpm = 0.0

    def send(self, frame: str) -> None:
        """Send a frame, written ``identifier#data``."""
        identifier, data = frame.split("#")
        self.line.write(f"t{identifier}{len(data) // 2}{data}\r".encode())

    def pump(self) -> None:
        """Process the frames that have arrived and keep the last data of each identifier."""
        self.rest += self.line.read(4096)
        *lines, self.rest = self.rest.split(b"\r")
        for line in lines:
            if line.startswith(b"t"):
                self.seen[line[1:4].decode()] = line[5:].decode()

    def write(self, index: int, value: int, size: int, sub: int = 0) -> None:
        """Write an object of 1, 2 or 4 bytes."""
        data = value.to_bytes(size, "little", signed=value < 0).ljust(4, b"\0")
        self.send("605#" + (struct.pack("<BHB", 0x23 | (4 - size) << 2, index, sub) + data).hex())

    def spin(self, rpm: int) -> None:
        """Send a heartbeat, then a speed in profile velocity mode, or a quick stop for 0."""
        self.send("745#05")
        if rpm == 0:
            return self.write(0x6040, 0x02, 2)
        self.write(0x6060, 3, 1)
        for word in (0x06, 0x07, 0x0F):
            if word == 0x0F or abs(self.rpm()) < 1.0:
                self.write(0x6040, word, 2)
        return self.write(0x60FF, 10 * rpm, 4)

    def rpm(self) -> float:
        """Request the speed and return the last answer; 0 before the first one."""
        self.send("605#406c600000000000")
        self.pump()
        answer = self.seen.get("585", "")
        if answer.lower().startswith("436c60"):
            self._rpm = struct.unpack("<i", bytes.fromhex(answer[8:16]))[0] / 10.0
        return self._rpm

    def close(self) -> None:
        """Close the serial line."""
        self.line.close()


def end_pid(pid: int, number: int = signal.SIGKILL) -> None:
    """Send a signal to one process and wait until it has ended."""
    os.kill(pid, number)
    wait_for(lambda: not alive(pid), f"process {pid} to be gone")
