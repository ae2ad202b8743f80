"""Many losses of one link: the same daemon loses it in contact, leaves the part, is told to resume, and loses it again.

A cell that ends over a loss, as one whose tool nobody could confirm to be up, is followed by another.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random
from typing import Any

from polishd.console.demo_files import DemoFiles
from polishd.console.simulator import simulated_cell
from polishd.daemon import client
from polishd.model.errors import PolishdError
from tests.campaigns.faults.judge import FORCE_OFF_S, LATE_S, OFF, PRESSES, REACTIONS, SPEED, UP, disagreeing, first
from tests.campaigns.faults.links import LINKS, Link
from tests.campaigns.site import MOVING, Log
from tests.system.cell_rig import Daemon, with_faults, with_keys
from tests.system.sim_rig import wait_for

CONTACT_S = (0.2, 2.0)
"""In contact before a loss, wall time."""
AGAIN_S = 1.5
"""The link is back so long after its limit."""
END_S = 120.0
SAID = 3
"""Contradictions of one loss that are told."""
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


def lose(name: str, count: int, folder: Path, seed: int = 1) -> Iterator[Loss]:
    """So many, half by silence and half by the plug; as many in a cell as it takes."""
    link, rng, number = LINKS[name], Random(seed), 0
    while number < count:
        files = link.write(folder / f"from-{number}")
        files.cell.write_text(with_keys(files.cell.read_text(), ENDLESS))
        template = files.sim.read_text()
        _script(files, template, link, number, rng)
        options = ["--state", str(files.sim_dir), "--seed", str(seed + number), "--speed", f"{SPEED:g}"]
        with simulated_cell(files.sim, options, files.out / "sim.stderr"), Daemon(files) as daemon:
            log = Log(files.sim_dir / "sim.log")
            while number < count:
                yield _lost(name, number, daemon, log)
                number += 1
                if daemon.process.poll() is not None:
                    break
                _script(files, template, link, number, rng)
                os.kill(json.loads((files.sim_dir / "pids.json").read_text())[link.device], signal.SIGHUP)
                _resume(daemon)


def _script(files: DemoFiles, template: str, link: Link, number: int, rng: Random) -> None:
    """When the next loss comes, and how."""
    how = ("hangs", "unplugged")[number % 2]
    fault = {**link.fault(how), "contact_s": round(rng.uniform(*CONTACT_S), 3), "for_s": link.silence_s + AGAIN_S}
    files.sim.write_text(with_faults(template, fault))


def _resume(daemon: Daemon) -> None:
    """As a person who tries until it is obeyed."""
    state = daemon.files.state_dir

    def obeyed() -> bool:
        if daemon.process.poll() is not None:
            return True
        with contextlib.suppress(PolishdError):
            return bool(client.request(state, "resume").get("ok"))
        return False

    wait_for(obeyed, "resume to be obeyed", END_S)


def _lost(name: str, number: int, daemon: Daemon, log: Log) -> Loss:
    """Wait for the next loss, and for the cell to be at rest behind it."""
    begun = len(log.look())
    told: dict[str, Any] = {}

    def rests() -> bool:
        after = [event["event"] for event in log.look()[begun:]]
        if "fault_begins" not in after or (daemon.process.poll() is None and "fault_ends" not in after):
            return False
        told.update(daemon.status() if daemon.process.poll() is None else {"state": "ended"})
        return told.get("state") in {"held", "ended"} and not log.last("robot", MOVING)

    wait_for(rests, f"loss {number} of the {name}, and that the cell rests", END_S)
    events = log.look()[begun:]
    at = next(k for k, event in enumerate(events) if event["event"] == "fault_begins")
    since_s, after = events[at]["mono_s"], events[at:]
    reacted_s, off_s = first(after, REACTIONS), first(after, OFF)
    wrong = list(_wrong(daemon.files, after))
    limit_s = LINKS[name].silence_s
    detection_s = None if reacted_s is None else round(reacted_s - since_s, 3)
    force_off_s = None if off_s is None or reacted_s is None else round(off_s - reacted_s, 3)
    if detection_s is None or detection_s > limit_s + LATE_S:
        wrong.append(f"noticed after {detection_s} s, limit {limit_s} s")
    if force_off_s is None or force_off_s > FORCE_OFF_S:
        wrong.append(f"force off {force_off_s} s after it was noticed")
    return Loss(name, events[at]["what"], str(told.get("reason", "")), limit_s, detection_s, force_off_s, wrong)


def _wrong(files: DemoFiles, after: list[dict[str, Any]]) -> Iterator[str]:
    """What must hold whatever was lost, when it was."""
    place = {event["event"]: k for k, event in enumerate(after)}
    up = max(place.get(name, -1) for name in UP)
    if up < 0:
        yield "the tool stayed on the part"
    if max(place.get(name, -1) for name in PRESSES) > up:
        yield "it pressed again"
    yield from list(disagreeing(files))[:SAID]


def keep(losses: list[Loss], path: Path) -> None:
    """All of a link, for the page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps([asdict(one) for one in losses], indent=1))
