"""LinuxCNC's HAL in separate processes and shared memory, without its realtime part: host of its Modbus masters."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.interop.peers import END_S

APART = (
    *("setpriv", "--pdeathsig", "KILL", "unshare", "--map-root-user", "--mount", "--ipc", "--pid", "--fork"),
    *("--kill-child", "--mount-proc"),
)
"""The network is ours: the devices are in it."""
MARK = "--done--"
FRAMES = re.compile(r"\[[0-9A-F]{2}\]|<[0-9A-F]{2}>")
VALUE = re.compile(r"TRUE|FALSE|0x[0-9A-Fa-f]+|-?[\d.]+(e[-+]?\d+)?")


class Hal:
    """A session of halcmd."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.sent = ""
        """Requests of a master that prints them, as libmodbus does: ``[01][06]...``, between other output."""

    def say(self, command: str) -> list[str]:
        """What it prints for a command."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{command}\nprint {MARK}\n")
        self._process.stdin.flush()
        lines: list[str] = []
        for line in self._process.stdout:
            self.sent += "".join(re.findall(r"\[[0-9A-F]{2}\]", line))
            if MARK in line:
                return lines
            lines.append(FRAMES.sub("", line).strip())
        raise AssertionError(f"halcmd ended at {command!r}: {lines}")

    def get(self, pin: str) -> float:
        """A pin's value."""
        (found,) = filter(None, map(VALUE.fullmatch, self.say(f"getp {pin}")))
        words = {"TRUE": 1.0, "FALSE": 0.0}
        return words[found[0]] if found[0] in words else float.fromhex(found[0]) if "x" in found[0] else float(found[0])

    def set(self, pin: str, value: object) -> None:
        """Set a pin that is not connected."""
        said = self.say(f"setp {pin} {value}")
        assert not [line for line in said if "not found" in line.lower()], said


@contextmanager
def hal() -> Iterator[Hal]:
    """For the time of the block; skips where there are no namespaces to run it in."""
    tried = subprocess.run([*APART, "true"], capture_output=True, text=True, check=False)
    if tried.returncode or shutil.which("halrun") is None:
        pytest.skip(f"no namespaces here: {tried.stderr.strip()}")
    with subprocess.Popen(
        [*APART, "halrun"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            yield Hal(process)
        finally:
            assert process.stdin is not None
            process.stdin.close()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
