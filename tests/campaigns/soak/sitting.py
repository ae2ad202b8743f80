"""A sitting: one simulated cell and one daemon that stays up for many parts, each with what befalls it."""

from __future__ import annotations

import math
import random
import re
import shutil
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from polishd.daemon import client
from polishd.model.errors import PolishdError
from tests.campaigns.soak.cell import Row, SoakCell, prove_instrument, running_cell
from tests.campaigns.soak.judge import told_of, truth_of
from tests.campaigns.soak.parts import Part
from tests.campaigns.soak.scripts import Visit
from tests.campaigns.soak.usage import held

LOOK_S = 0.1
MIRRORED = 1 / 3
"""Of the sittings in which the artefact is measured by a mirrored instrument first."""
GROUP = 3
"""Parts that nothing befalls are added so many at once."""
PART_S = 300.0
"""A part that takes longer is stuck."""
PATIENCE = 4
"""So often a person comes to one part over what nobody expects; then it is taken out."""
LATE_S = 0.4
"""A campaign that was kept waiting for so long ran on a machine that is too slow: half of the shortest silence."""
DEVICE_FAULTS = ("LinkError", "DeviceFault", "SafetyStop", "HostFault", "ProtocolError", "DeviceRefused")


class Stuck(Exception):
    """The sitting cannot go on."""


@dataclass(slots=True)
class Record:
    """What is kept of a part."""

    number: int
    part: str
    script: str
    sitting: str
    life: str
    """The daemon's, as it ended."""
    age: int = 0
    """Parts that this daemon has ended before."""
    verdict: str = ""
    fault: str = ""
    reason: str = ""
    visits: int = 0
    """Of a person who was expected."""
    unexpected: list[str] = field(default_factory=list)
    """Reasons for which a person came, or the daemon ended, that nobody expected."""
    restarts: int = 0
    struck: bool = True
    """What was to befall it did."""
    wall_s: float = 0.0
    cpu_s: dict[str, float] = field(default_factory=dict)
    held: dict[str, float] = field(default_factory=dict)
    """What daemon and worker held as it ended, and what was written for it."""
    late_s: float = 0.0
    """By how much the campaign itself was kept waiting, at most."""
    tolerance_nm: float = 0.0
    told: dict[str, float] = field(default_factory=dict)
    true_rms_nm: float = 0.0
    deeper_nm: float = 0.0
    passes: int = 0
    wrong: list[str] = field(default_factory=list)
    """What may not be; empty where all is as it should be."""


@dataclass(slots=True)
class Under:
    """A part under way, or not yet judged."""

    part: Part
    record: Record
    expected: deque[Visit]
    began_s: float
    ended_s: float = 0.0
    until_s: float = math.inf
    """From then on it is another part's time."""
    row: Row | None = None


class Sitting:
    """Works parts, one group after the other."""

    def __init__(self, cell: SoakCell, name: str, seed: int, keep: Callable[[Record, SoakCell], None]) -> None:
        self._cell, self._name, self._seed, self._keep = cell, name, seed, keep
        self._lives = 0
        self._age = 0
        self._waits: list[Under] = []
        """Parts that ended and were not judged: their truth is there once another has taken their seat."""
        self._late_s = 0.0
        self._used: Counter[str] = Counter()
        self._written_mb = 0.0

    def run(self, parts: Sequence[Part], until_s: float) -> None:
        """All of them, or until that time; what was begun is ended."""
        self._start()
        try:
            for group in grouped(parts):
                if time.monotonic() > until_s:
                    break
                self._work(group)
        except (Stuck, AssertionError) as error:
            self._waits[-1].record.wrong.append(f"stuck: {error}")
        self._cell.kill()
        self._cell.rest()
        for under in self._waits:
            self._judge(under, self._surface(under, self._cell.files.sim_dir / "truth.npz"))

    # one group

    def _work(self, group: Sequence[Part]) -> None:
        first = group[0]
        if first.script.when == "between jobs":
            first.script.strike(self._cell)
            self._start()
        sections = first.script.sections(first.name)
        plant = {"rms_nm": first.rms_nm, "pv_nm": first.pv_nm, **sections.pop("plant", {})}
        self._cell.set({**sections, "plant": plant})
        self._add(group)
        for part in group:
            self._follow(part)
        self._between()
        self._waits[-1].expected.extend(group[-1].script.after)

    def _add(self, group: Sequence[Part]) -> None:
        paths = []
        for part in group:
            path = self._cell.files.out / f"{part.name}.toml"
            job = f'[job]\nid = "{part.name}"\ntolerance_nm = {part.tolerance_nm}\nmax_cycles = 4\n'
            path.write_text(f'{job}[part]\nid = "{part.name}"\n')
            paths.append(str(path))
        said = self._cell.polishd("job", "add", str(self._cell.files.cell), *paths)
        if said.returncode:
            raise Stuck(f"polishd job add: {said.stderr}")

    def _follow(self, part: Part) -> None:
        """Until its job has ended, seeing to what comes."""
        record = Record(part.number, part.name, part.script.name, self._name, "", tolerance_nm=part.tolerance_nm)
        under = Under(part, record, deque(part.script.visits), time.monotonic())
        record.struck = part.script.when in {"", "between jobs"}
        record.restarts = int(part.script.when == "between jobs")
        for earlier in self._waits:
            earlier.until_s = min(earlier.until_s, under.began_s)
        self._waits.append(under)
        self._late_s, landed = 0.0, self._landings()
        while (row := self._cell.row(part.name)) is None or row.verdict is None:
            if time.monotonic() > under.began_s + PART_S:
                raise Stuck(f"{part.name} does not end: {self._cell.state()}")
            if self._cell.ended:
                self._restart_after(under)
                continue
            status = self._cell.state()
            if status.get("state") == "held":
                self._visit(under, str(status["reason"]))
            elif not record.struck and self._is_time(part, status, landed):
                record.struck = True
                part.script.strike(self._cell)
            self._pause()
        under.row, under.ended_s = row, time.monotonic()
        self._measure(under)
        self._judge_earlier(under)

    def _is_time(self, part: Part, status: dict[str, Any], landed: int) -> bool:
        """For what befalls it."""
        if part.script.when == "solving":
            return status.get("job") == part.name and status.get("phase") == "solve"
        if self._landings() == landed:
            return False
        time.sleep(random.Random(f"{self._seed} {part.number} when").uniform(0.0, 0.8))  # somewhere in its pass
        return True

    def _landings(self) -> int:
        return sum(event["event"] == "tool_landed" for event in self._cell.log.look())

    def _between(self) -> None:
        """The queue is empty: a person sees to what stopped it."""
        end_s = time.monotonic() + PART_S
        while True:
            state = "" if self._cell.ended else self._cell.state().get("state")
            if self._cell.ended:
                self._restart_after(self._waits[-1])
            elif state == "held":
                self._visit(self._waits[-1], str(self._cell.state().get("reason", "")))
            elif state == "idle" and not (self._waits and self._waits[-1].expected):
                return
            if time.monotonic() > end_s:
                raise Stuck(f"the queue does not come to rest: {self._cell.state()}")
            self._pause()

    # who sees to it

    def _visit(self, under: Under, reason: str) -> None:
        """A person reads why it is held, mends that, and says that it may go on."""
        told = self._cell.asked("status", str(self._cell.files.cell))
        if told.get("state") != "held":
            return
        reason = str(told["reason"])
        owner = next((one for one in self._waits if one.expected and re.search(one.expected[0].says, reason)), None)
        if owner is not None:
            owner.record.visits += 1
            owner.expected.popleft().mends(self._cell)
        else:
            under.record.unexpected.append(reason)
            self._cell.quiet()
            if len(under.record.unexpected) > 2 * PATIENCE:
                raise Stuck(f"held again and again: {reason}")
        aside = len(under.record.unexpected) > PATIENCE and told.get("job") == under.part.name
        verb = ("job", "remove", str(self._cell.files.cell), under.part.name) if aside else ("resume", self._path)
        done = self._cell.polishd(*verb)
        if done.returncode:
            under.record.unexpected.append(f"{' '.join(verb[:-1])} is refused: {done.stderr.strip()}")

    @property
    def _path(self) -> str:
        return str(self._cell.files.cell)

    def _restart_after(self, under: Under) -> None:
        """Whoever watches over the daemon starts it again."""
        expected = under.part.script.restarts > under.record.restarts and under.record.struck
        if not expected:
            code = self._cell.process.returncode if self._cell.process else None
            under.record.unexpected.append(f"the daemon ended with {code}: {_last_line(self._cell.files.daemon_log)}")
            if len(under.record.unexpected) > PATIENCE:
                raise Stuck(under.record.unexpected[-1])
        under.record.restarts += 1
        self._start()

    def _start(self) -> None:
        self._cell.start_queue()
        self._lives, self._age = self._lives + 1, 0
        end_s = time.monotonic() + PART_S
        while not self._cell.ended and self._cell.state().get("state") in {None, "starting"}:
            if time.monotonic() > end_s:
                raise Stuck("the daemon does not come up")
            self._pause()

    def _pause(self) -> None:
        before = time.monotonic()
        time.sleep(LOOK_S)
        self._late_s = max(self._late_s, time.monotonic() - before - LOOK_S)
        self._cell.look()

    # what is known of it

    def _measure(self, under: Under) -> None:
        record, cell = under.record, self._cell
        cell.look()
        total = cell.meter.total_s()
        record.cpu_s = {name: round(total[name] - self._used[name], 3) for name in total}
        self._used = total
        record.wall_s = round(under.ended_s - under.began_s, 3)
        record.late_s = round(self._late_s, 3)
        record.life, record.age, self._age = f"{self._name}/{self._lives}", self._age, self._age + 1
        written_mb = cell.written_mb()
        record.held["written_mb"] = round(written_mb - self._written_mb, 4)
        self._written_mb = written_mb
        daemon = None if cell.process is None else held(cell.process.pid)
        if daemon is not None:
            record.held |= {"daemon_rss_mb": daemon.rss_mb, **_counts(asdict(daemon))}
        if workers := [found for pid in cell.workers() if (found := held(pid)) is not None]:
            record.held["worker_rss_mb"] = sum(found.rss_mb for found in workers)
        try:
            record.held["tasks"] = float(client.request(cell.files.state_dir, "status", 5.0)["tasks"])
        except (PolishdError, KeyError):
            pass  # it has ended meanwhile, and that is seen to elsewhere

    def _judge_earlier(self, now: Under) -> None:
        """Those whose seat another part has taken."""
        for under in [one for one in self._waits if one is not now and not one.expected]:
            if (surface := self._surface(under)) is not None:
                self._waits.remove(under)
                self._judge(under, surface)

    def _surface(self, under: Under, else_: Path | None = None) -> Path | None:
        """The plant's file of it, once it was taken off."""
        path = self._cell.files.sim_dir / "parts" / f"{under.part.name}.npz"
        return path if path.exists() else else_

    def _judge(self, under: Under, surface: Path | None) -> None:
        record, script, row = under.record, under.part.script, under.row
        if row is None or surface is None:
            self._keep(record, self._cell)
            return
        record.verdict, record.fault, record.reason = str(row.verdict), row.fault, row.reason
        found = truth_of(self._cell, row, surface, under.began_s, under.until_s)
        record.true_rms_nm, record.deeper_nm = round(found.rms_nm, 4), round(found.deeper_nm, 3)
        record.passes, record.told = found.passes, told_of(row.run_dir)
        record.wrong += found.wrong
        end = script.end if record.struck else "accepted"
        faults = script.faults if record.struck else ("",)
        if record.verdict != end or record.fault not in faults:
            record.wrong.append(f"end: {record.verdict} ({record.reason}), where {end} {'/'.join(faults)} was expected")
        expected = [] if math.isinf(under.until_s) else under.expected  # of the last part nobody knows what comes after
        if missing := [visit.says for visit in expected if record.struck]:
            record.wrong.append(f"end: the cell was not held over {missing}")
        record.wrong += [f"held: {reason}" for reason in record.unexpected]
        if record.restarts != (script.restarts if record.struck else 0):
            record.wrong.append(f"end: {record.restarts} starts of the daemon, where {script.restarts} were expected")
        self._keep(record, self._cell)
        if row.run_dir:
            shutil.rmtree(row.run_dir, ignore_errors=True)
        surface.unlink(missing_ok=True)


def grouped(parts: Sequence[Part]) -> Iterator[list[Part]]:
    """Each alone that anything befalls; those in peace, several together."""
    group: list[Part] = []
    for part in parts:
        calm = not part.script.sim and not part.script.when
        if group and (not calm or len(group) == GROUP):
            yield group
            group = []
        group.append(part)
        if not calm:
            yield group
            group = []
    if group:
        yield group


def work(folder: Path, name: str, seed: int, speed: float, parts: Sequence[Part], until_s: float,
         keep: Callable[[Record, SoakCell], None]) -> list[str]:  # fmt: skip
    """A sitting in that folder; what was wrong with it apart from its parts."""
    wrong: list[str] = []
    with running_cell(folder, seed + parts[0].number, speed) as cell:
        wrong += prove_instrument(cell, mirrored=random.Random(f"{seed} {parts[0].number}").random() < MIRRORED)
        Sitting(cell, name, seed, keep).run(parts, until_s)
    return wrong


def too_slow(record: Record) -> bool:
    """A device seemed silent because the machine kept everybody waiting."""
    of_devices = [said for said in record.unexpected if any(name in said for name in DEVICE_FAULTS)]
    return record.late_s > LATE_S and (bool(of_devices) or record.fault in DEVICE_FAULTS)


def _counts(found: dict[str, Any]) -> dict[str, float]:
    return {name: float(found[name]) for name in ("descriptors", "threads")}


def _last_line(path: Path) -> str:
    lines = path.read_text(errors="replace").splitlines()
    return lines[-1] if lines else ""
