"""A map of the last part that comes for this one, from an instrument that names no parts."""

from __future__ import annotations

import contextlib
import re
import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from polishd.sim_backends.common import metropro
from tests.system.cell_rig import ONE_PASS, Daemon, events, with_keys, write_small
from tests.system.sim_rig import wait_for

pytestmark = [pytest.mark.system, pytest.mark.full]


def taken_maps(files: DemoFiles) -> list[str]:
    """Return the contents of the maps that the journal names, in order."""
    with contextlib.closing(sqlite3.connect(files.state_dir / "journal.sqlite")) as connection:
        return [row[0] for row in connection.execute("SELECT sha256 FROM map ORDER BY id")]


def test_the_last_parts_map_that_comes_late_is_not_taken_for_this_part(tmp_path: Path) -> None:
    """The map was requested and measured for the last part; it arrives while the daemon waits for this part's map."""
    files = write_small(tmp_path / "cell", **ONE_PASS)
    unnamed = {"accept_without_part_id": True, "clock_tolerance_s": 1.0}
    files.cell.write_text(with_keys(files.cell.read_text(), {"metrology": unnamed}))
    files.sim.write_text(with_keys(files.sim.read_text(), {"interferometer": {"write_s": 2.0}}))
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", "40"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        with Daemon(files) as daemon:
            wait_for(lambda: len(events(files, "measured")) == 2, "the map after the first pass to be measured")
            daemon.end()
        (first,) = taken_maps(files)
        (path,) = files.out.glob(f"sim/**/{first}.dat")
        maps = path.parents[1]
        late_s = int((files.state_dir / "maps_taken.json").stat().st_mtime)
        late = metropro.unpack(path.read_bytes())
        late = replace(late, height_nm=-late.height_nm, taken_s=late_s, part="")
        files.cell.write_text(with_keys(files.cell.read_text(), {"part": {"id": "P-2"}, "job": {"id": "second"}}))
        with Daemon(files) as daemon:
            wait_for(lambda: len(events(files, "map_requested")) == 3, "this part's map to be asked for")
            (maps / "late.dat").write_bytes(metropro.pack(late))
            reason = maps / "quarantine" / "late.dat.reason.txt"
            wait_for(reason.exists, "the late map to be refused")
            daemon.end()
    assert re.search(r"StaleMap: (stale|out of order)", reason.read_text())
    assert taken_maps(files) == [first]
