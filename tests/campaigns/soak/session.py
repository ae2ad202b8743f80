"""Run a session: one simulated cell and one daemon for many parts, each with its script."""

from __future__ import annotations

import random
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.campaigns.soak.cell import SoakCell, prove_instrument, running_cell
from tests.campaigns.soak.ledger import Keep, Ledger, Under
from tests.campaigns.soak.parts import Part

LOOK_S = 0.1
MIRRORED = 1 / 3
"""Share of sessions in which a mirrored instrument measures the artefact first."""
GROUP = 3
"""Number of parts without a fault that are added at once."""
PART_S = 300.0
"""Time limit of a part."""
PATIENCE = 4
"""Unexpected visits after which the operator removes a part; the session ends after twice as many."""
STRIKES_S = 0.4
"""Longest time from landing to the fault; a pass takes four times as long."""


class Stuck(Exception):
    """The session cannot continue."""


class Session:
    """Polish parts in groups, and act as failures, as the operator and as systemd do."""

    def __init__(self, cell: SoakCell, name: str, seed: int, keep: Keep) -> None:
        self._cell, self._seed, self._path = cell, seed, str(cell.files.cell)
        self._ledger = Ledger(cell, name, keep)

    def run(self, parts: Sequence[Part], until_s: Callable[[], float]) -> None:
        """Polish all parts, or begin none after that time; complete those under way."""
        self._start()
        try:
            for group in grouped(parts):
                if time.monotonic() > until_s():
                    break
                self._work(group)
        except (Stuck, AssertionError) as error:
            self._ledger.open[-1].record.wrong.append(f"stuck: {error}")
        self._cell.kill()
        self._cell.rest()
        self._ledger.close()

    # a group of parts

    def _work(self, group: Sequence[Part]) -> None:
        first = group[0]
        if first.script.when == "between jobs":
            first.script.strike(self._cell)
            self._start()
        plant = {"rms_nm": first.rms_nm, "pv_nm": first.pv_nm}
        self._cell.set({**first.script.sections(first.name), "plant": plant}, first.script.wires)
        under, landed = self._ledger.begin(first), self._landings()
        self._add(group)
        self._follow(under, landed)
        for part in group[1:]:
            self._follow(self._ledger.begin(part), 0)  # without a fault
        self._between()
        self._ledger.open[-1].expected.extend(group[-1].script.after)

    def _add(self, group: Sequence[Part]) -> None:
        paths = []
        for part in group:
            path = self._cell.files.out / f"{part.name}.toml"
            job = f'[job]\nid = "{part.name}"\ntolerance_nm = {part.tolerance_nm}\nmax_cycles = 4\n'
            path.write_text(f'{job}[part]\nid = "{part.name}"\n')
            paths.append(str(path))
        said = self._cell.polishd("queue", "add", self._path, *paths)
        if said.returncode:
            raise Stuck(f"polishd queue add: {said.stderr}")

    def _follow(self, under: Under, landed: int) -> None:
        """Attend to the cell until the part's job has ended. ``landed``: number of landings before."""
        part, record = under.part, under.record
        record.struck = part.script.when in {"", "between jobs"}
        record.restarts = int(part.script.when == "between jobs")
        while (row := self._cell.row(part.name)) is None or row.verdict is None:
            if time.monotonic() > under.began_s + PART_S:
                raise Stuck(f"{part.name} does not end: {self._cell.state()}")
            status = {} if self._cell.ended else self._cell.state()
            if self._cell.ended:
                self._start_again(under)
            elif status.get("state") == "held":
                self._visit(under)
            elif not record.struck and self._is_time(part, status, landed):
                record.struck, struck_s = True, time.monotonic()
                part.script.strike(self._cell)
                record.missed = part.script.when == "in contact" and self._lifted(struck_s)
            self._pause()
        self._ledger.end(under, row)

    def _is_time(self, part: Part, status: Mapping[str, Any], landed: int) -> bool:
        """Return whether the moment of the script's fault has come."""
        if part.script.when == "solving":
            return status.get("job") == part.name and status.get("phase") == "solve"
        if self._landings() == landed:
            return False
        time.sleep(random.Random(f"{self._seed} {part.number} when").uniform(0.0, STRIKES_S))  # at any moment
        return True

    def _landings(self) -> int:
        return sum(event["event"] == "tool_landed" for event in self._cell.log.look())

    def _lifted(self, before_s: float) -> bool:
        """Return whether the tool had been lifted by then."""
        moves = [
            e for e in self._cell.log.look() if e["event"] in {"tool_landed", "retract"} and e["mono_s"] < before_s
        ]
        return bool(moves) and moves[-1]["event"] == "retract"

    def _between(self) -> None:
        """Attend to the cell until the queue is empty and idle."""
        last, end_s = self._ledger.open[-1], time.monotonic() + PART_S
        while True:
            state = None if self._cell.ended else self._cell.state().get("state")
            if self._cell.ended:
                self._start_again(last)
            elif state == "held":
                self._visit(last)
            elif state == "idle":
                return
            if time.monotonic() > end_s:
                raise Stuck(f"the queue does not come to rest: {self._cell.state()}")
            self._pause()

    # operator and service manager

    def _visit(self, under: Under) -> None:
        """Read the reason of the hold, correct the cause and resume, as an operator does."""
        status = self._cell.asked("status", self._path)
        if status.get("state") != "held":
            return
        reason, record = str(status["reason"]), under.record
        expecting = (one for one in self._ledger.open if one.expected and re.search(one.expected[0].says, reason))
        if (owner := next(expecting, None)) is not None:
            owner.record.visits += 1
            owner.expected.popleft().mends(self._cell)
        else:
            record.unexpected.append(reason)
            self._cell.quiet()
        if len(record.unexpected) > 2 * PATIENCE:
            raise Stuck(f"held again and again: {reason}")
        aside = len(record.unexpected) > PATIENCE and status.get("job") == record.part
        verb = ("queue", "remove", self._path, record.part) if aside else ("resume", self._path)
        done = self._cell.polishd(*verb)
        if done.returncode:
            record.unexpected.append(f"{verb[0]} is refused: {done.stderr.strip()}")

    def _start_again(self, under: Under) -> None:
        """Restart the daemon, as the service manager does."""
        record = under.record
        if not (record.struck and under.part.script.restarts > record.restarts):
            code = self._cell.process.returncode if self._cell.process else None
            record.unexpected.append(f"the daemon ended with {code}: {_last_line(self._cell.files.daemon_log)}")
            if len(record.unexpected) > 2 * PATIENCE:
                raise Stuck(record.unexpected[-1])
        record.restarts += 1
        self._start()

    def _start(self) -> None:
        self._cell.look()
        self._cell.start_queue()
        self._ledger.started()
        end_s = time.monotonic() + PART_S
        while not self._cell.ended and self._cell.state().get("state") in {None, "starting"}:
            if time.monotonic() > end_s:
                raise Stuck("the daemon does not come up")
            self._pause()

    def _pause(self) -> None:
        time.sleep(LOOK_S)
        self._cell.look()


def grouped(parts: Sequence[Part]) -> Iterator[list[Part]]:
    """Yield groups of parts: each part with a fault alone, several without a fault together."""
    group: list[Part] = []
    for part in parts:
        calm = not (part.script.sim or part.script.wires or part.script.when)
        if group and (not calm or len(group) == GROUP):
            yield group
            group = []
        group.append(part)
        if not calm:
            yield group
            group = []
    if group:
        yield group


def work(
    folder: Path, name: str, seed: int, speed: float, parts: Sequence[Part], until_s: Callable[[], float], keep: Keep
) -> list[str]:
    """Run a session in that folder and return the failures that concern no part."""
    mirrored = random.Random(f"{seed} {parts[0].number}").random() < MIRRORED
    with running_cell(folder, seed + parts[0].number, speed) as cell:
        wrong = prove_instrument(cell, mirrored=mirrored)
        Session(cell, name, seed, keep).run(parts, until_s)
    return wrong


def _last_line(path: Path) -> str:
    lines = path.read_text(errors="replace").splitlines()
    return lines[-1] if lines else ""
