"""A whole job with bad wires, a faulty instrument or a broken actuator completes, or ends safe and reports the reason.

Whatever happens, no block is polished twice, and force and tool are off the part before motion stops.
"""

from __future__ import annotations

import contextlib
import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from tests.system.cell_rig import ONE_PASS, Daemon, events, summary, with_faults, with_keys, write_small
from tests.system.sim_rig import wait_for
from tests.system.test_daemon import polishd, require_nothing_twice, require_safe_order

pytestmark = [pytest.mark.system, pytest.mark.full]

DEVICE, SAFETY = 5, 7

Fault = Mapping[str, Any]


@contextlib.contextmanager
def faulty_cell(
    out: Path, *faults: Fault, seed: int = 1, speed: float = 40.0, bad_instrument: bool = False, **job: Any
) -> Iterator[DemoFiles]:
    """Run a simulator with the small part and these faults for the duration of the block."""
    files = write_small(out, **{**ONE_PASS, **job})
    files.sim.write_text(
        with_faults(with_keys(files.sim.read_text(), BAD_INSTRUMENT if bad_instrument else {}), *faults)
    )
    options = ["--state", str(files.sim_dir), "--seed", str(seed), "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files


def require_off_the_part(files: DemoFiles) -> None:
    """Require the safe order in the simulator's log: force off, tool lifted, motion in contact stopped last."""
    wait_for(lambda: events(files, "tool_landed", "tool_lifted")[-1]["event"] == "tool_lifted", "the tool to be lifted")
    log = events(files)
    last = {event["event"]: k for k, event in enumerate(log)}
    assert last["tool_landed"] < last["force_zero"] < last["tool_lifted"], log[-12:]
    if last.get("motion_started", -1) > last["tool_landed"]:
        wait_for(
            lambda: events(files, "motion_started", "motion_stopped")[-1]["event"] == "motion_stopped", "standstill"
        )
        if events(files, "motion_stopped")[-1].get("detail") == "lift":  # the robot took the tool off itself
            assert last["motion_started"] < last["contact_lost"] < last["tool_lifted"], log[-12:]
        elif events(files, "motion_stopped")[-1].get("detail") == "until":  # the pass ended before the fault
            assert last["motion_stopped"] < last["force_zero"] < last["tool_lifted"], log[-12:]
        else:
            require_safe_order(events(files))


def test_faults_are_put_into_the_simulators_file() -> None:
    text = 'x = 1\n[[fault]]  # c\nwhat = "a"\n\n# [[fault]]\n[[fault]]\nwhat = "b"\n[spindle]\nkind = "slcan"\n'
    found = tomllib.loads(with_faults(text, {"what": "c", "by_s": 0.5}, {"what": "d"}))
    assert found == {"x": 1, "fault": [{"what": "c", "by_s": 0.5}, {"what": "d"}], "spindle": {"kind": "slcan"}}


def late(device: str, jitter_s: float, by_s: float) -> list[Fault]:
    """Return a fault that delays every frame a little, and one in fifty much."""
    delay = {"device": device, "what": "delay"}
    return [{**delay, "rate": 1.0, "jitter_s": jitter_s}, {**delay, "rate": 0.02, "by_s": by_s}]


def bad(device: str, garbled: float, lost: float) -> list[Fault]:
    """Return a fault of the frames from the device."""
    return [{"device": device, "what": what, "rate": rate} for what, rate in (("garble", garbled), ("drop", lost))]


LATE = [*late("robot", 0.01, 0.15), *late("actuator", 0.004, 0.1), *late("spindle", 0.004, 0.1)]
BAD_INSTRUMENT = {"interferometer.faults": {"preallocate": True, "duplicate_first": True, "wrong_part_first": True}}


def test_a_nasty_instrument_and_late_replies_do_not_keep_a_job_from_its_tolerance(tmp_path: Path) -> None:
    """Before each map come another part's map and the last map again; files have full length from the start."""
    with faulty_cell(tmp_path / "cell", *LATE, bad_instrument=True, seed=3, speed=80.0) as files:
        with Daemon(files) as daemon:
            assert daemon.wait() == 0, daemon.output.read_text()
        require_nothing_twice(files)
        dropped = [event["file"] for event in events(files, "map_dropped")]
        measured = [event["true_rms_nm"] for event in events(files, "measured")]
    end = summary(files)
    assert end["outcome"] == "in_tolerance"
    recorded = [cycle["rms_nm"] for cycle in end["cycles"]]
    assert len(recorded) == len(dropped) >= 2, "one map a request, and only the right ones are taken"
    # neither an old map, nor another part's (it is the negative), nor one with a tail of zeros
    assert recorded == pytest.approx(measured[: len(recorded)], rel=0.02, abs=0.2)


BAD_WIRES: dict[str, list[Fault]] = {
    "robot": bad("robot", 0.01, 0.005),
    "actuator": bad("actuator", 0.01, 0.01),
    "spindle": bad("spindle", 0.02, 0.02),
}


@pytest.mark.parametrize(
    "device", [name if name == "robot" else pytest.param(name, marks=pytest.mark.slow) for name in BAD_WIRES]
)
def test_a_bad_wire_ends_in_tolerance_or_safe_with_a_device_error(tmp_path: Path, device: str) -> None:
    with faulty_cell(tmp_path / "cell", *BAD_WIRES[device], seed=2, speed=80.0) as files:
        with Daemon(files, "--no-hold") as daemon:
            code = daemon.wait()
            said = daemon.output.read_text()
        assert "Traceback" not in said
        assert code in (0, DEVICE, SAFETY), said
        if code == 0:
            assert summary(files)["outcome"] == "in_tolerance"
        else:
            assert device in said
        if events(files, "tool_landed"):
            require_off_the_part(files)
        require_nothing_twice(files)


@pytest.mark.parametrize("when", [{"at_s": 0.0}, {"contact_s": 0.7}], ids=["from the start", "in contact"])
def test_a_spindle_that_turns_the_wrong_way_round_does_not_polish(tmp_path: Path, when: Fault) -> None:
    """The encoder measures the fault: the speed is not reached before landing, and is wrong in contact."""
    reverse = {"device": "spindle", "what": "reverse", **when}
    with faulty_cell(tmp_path / "cell", reverse, speed=10.0) as files:
        with Daemon(files, "--no-hold") as daemon:
            code, said = daemon.wait(), daemon.output.read_text()
        if "at_s" in when:
            assert (code, events(files, "tool_landed")) == (DEVICE, []), said
            assert re.search(r"1000 rpm not reached, -(999|1000)(\.\d)? rpm", said)
        else:
            assert code == SAFETY, said
            assert re.search(r"spindle at -(999|1000)(\.\d)? rpm instead of 1000", said)
            require_off_the_part(files)


def test_a_force_that_sticks_is_a_safety_stop_and_a_person_decides(tmp_path: Path) -> None:
    sticks = {"device": "actuator", "what": "stick", "contact_s": 1.5}
    with faulty_cell(tmp_path / "cell", sticks, seed=4, speed=20.0) as files:
        with Daemon(files) as daemon:
            assert daemon.wait() == SAFETY, daemon.output.read_text()
            said = daemon.output.read_text()
        assert "force" in said
        assert "outside" in said
        require_off_the_part(files)
        require_nothing_twice(files)
        landed, off = events(files, "tool_landed")[-1], events(files, "force_zero")[-1]
        # stuck for the grace time, and then acted upon
        assert 0.2 < off["mono_s"] - landed["mono_s"] - 1.5 < 2.0
        assert summary(files)["outcome"] != "in_tolerance"
        answer = json.loads(polishd("status", files.cell, "--json").stdout)
        assert (answer["state"], answer["exit_code"], answer["tool_off"]) == ("failed", SAFETY, "yes")
        assert answer["run_dir"] == str(files.run_dir)
        before = len(events(files))
        with Daemon(files) as daemon:
            assert daemon.wait_for_state("held")["reason"]
            assert daemon.end() != 0
        moved = [e for e in events(files)[before:] if e["event"] in ("motion_started", "engage", "force_on")]
        assert not moved, "nothing starts without a command after a safety stop"
    # the cell is switched off meanwhile: one more cause, and the first one stays
    assert polishd("run", files.cell).returncode == DEVICE
    assert [cause["kind"] for cause in summary(files)["causes"]] == ["SafetyStop", "LinkError"]
    assert "force" in json.loads(polishd("status", files.cell, "--json").stdout)["causes"][0]["error"]
    (torn,) = summary(files)["cycles"]
    assert torn["how"] == "interrupted"
