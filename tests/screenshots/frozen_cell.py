"""A cell in which time stands still: a journal of months, a pass under way, and a page server with that clock.

Nothing here is random or depends on the machine, so that two runs give the same pictures.
"""

from __future__ import annotations

import json
import math
import re
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import uvicorn

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import CellConfig, load_config
from polishd.web import overview, watcher
from polishd.web.http.users import Role, UserFile, users_path
from polishd.web.routes import application
from tests.system.browser import Page
from tests.time_limits import SOON_S
from tests.unit.web.filled_journal import DAY_S, EVENT, HOUR_S, MAP, PASS, FilledCell, facts_of, months, stats_of
from tests.unit.web.page_server import Answers, answering

NOW_S = 1_795_921_440.0
"""2026-11-29 3:04 UTC."""
JOB, PART, PROGRAM = "lens-2001", "part-lens-2001", "5f" * 32
FIRST_NM, SECOND_NM, THIRD_NM = 18.4, 4.6, 1.4
BLOCKS, FIRST_BLOCK, LAST_BLOCK = 2500, 40, 2440
DWELL_S, DONE = 1312.0, 1461
SEGMENT = (
    "INSERT INTO segment (job, cycle, seq, start_s, end_s, touched, recovered, force_n, rpm) VALUES (?,?,?,?,?,?,0,?,?)"
)
PHASE = "INSERT INTO phase (job, cycle, phase, started, ended, outcome) VALUES (?,?,?,?,?,?)"
PHASES = (
    (0, "measure", 0, 300), (0, "learn", 300, 310), (0, "solve", 310, 400), (0, "plan", 400, 480),
    (0, "run", 480, 3660),
    (1, "measure", 3660, 3960), (1, "learn", 3960, 3990), (1, "solve", 3990, 4080), (1, "plan", 4080, 4150),
)  # fmt: skip
"""Phases of the part under way: cycle, phase, begin and end in s."""
DRAWING = """
[[tolerance]]
rms_nm = 2.0

[[tolerance]]
psd_nm2_mm2 = 0.4
exponent = 1.5
periods_above_mm = 1
periods_below_mm = 20
"""
SIZE, PITCH_MM = 201, 0.5


def heights(rms_nm: float, stage: int) -> tuple[Any, Any]:
    """A surface of 100 mm after so many passes: what is left is flatter, and finer."""
    y, x = np.mgrid[1 : -1 : SIZE * 1j, -1 : 1 : SIZE * 1j]
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    low = 0.9 * (2 * r**2 - 1) + 0.55 * r**2 * np.cos(2 * angle - 0.7) + 0.5 * (3 * r**3 - 2 * r) * np.sin(angle + 0.4)
    middle = 0.35 * np.cos(9 * x + 1.1) * np.cos(7 * y) + 0.3 * np.cos(19 * r + 0.6) + 0.25 * np.sin(13 * x - 8 * y)
    fine = 0.10 * np.cos(2 * np.pi * y * 50 / 1.5) + 0.12 * np.sin(61 * x + 23 * y) + 0.1 * np.cos(47 * y - 31 * x)
    grain = 0.05 * np.random.default_rng(7 + stage).normal(size=x.shape)
    share = (1.0, 0.22, 0.05)[min(stage, 2)], (0.6, 0.7, 0.55)[min(stage, 2)], (0.10, 0.28, 0.5)[min(stage, 2)]
    height = share[0] * low + share[1] * middle + share[2] * fine + grain * share[2] * 1.5
    inside = r <= 0.94
    height = (height - height[inside].mean()) * rms_nm / height[inside].std()
    return np.where(r <= 1.0, height, np.nan), inside


class FrozenCell(FilledCell):
    """Months of parts without maps, and one part under way with fine maps and real blocks."""

    fine = False

    def surface(self, rms_nm: float, seed: int) -> str:
        """See FilledCell; ``seed`` is the stage for the part under way."""
        if not self.fine:
            return super().surface(rms_nm, seed)
        height, inside = heights(rms_nm, seed)
        whole = np.isfinite(height)
        return self._put(
            {"height_nm": height, "solve_mask": whole, "metric_mask": inside, "pitch_mm": np.float64(PITCH_MM)}
        )

    def plan(self, before_nm: float, after_nm: float, seed: int) -> str:
        """See FilledCell; a raster of 48 lines whose dwell follows the removal."""
        if not self.fine:
            return super().plan(before_nm, after_nm, seed)
        before, inside = heights(before_nm, seed)
        residual, _ = heights(after_nm, seed + 1)
        removal = np.nan_to_num(before - residual)
        removal = removal - removal[inside].min() + 2.0
        n, lines = LAST_BLOCK - FIRST_BLOCK, 48
        line, along = np.divmod(np.arange(n), n // lines)
        share = (along + 0.5) / (n // lines)
        x = 47.0 * (2 * np.where(line % 2, 1 - share, share) - 1)
        y = 47.0 * (1 - 2 * (line + 0.5) / lines)
        column, row = np.rint(x / PITCH_MM + SIZE // 2).astype(int), np.rint(SIZE // 2 - y / PITCH_MM).astype(int)
        weight = np.maximum(removal[row, column], 1.0)
        time_s = DWELL_S * weight / weight.sum()
        end = np.column_stack([x, y, np.zeros(n)])
        values = {"residual_nm": residual, "predicted_removal_nm": removal, "block": FIRST_BLOCK + np.arange(n),
                  "end_mm": end, "start_mm": np.roll(end, 1, axis=0), "time_s": time_s, "expected_s": time_s,
                  "gamma": 0.9 + 0.05 * np.cos(x / 30) - 0.03 * (y / 50) ** 2,
                  "compliance_um_per_n": 2.0 + 0.3 * np.hypot(x, y) / 50}  # fmt: skip
        self.dwell = time_s
        return self._put(values)

    def queued(self, name: str, added_s: float, **more: Any) -> None:
        """See FilledCell; the part under way has the tolerance of the cell's file."""
        text = f'[job]\nid = "{name}"\n[part]\nid = "part-{name}"\n' if name == JOB else ""
        super().queued(name, added_s, **{"text": text, **more})

    def steady(self) -> None:
        """Let every earlier pass take as long as planned, and a little more."""
        for k, (sql, values) in enumerate(self.rows):
            if sql == PASS:
                job, cycle, program, facts, began, _, plan = values
                ended = began + json.loads(facts)["dwell_s"] * (1.03 + 0.012 * (k % 4))
                self.rows[k] = (sql, (job, cycle, program, facts, began, ended, plan))

    def part_under_way(self, *, running: bool) -> int:
        """Add the part under way: two maps, a pass that is done and, ``running``, one that is under way."""
        job = super().part(JOB, NOW_S - 1.9 * HOUR_S, [], "under way")
        self.fine = True
        self.rows = [row for row in self.rows if row[0] != MAP or row[1][0] != job]
        began = NOW_S - 1.9 * HOUR_S
        times = (began + 300, began + 3960)
        for cycle, (rms, taken) in enumerate(zip((FIRST_NM, SECOND_NM), times, strict=True)):
            row = (job, cycle, f"{job}-{cycle}", json.dumps(stats_of(rms)), taken, self.surface(rms, cycle))
            self.rows.append((MAP, row))
        done = self._facts(FIRST_NM, 4.1, SECOND_NM, 3150.0)
        plan = self.plan(FIRST_NM, SECOND_NM, 0)
        self.rows.append((PASS, (job, 0, PROGRAM[:-1] + "0", json.dumps(done), began + 480, began + 3660, plan)))
        for cycle, phase, start, end in PHASES:
            self.rows.append((PHASE, (job, cycle, phase, began + start, began + end, "done")))
        if running:
            self._pass_under_way(job)
        return job

    def _facts(self, before: float, predicted: float, after: float, dwell_s: float) -> dict[str, Any]:
        facts = facts_of(before, predicted, after)
        rest = {"direction": "across", "on_grid": 0.3}
        lines = [
            {**rest, "period_mm": period, "amplitude_nm": 1.41 * rms, "rms_nm": rms, "rms_high_nm": 2 * rms}
            for period, rms in ((1.96, 0.42), (3.3, 0.12))
        ]
        facts["forecast"]["ripple"] = {"lines": lines, "radius_error": 0.03}
        return {**facts, "dwell_s": dwell_s, "certificate": {**facts["certificate"], "dwell_total_s": dwell_s}}

    def _pass_under_way(self, job: int) -> None:
        plan = self.plan(SECOND_NM, THIRD_NM, 1)
        facts = self._facts(SECOND_NM, THIRD_NM, THIRD_NM, DWELL_S)
        del facts["shown"]
        upto = np.concatenate([np.arange(FIRST_BLOCK) * 0.25, 10.0 + np.cumsum(self.dwell) * 1.012])
        elapsed = float(upto[DONE])
        row = (job, 1, PROGRAM, json.dumps(facts), NOW_S - elapsed - 6, None, plan)
        self.rows.append((PASS.replace("'done'", "NULL"), row))
        self.rows.append((PHASE, (job, 1, "run", NOW_S - elapsed - 8, None, None)))
        self.rows += [
            (SEGMENT, (job, 1, k, float(upto[k]), float(upto[k + 1]), int(k >= FIRST_BLOCK), 12.0, 1000.0))
            for k in range(DONE)
        ]


ReadingRow = tuple[float, float | None, float | None, float | None]
PastEvent = tuple[float, str, Mapping[str, Any]]
"""Seconds before now, name of the event, and its data."""


@dataclass(frozen=True, slots=True)
class Scene:
    """State of the cell for some pictures: the live answer, and events that came before it."""

    live: Mapping[str, Any]
    events: tuple[PastEvent, ...] = ()
    """Events after those of every scene."""
    readings: Sequence[ReadingRow] = ()
    """Readings of the last ten minutes."""
    running: bool = True
    """A pass is under way."""
    daemon: bool = True
    ending: Mapping[str, Any] | None = None


def live(**more: Any) -> dict[str, Any]:
    """Live answer of a daemon that polishes."""
    ages = {"actuator": 0.01, "spindle": 0.05, "robot": 0.02, "interferometer.zygo": 3.1, "monitor.slurry": 0.4}
    signals = {
        "slurry_flow": {"value": 2.41, "text": "2.41 l/min", "wrong": "", "action": "hold"},
        "slurry_temperature": {"value": 21.6, "text": "21.6 °C", "wrong": "", "action": "report"},
        "guard": {"value": True, "text": "closed", "wrong": "", "action": "hold"},
    }
    figures = {
        "loop_lag_s": (0.002577, 0.05, False),
        "journal_s": (0.0121, 0.5, False),
        "state_disk_mb": (81760.0, 210.0, True),
        "run_disk_mb": (81760.0, 540.0, True),
        "state_disk_files": (5_120_400.0, 400.0, True),
        "memory_mb": (21400.0, 2400.0, True),
    }
    health = {
        name: {"name": name, "value": value, "limit": limit, "advice": "", "least": least, "fits": True}
        for name, (value, limit, least) in figures.items()
    }
    force = {"force_n": 12.03, "setpoint_n": 12.0, "in_contact": True, "retracted": False, "fault": 0, "age_s": 0.01}
    robot = {"state": "running", "executed": DONE, "buffer_s": 3.2, "age_s": 0.02}
    speed = {"rpm": 1001.0, "fault": 0, "age_s": 0.05}
    known = {"state": "polishing", "reason": "", "next": "", "part": PART, "job": JOB, "cycle": 1, "phase": "run"}
    safety = {"pressing": True, "leaving": "", "approval": "", "unsafe": [], "map_refused": None}
    rest = {"ages_s": ages, "signals": signals, "health": health}
    known |= {**safety, **rest, "readings": {"force": force, "speed": speed, "sensed": None, "robot": robot}}
    return {**known, **more}


def off_the_part(**more: Any) -> dict[str, Any]:
    """Live answer with the tool off the part: force and speed are not read."""
    old = {"force_n": 0.02, "setpoint_n": 0.0, "in_contact": False, "retracted": True, "fault": 0, "age_s": 194.0}
    readings = {"force": old, "speed": {"rpm": 0.0, "fault": 0, "age_s": 194.0}, "sensed": None, "robot": None}
    return live(**{"pressing": False, "readings": readings, **more})


LINK_LOST = (
    "LinkError: actuator: no answer for 0.10 s (actuator.silence_s) on /dev/ttyUSB0. Check its power and its cable"
)
BEFORE: tuple[PastEvent, ...] = (
    (6840, "job_started", {"job": JOB, "part_id": PART, "run_dir": "runs/lens-2001"}),
    (6780, "part_changed", {"part_id": PART}),
    (6540, "map_measured", {"rms_nm": FIRST_NM}),
    (6440, "dwell_solved", {"predicted_rms_nm": 4.1}),
    (6360, "pass_started", {"blocks": BLOCKS, "dwell_s": 3150.0}),
    (3180, "pass_ended", {"executed_s": 3150.0}),
    (2880, "map_measured", {"rms_nm": SECOND_NM}),
    (2850, "estimates_updated", {}),
    (2760, "dwell_solved", {"predicted_rms_nm": THIRD_NM}),
)
POLISHING: tuple[PastEvent, ...] = (
    (1560, "command_received", {"order": "hold", "reason": "slurry topped up", "by": "anna (web)"}),
    (1500, "command_received", {"order": "resume", "reason": "", "by": "anna (web)"}),
    (860, "pass_started", {"blocks": BLOCKS, "dwell_s": DWELL_S}),
)
SAFE = {"tool_off": "yes", "robot_at_rest": "yes", "unsafe": []}
HELD: tuple[PastEvent, ...] = (
    *POLISHING,
    (197, "contact_aborted", {"error": LINK_LOST, "kind": "LinkError"}),
    (194, "cell_held", {"error": LINK_LOST, "kind": "LinkError"}),
    (194, "state_changed", {"state": "held", "reason": LINK_LOST, "next": "", **SAFE}),
)


def readings(contact_s: float, end_s: float = 0.0) -> list[ReadingRow]:
    """Force and speed of ten minutes; in contact from so many seconds ago until ``end_s`` ago."""
    rows: list[ReadingRow] = []
    for k in range(1200):
        back_s = 600 - 0.5 * k
        if not end_s < back_s <= contact_s:  # off the part it is not read
            rows.append((NOW_S - back_s, None, None, None))
            continue
        wave = math.sin(0.9 * k) + math.sin(0.37 * k + 1.0) + 0.8 * math.sin(0.051 * k)
        land = min(1.0, (contact_s - back_s + 0.5) / 2)
        rows.append((NOW_S - back_s, round(12.0 * land + 0.06 * wave, 3), 12.0, round(1000 + 1.8 * wave, 1)))
    return rows


@dataclass(frozen=True, slots=True)
class FrozenServer:
    """The page's server of a scene."""

    url: str
    token: str
    """Token of the operator anna."""
    daemon: Answers | None
    """Daemon of the scene; None without one."""

    def sign_in(self, page: Page, view: str = "dashboard") -> None:
        """Open a view as anna."""
        page.go(self.url)
        page.until("!document.getElementById('sign-in').hidden")
        page.run(SIGN_IN % self.token)
        self.show(page, view)

    def show(self, page: Page, view: str) -> None:
        """Load the page anew with that view."""
        page.go("about:blank")
        page.go(f"{self.url}#{view}")
        page.until("!document.getElementById('main').hidden && document.getElementById('view').firstElementChild")
        page.until(f"document.querySelector('#view > .view-{view.partition('?')[0]}')")


SIGN_IN = """fetch('/api/session', { method: 'POST', headers: { 'content-type': 'application/json' },
    body: JSON.stringify({ token: '%s' }) }).then(() => true)"""


@contextmanager
def frozen_server(folder: Path, scene: Scene) -> Iterator[FrozenServer]:
    """Serve that scene inside the block."""
    path = write_demo(folder / "cell", None, 2.0, 4, None).cell
    text = re.sub(r"(?m)^tolerance_nm = .*$", "", path.read_text()).replace("bench-cell", "cell-7")
    path.write_text(text + DRAWING)
    config = load_config(path)
    cell = FrozenCell(config, maps=False)
    for _ in months(cell, 90, NOW_S - 2 * DAY_S):
        pass
    cell.steady()
    job = cell.part_under_way(running=scene.running)
    for ago_s, name, data in (*BEFORE, *scene.events):
        cell.rows.append((EVENT, (job, NOW_S - ago_s, 1, name, json.dumps(data))))
    for number, (name, by) in enumerate((("lens-2002", "anna"), ("lens-2003", "anna"), ("mirror-7", "erp"))):
        cell.queued(name, NOW_S - (6 - number) * HOUR_S, by="" if number else by)
    if scene.live.get("approval"):
        cell.waiting_plan(job, 1, PROGRAM, SECOND_NM, THIRD_NM, NOW_S - 240)
    cell.rows.sort(key=lambda row: row[1][1] if row[0] == EVENT else 0.0)  # events in the order of time
    cell.write()
    if scene.ending is not None:
        (config.state_dir / "ending.json").write_text(json.dumps(scene.ending))
    token = UserFile(users_path(config)).add("anna", Role.OPERATE)
    clock = SimpleNamespace(time=lambda: NOW_S, monotonic=time.monotonic)
    answers: Answers | None = None
    with ExitStack() as stack:
        for module in (overview, watcher):
            stack.enter_context(patch.object(module, "time", clock))
        stack.enter_context(patch.object(watcher.Watcher, "readings", lambda _self: list(scene.readings)))
        if scene.daemon:
            answers = stack.enter_context(answering(config.state_dir))
            answers.live |= scene.live
        yield FrozenServer(stack.enter_context(_serving(config)), token, answers)


@contextmanager
def _serving(config: CellConfig) -> Iterator[str]:
    settings = uvicorn.Config(application(config), host="127.0.0.1", port=0, log_level="warning", log_config=None)
    server = uvicorn.Server(settings)
    thread = threading.Thread(target=server.run, name="page server", daemon=True)
    thread.start()
    end = time.monotonic() + SOON_S
    while not server.started:
        assert time.monotonic() < end, "the page's server does not start"
        time.sleep(0.01)
    try:
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}/"
    finally:
        server.should_exit = True
        server.force_exit = True
        thread.join(SOON_S)
