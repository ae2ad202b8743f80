"""The whole simulated cell with a robot whose controller loads files: polished, and what it told compared with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.console.demo_files import DemoFiles
from tests.system.cell_rig import Daemon, account, events, summary
from tests.system.handover_rig import running, write_files
from tests.system.test_daemon import require_safe_order

pytestmark = pytest.mark.system

APERTURE_MM = 20.0
SPEED = 8.0


def polished(out: Path, kind: str, profile: str = "plc-opcua") -> DemoFiles:
    """Two passes, whatever they reach."""
    files = write_files(out, kind, profile, APERTURE_MM, tolerance_nm=0.01, max_cycles=2)
    with running(files, SPEED), Daemon(files) as daemon:
        assert daemon.wait() == 1, daemon.output.read_text()
    return files


def told_and_true_s(files: DemoFiles, cycle: int) -> tuple[np.ndarray, np.ndarray]:
    """Contact of each block, by the driver and by the plant, s."""
    rows = np.genfromtxt(files.run_dir / f"cycle-{cycle:02d}" / "executed.csv", delimiter=",", names=True)
    true = np.array(account(files)["programs"][cycle]["contact_s"])
    told = np.zeros(len(true))
    np.add.at(told, rows["seq"].astype(int), (rows["end_s"] - rows["start_s"]) * (rows["contact"] == 1))
    return told, true


def final_rms_nm(files: DemoFiles) -> float:
    cycles: list[dict[str, Any]] = summary(files)["cycles"]
    return float(cycles[-1]["rms_nm"])


@pytest.mark.full
def test_a_controller_that_loads_files_polishes_as_one_that_is_streamed_to(tmp_path: Path) -> None:
    files = polished(tmp_path / "opcua", "opcua")
    require_safe_order(events(files))
    for cycle in (0, 1):
        told, true = told_and_true_s(files, cycle)
        assert told.sum() == pytest.approx(true.sum(), rel=1e-3)
    link = polished(tmp_path / "link", "link")
    assert final_rms_nm(files) == pytest.approx(final_rms_nm(link), rel=0.1)
