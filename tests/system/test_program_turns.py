"""Two programs that take turns on a simulated cell: each pass has its own, also the one that a stop interrupts."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from polishd.config.cell import load_config
from polishd.daemon.socket import client
from polishd.model.surface import FloatArray
from polishd.plugin_loader import plugins_of
from polishd.programs.make import make_program
from polishd.programs.options import MakeOptions
from tests.rs274 import RS274
from tests.system.agreement import require_agreement
from tests.system.cell_rig import Daemon, account, summary, with_keys, write_small
from tests.system.sim_rig import wait_for
from tests.system.test_daemon import polishd

pytestmark = pytest.mark.system

NAMES = "program.rnc", "between.rnc"
PITCH_MM = 1.0


@contextlib.contextmanager
def two_programs(out: Path) -> Iterator[DemoFiles]:
    """Write a small cell with a raster, and a second one between its lines."""
    files = write_small(out, tolerance_nm=0.01, max_cycles=2)
    files.cell.write_text(with_keys(files.cell.read_text(), {"program": {"path": list(NAMES)}}))
    config = load_config(files.cell)
    for path, phase in zip(config.program_paths, (0.0, 0.5), strict=True):
        path.unlink(missing_ok=True)
        options = MakeOptions("raster", path, cell=files.cell, pitch_mm=PITCH_MM, step_mm=1.0, phase=phase)
        path.write_bytes(make_program(options, config, plugins_of(config)).text)
    quick = ["--state", str(files.sim_dir), "--seed", "5", "--speed", "20"]
    with simulated_cell(files.sim, quick, files.out / "sim.stderr"):
        yield files


def lines_mm(text: bytes) -> FloatArray:
    """Return the positions of the lines, of which each has many points."""
    y, count = np.unique(np.round(RS274.read(text, "program").end_mm[:, 1], 2), return_counts=True)
    return np.asarray(y[count > 5])


def is_between(lines: FloatArray, others: FloatArray) -> bool:
    apart = np.abs(lines[:, None] - others).min(axis=1)
    return bool(np.all(np.abs(apart - PITCH_MM / 2) < 0.02))


@pytest.mark.full
def test_two_passes_have_two_programs_and_a_stopped_pass_goes_on_with_its_own(tmp_path: Path) -> None:
    with two_programs(tmp_path / "cell") as files:
        between = files.out / NAMES[1]
        with Daemon(files) as daemon:
            wait_for(lambda: {"cycle": 1, "phase": "run"}.items() <= daemon.status().items(), "pass 2")
            daemon.wait_in_contact(60)
            assert daemon.end() == 1, daemon.output.read_text()
        text = between.read_bytes()
        between.write_bytes(text.replace(b"M2", b"(another one)\nM2"))
        refused = polishd("run", files.cell)
        assert refused.returncode == 3
        assert "program.path: is [program.rnc (sha256 " in refused.stderr.replace("\n", " ")
        between.write_bytes(text)
        with Daemon(files) as daemon:
            assert "interrupted" in daemon.wait_for_state("held")["reason"]
            assert client.request(files.state_dir, "resume")["ok"]
            assert daemon.wait() == 1, daemon.output.read_text()
        require_agreement(files)
        loaded = [program["sha256"] for program in account(files)["programs"]]
    cycles = summary(files)["cycles"]
    assert [(one["program"], one["how"]) for one in cycles] == [
        (NAMES[0], "done"),
        (NAMES[1], "interrupted"),
        (NAMES[1], "done"),
        (None, None),
    ]
    sent = [(files.run_dir / f"cycle-{cycle:02d}" / "program.rnc").read_bytes() for cycle in range(3)]
    assert loaded == [hashlib.sha256(text).hexdigest() for text in sent], "the robot ran what the run folder has"
    first, stopped, again = map(lines_mm, sent)
    assert is_between(stopped, first)
    assert np.array_equal(stopped, again)
    assert cycles[-1]["rms_nm"] < 0.2 * cycles[0]["rms_nm"]
