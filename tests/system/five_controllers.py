"""Compare two passes on five controllers, each of which takes additional time per point.

``python -m tests.system.five_controllers`` writes the results that the tests saved to docs/reference/results.md.
"""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, demo_program, simulated_cell
from tests.system import linuxcnc_rig, plc_robot_rig, universal_robots_rig
from tests.system.cell_rig import (
    PATIENT,
    Daemon,
    account,
    events,
    summary,
    with_keys,
    with_part,
    write_small,
)
from tests.system.test_daemon import require_safe_order

PART = {"aperture_mm": 20.0}
FINE, ROUGH = {"pv_nm": 100.0, "rms_nm": 18.0}, {"pv_nm": 500.0, "rms_nm": 100.0}
"""Surfaces. The rough one needs long dwells: for controllers with long cycles or much time per point."""
TWO_PASSES = {"tolerance_nm": 0.01, "max_cycles": 2}
CALM = {"max_spot_change": 0.99, "max_rate_drift": 0.99}
"""Limits for a small part, whose maps determine the spot poorly."""
MAX_FEED_MM_S = 14.0
"""sqrt(a L) / 2 with a = 800 mm/s2 and blocks of L = 1 mm: the most that LinuxCNC reaches with rotary axes."""
SPEED = 8.0
Kind = Literal["link", "linuxcnc", "opcua", "ads", "universal_robots"]
Encoding = Literal["feed", "dwell"]
PROGRAMS: dict[Encoding, Callable[..., bytes]] = {"feed": demo_program, "dwell": universal_robots_rig.nc}


@dataclass(frozen=True, slots=True)
class Controller:
    """Controller of the comparison."""

    name: str
    kind: Kind
    encoding: Encoding
    beyond_s: float | None
    """Additional time per point; None for a real controller, where it is unknown."""
    corner_deg: float = 30.0
    """Change of direction above which the robot stops between two blocks."""
    speed: float = SPEED
    rough: bool = False
    """Whether the part has the rough surface."""


FIVE = (
    Controller("robot link", "link", "feed", 0.007),
    Controller("LinuxCNC", "linuxcnc", "feed", None, corner_deg=180.0, speed=1.0),
    Controller("PLC robot, OPC UA", "opcua", "feed", 0.03),
    Controller("PLC robot, ADS", "ads", "feed", 0.03),
    Controller("Universal Robots", "universal_robots", "dwell", 0.02, speed=4.0, rough=True),
)
SLOW_PLC = Controller("PLC robot, OPC UA, slow", "opcua", "feed", 0.29, rough=True)
"""Controller whose additional time is longer than most dwells: it causes most of the removal."""


def link_like(controller: Controller) -> Controller:
    """Return a robot link with the same encoding and additional time; without one for a real controller."""
    return Controller("robot link", "link", controller.encoding, controller.beyond_s or 0.0, rough=controller.rough)


@dataclass(frozen=True, slots=True)
class Figures:
    """Results of two passes."""

    name: str
    encoding: Encoding
    blocks: int
    """Number of blocks in contact that take time."""
    beyond_ms: float
    """Additional time per block, as estimated from the first pass."""
    missed: tuple[float, float]
    """Relative difference of measured and predicted time, of each pass."""
    unaccounted: tuple[float, float]
    """Relative difference of the driver's and the plant's contact time, of each pass."""
    rms_nm: tuple[float, float, float]
    """RMS before, after one pass and after two."""
    certified_nm: tuple[float, float]
    """Residual RMS that the optimality certificates of both passes predict."""
    link_rms_nm: float | None = None
    """RMS that a robot link with the same additional time leaves; None where it was not measured."""


def write_files(out: Path, controller: Controller) -> DemoFiles:
    """Write the demo's cell with a small part, that controller and its program."""
    files = write_small(out, **TWO_PASSES)
    program = PROGRAMS[controller.encoding]
    if controller.kind == "linuxcnc":
        linuxcnc_rig.take(files)
        again = {"part_handling": {"settle.wait_s": 1.0, "settle.max_maps": 3}}  # where a map is doubted: real seconds
        files.cell.write_text(with_keys(files.cell.read_text(), {**PATIENT, **again}))
        files.profile.write_text(with_keys(files.profile.read_text(), {"repeatability": {"rms_nm": 0.3}}))
    elif controller.kind == "universal_robots":
        universal_robots_rig.take(files, cycle_hz=500)
        program = universal_robots_rig.script
    elif controller.kind != "link":
        plc_robot_rig.hand_over(files, controller.kind)
    if controller.beyond_s is not None:
        lines = 2 if controller.encoding == "dwell" else 1  # a point's
        hidden = {"overhead_s": controller.beyond_s / lines, "overhead_spread": 0.0}
        files.sim.write_text(with_keys(files.sim.read_text(), {"hidden_truth": hidden}))
    files.sim.write_text(with_keys(files.sim.read_text(), {"effects": {"eq_44": [1.0, 1.0], "friction": [0.0, 0.0]}}))
    late = linuxcnc_rig.LATE["limits"] if controller.kind == "linuxcnc" else {}
    changed: dict[str, dict[str, Any]] = {"limits": {**CALM, **late}}
    if controller.encoding == "feed":
        changed["machine"] = {"max_feed_mm_s": MAX_FEED_MM_S, "corner_deg": controller.corner_deg}
    files.cell.write_text(with_keys(files.cell.read_text(), changed))
    with_part(files, PART, program, **(ROUGH if controller.rough else FINE))
    return files


@contextlib.contextmanager
def running(files: DemoFiles, controller: Controller) -> Iterator[Callable[[], Daemon]]:
    """Run the simulator for the duration of the block; the value starts a daemon."""
    if controller.kind == "linuxcnc":
        with linuxcnc_rig.linuxcnc_cell(files) as cell:
            yield cell.daemon
    else:
        options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", f"{controller.speed:g}"]
        with simulated_cell(files.sim, options, files.out / "sim.stderr"):
            yield lambda: Daemon(files, "--no-hold")


def polish(out: Path, controller: Controller) -> Figures:
    """Polish two passes and return their results."""
    files = write_files(out, controller)
    with running(files, controller) as started:
        with started() as daemon:
            assert daemon.wait() == 1, daemon.output.read_text()
        require_safe_order(events(files))
        programs = account(files)["programs"]
    assert [program["loads"] for program in programs] == [1, 1]
    return figures(files, controller, [np.array(program["contact_s"]) for program in programs])


def figures(files: DemoFiles, controller: Controller, true_s: Sequence[np.ndarray[Any, Any]]) -> Figures:
    """Return the results of two passes from the run folder and the plant's record of contact."""
    predicted, reported_s = [], []
    for cycle in (0, 1):
        folder = files.run_dir / f"cycle-{cycle:02d}"
        rows = np.genfromtxt(folder / "executed.csv", delimiter=",", names=True)
        reported_s.append(float(np.sum((rows["end_s"] - rows["start_s"]) * (rows["contact"] == 1))))
        with np.load(folder / "plan.npz") as plan:
            predicted.append(float(plan["expected_s"].sum()))
            blocks = len(plan["expected_s"])
    first, second, last = summary(files)["cycles"]
    learned = json.loads((files.run_dir / "cycle-01" / "learned.json").read_text())
    return Figures(
        controller.name,
        controller.encoding,
        blocks,
        learned["beliefs"]["block_overhead_s"] * 1e3,
        (reported_s[0] / predicted[0] - 1.0, reported_s[1] / predicted[1] - 1.0),
        (reported_s[0] / float(true_s[0].sum()) - 1.0, reported_s[1] / float(true_s[1].sum()) - 1.0),
        (first["rms_nm"], second["rms_nm"], last["rms_nm"]),
        (first["predicted_rms_nm"], second["predicted_rms_nm"]),
    )


SAVED = Path("build/five-controllers")
PAGE = Path(__file__).parents[2] / "docs" / "reference" / "results.md"
BEGIN = "<!-- written by python -m tests.system.five_controllers -->\n"
END = "<!-- end of what it writes -->"
HEADER = """\
| controller | program | a point, ms | beyond prediction, % | unaccounted, % | RMS, nm | certified | link |
|---|---|---|---|---|---|---|---|
"""


def save(found: Figures) -> None:
    """Save the results for the table."""
    SAVED.mkdir(parents=True, exist_ok=True)
    name = found.name.lower().replace(",", "").replace(" ", "-")
    (SAVED / f"{name}.json").write_text(json.dumps(asdict(found), indent=1))


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the table with a row for each controller, in the order of ``FIVE``."""
    names = [controller.name for controller in (*FIVE, SLOW_PLC)]
    lines = []
    for row in sorted(rows, key=lambda row: names.index(row["name"])):
        missed, unaccounted = (
            ", ".join(f"{share * 100:.{digits}f}" for share in row[key])
            for key, digits in (("missed", 2), ("unaccounted", 4))
        )
        rms = ", ".join(f"{value:.2f}" for value in row["rms_nm"])
        link = "-" if row["link_rms_nm"] is None else f"{row['link_rms_nm']:.2f}"
        figures = f"{row['beyond_ms']:.1f} | {missed} | {unaccounted} | {rms} | {row['certified_nm'][1]:.2f} | {link}"
        lines.append(f"| {row['name']} | {row['encoding']}, {row['blocks']} points | {figures} |\n")
    return HEADER + "".join(lines)


def rows_of(page: str) -> list[list[str]]:
    """Return the cells of the table in the page."""
    written = page.partition(BEGIN)[2].partition(END)[0].removeprefix(HEADER)
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in written.splitlines()]


def write_page() -> None:
    """Write the table of the saved results to docs/reference/results.md. SystemExit where there are none."""
    rows = [json.loads(path.read_text()) for path in SAVED.glob("*.json")]
    if not rows:
        sys.exit(f"nothing was measured: no files in {SAVED}, and the page stays as it is. Run its tests first.")
    before, _, rest = PAGE.read_text().partition(BEGIN)
    after = rest.partition(END)[2]
    PAGE.write_text(before + BEGIN + table(rows) + END + after)


if __name__ == "__main__":
    write_page()
