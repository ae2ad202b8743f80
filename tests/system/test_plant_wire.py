"""A third-party device next to polishd's simulated ones, written from docs/protocols/plant.md alone."""

from __future__ import annotations

import json
import os
import socket
import struct
import time
from pathlib import Path
from typing import Any

import pytest

from tests.system.sim_rig import SMALL, cell, wait_for

pytestmark = [pytest.mark.system, pytest.mark.full]
# the robot stands with the tool's tip on the part
CONFIG = SMALL + "home = [0.0, 0.0, 0.0, 15.0, 0.0]\n"


class Attached:
    """Actuator on the plant's socket."""

    def __init__(self, state: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(os.path.relpath(state / "plant.sock"))
        self.say(hello="actuator", pid=os.getpid(), t=time.monotonic())
        self.welcome = self.receive()

    def say(self, **message: Any) -> None:
        payload = json.dumps(message).encode()
        self.socket.sendall(struct.pack(">IB", len(payload), 0) + payload)

    def receive(self) -> dict[str, Any]:
        length, kind = struct.unpack(">IB", self.socket.recv(5, socket.MSG_WAITALL))
        assert kind == 0
        return dict(json.loads(self.socket.recv(length, socket.MSG_WAITALL)))


def test_it_takes_the_place_of_one_that_is_not_started(tmp_path: Path) -> None:
    with cell(tmp_path, CONFIG, "--only", "robot", "--only", "spindle") as running:
        assert set(running.pids) == {"supervisor", "plant", "robot", "spindle"}
        mine = Attached(running.state)
        assert mine.welcome["pose"] == [0.0, 0.0, 0.0, 15.0, 0.0]
        assert mine.welcome["touch_um"] == pytest.approx(5000.0, abs=50.0)
        began_s = time.monotonic()
        mine.say(event="boot", t=began_s)
        mine.say(event="engage", t=began_s)
        mine.say(samples=[[began_s, 0.0], [began_s + 0.1, 8.0]], mark=began_s + 0.5)
        assert [event["event"] for event in logged(running, "engage", "boot")] == ["boot", "engage"]
        mine.socket.close()
        assert logged(running, "lost")[-1]["device"] == "actuator"


def logged(running: Any, *names: str) -> list[dict[str, Any]]:
    """Wait until the log has the last of these events of the actuator, and return the events."""

    def found() -> list[dict[str, Any]]:
        events = [event for event in running.log() if event["event"] in names and event["device"] == "actuator"]
        return events if events and events[-1]["event"] == names[0] else []

    return list(wait_for(found, f"{names}"))
