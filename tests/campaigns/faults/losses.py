"""Many losses of one link: a daemon loses it in contact, leaves the part and ends; the next goes on with the same cell.

A cell in which something was wrong is followed by another. A daemon that is held before the loss, as it is over the one
before, gets the order to resume.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, last_words, simulated_cell
from polishd.daemon.socket import client
from polishd.model.errors import PolishdError
from tests.campaigns.faults.judge import FORCE_OFF_S, LATE_S, OFF, PRESSES, REACTIONS, UP, disagreeing, first
from tests.campaigns.faults.links import LINKS
from tests.campaigns.site import MOVING, Log
from tests.system.cell_rig import Daemon, with_faults, with_keys
from tests.system.sim_rig import wait_for

CONTACT_S = (0.2, 1.2)
"""In contact before a loss, wall time: all phases of polls and heartbeats."""
AGAIN_S = LATE_S + 0.1
"""The link is back so long after its limit: later than the limit in which it must be noticed."""
LIFTS = {"actuator": {"lift_s": 1.0}}
"""The force is off before the tool lifts."""
A_CELL = 50
"""Losses in one cell: the whole journal is held against the plant after each."""
END_S = 120.0
LOOK_S = 0.3
"""Between two looks whether it is held before it was lost."""
ANSWER_S = 5.0
SAID = 3
"""Contradictions of one loss that are reported."""
ENDLESS = {"job": {"max_cycles": 100, "tolerance_nm": 0.01}}


@dataclass(frozen=True, slots=True)
class Loss:
    """One of them. Times in s, of the simulators' own clock."""

    link: str
    how: str
    noticed: str
    """The daemon's reason."""
    limit_s: float
    detection_s: float | None
    """From the loss to the cell's first reaction."""
    force_off_s: float | None
    """From that to no more than the tool's own weight."""
    wrong: list[str]


def lose(name: str, first: int, most: int, folder: Path, until_s: float = math.inf) -> Iterator[Loss]:
    """Up to so many, from that number on, half by silence and half by the plug: as many as a cell takes.

    None is waited for after ``until_s``, on ``time.monotonic``.
    """
    link, number = LINKS[name], first
    files = link.files(folder, **LIFTS)
    files.cell.write_text(with_keys(files.cell.read_text(), ENDLESS))
    template = files.sim.read_text()
    _script(files, template, name, number)
    options = ["--state", str(files.sim_dir), "--seed", str(1 + first), "--speed", f"{link.speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        log = Log(files.sim_dir / "sim.log")
        while True:
            with Daemon(files) as daemon:
                loss = _lost(name, number, daemon, log)
            assert loss is not None, f"the daemon ended before loss {number}: {last_words(files.daemon_log)}"
            yield loss
            number += 1
            if loss.wrong or number == first + most or time.monotonic() > until_s:
                return
            _script(files, template, name, number)
            os.kill(json.loads((files.sim_dir / "pids.json").read_text())[link.device], signal.SIGHUP)


def _script(files: DemoFiles, template: str, name: str, number: int) -> None:
    """When the next loss comes, and how."""
    link, how = LINKS[name], ("hangs", "unplugged")[number % 2]
    contact_s = round(Random(f"{name} {number}").uniform(*CONTACT_S), 3)
    fault = {**link.fault(how), "contact_s": contact_s, "duration_s": link.silence_s + AGAIN_S}
    files.sim.write_text(with_faults(template, fault))


def _asked(daemon: Daemon, verb: str) -> dict[str, Any]:
    """Ask as a person does; empty where no daemon answers, or it is refused."""
    with contextlib.suppress(PolishdError):
        return client.request(daemon.files.state_dir, verb, ANSWER_S)
    return {}


def _lost(name: str, number: int, daemon: Daemon, log: Log) -> Loss | None:
    """Wait for the next loss, and for the cell to be at rest behind it; None where the daemon ended before."""
    begun, looked_s = len(log.look()), 0.0
    told: dict[str, Any] = {}

    def rests() -> bool:
        nonlocal looked_s
        ended = daemon.process.poll() is not None  # first: what it did is in the log then
        after = {event["event"] for event in log.look()[begun:]}
        if "fault_begins" not in after:
            if not ended and time.monotonic() > looked_s + LOOK_S:
                looked_s = time.monotonic()
                if _asked(daemon, "status").get("state") == "held":
                    _asked(daemon, "resume")
            return ended
        if not (ended or "fault_ends" in after) or log.last("robot", MOVING):
            return False
        told.update({"state": "ended"} if ended else _asked(daemon, "status"))
        return told.get("state") in {"held", "ended"}

    try:
        wait_for(rests, f"loss {number} of the {name}, and that the cell rests", END_S)
    except AssertionError:
        if "fault_begins" not in {event["event"] for event in log.look()[begun:]}:
            raise
        told["state"] = "stuck"
    events = log.look()[begun:]
    at = next((k for k, event in enumerate(events) if event["event"] == "fault_begins"), None)
    if at is None:
        return None
    return _loss(name, events[at:], daemon.files, told)


def _loss(name: str, after: list[dict[str, Any]], files: DemoFiles, told: dict[str, Any]) -> Loss:
    """Judge what the simulator reports from the loss on, and the daemon at its end."""
    since_s, limit_s = after[0]["mono_s"], LINKS[name].silence_s
    reacted_s, off_s = first(after, REACTIONS), first(after, OFF)
    wrong = ["the cell does not come to rest"] if told["state"] == "stuck" else list(_wrong(name, files, after))
    detection_s = None if reacted_s is None else round(reacted_s - since_s, 3)
    force_off_s = None if off_s is None or reacted_s is None else round(off_s - reacted_s, 3)
    if detection_s is None or detection_s > limit_s + LATE_S:
        wrong.append(f"noticed after {detection_s} s, limit {limit_s} s")
    if force_off_s is None or force_off_s > FORCE_OFF_S:
        wrong.append(f"force off {force_off_s} s after it was noticed")
    return Loss(name, after[0]["what"], str(told.get("reason", "")), limit_s, detection_s, force_off_s, wrong)


def _wrong(name: str, files: DemoFiles, after: list[dict[str, Any]]) -> Iterator[str]:
    """What must hold whatever was lost, when it was."""
    place = {event["event"]: k for k, event in enumerate(after)}
    up = max(place.get(event, -1) for event in UP)
    if up < 0:
        yield "the tool stayed on the part"
    if max(place.get(event, -1) for event in PRESSES) > up:
        yield "it pressed again"
    yield from list(disagreeing(files, name))[:SAID]
