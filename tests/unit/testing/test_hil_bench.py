"""A real cell under the suites: its description, and its limits."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from polishd.config.cell import load_config
from polishd.model.errors import ConfigError
from polishd.testing.hil_bench import HilRequest, Level, foreseen, simulated_devices, words

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
PRESSES = {"level": Level.CONTACT, "max_force_n": 5.0}


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    return Path(shutil.copy(EXAMPLES / "cell.toml", tmp_path))


def said(cell: Path, **asked: Any) -> dict[str, str]:
    """What happens to each device."""
    return {name: happens for name, _, happens in foreseen(HilRequest(cell=cell, **asked)).does()}


def test_to_identify_nothing_moves_but_to_safety(cell: Path) -> None:
    found = said(cell)
    assert list(found) == ["actuator", "robot", "spindle", "metrology"]
    assert not any(word in text for text in found.values() for word in ("MOVES", "TURNS", "PRESSES", "POLISHED"))
    assert "takes the force off and lifts" in found["actuator"]


@pytest.mark.full
def test_each_level_says_what_it_adds(cell: Path, tmp_path: Path) -> None:
    motion = tmp_path / "air.nc"
    motion.write_text("G1 X1\n\nG1 X0\n")
    found = said(cell, level=Level.NO_CONTACT, motion=motion)
    assert "TURNS with up to 1000 rpm" in found["spindle"]
    assert f"MOVES along {motion}" in found["robot"]
    assert "PRESSES" not in found["actuator"]
    assert "PRESSES with up to 5 N" in said(cell, **PRESSES)["actuator"]
    assert "POLISHED along program.rnc with 12 N" in said(cell, level=Level.CYCLE, max_force_n=50.0)["all of them"]


@pytest.mark.full
def test_a_robot_moves_only_with_a_confirmation(cell: Path, tmp_path: Path) -> None:
    assert "does not move: no --motion" in said(cell, **PRESSES)["robot"]
    assert foreseen(HilRequest(cell=cell, **PRESSES)).scope().block is None
    motion = tmp_path / "air.nc"
    motion.write_text("G1 X1\r\n\nG1 X0")
    block = foreseen(HilRequest(cell=cell, motion=motion)).scope().block
    assert block is not None
    assert [block(at) for at in range(4)] == [b"G1 X1", b"G1 X0", b"G1 X1", b"G1 X0"]


def test_simulated_devices_are_distinguished_from_real_ones(cell: Path) -> None:
    lines = words(foreseen(HilRequest(cell=cell, simulate=("spindle",))))
    assert any(line.startswith("spindle (simulated, in place of cia402_spindle") for line in lines)
    assert any(line.startswith("actuator (REAL, voice_coil_modbus serial:sim/actuator") for line in lines)


@pytest.mark.parametrize(
    ("asked", "problem"),
    [
        ({"level": Level.CONTACT}, "need --max-force NEWTONS"),
        ({"level": Level.CONTACT, "max_force_n": float("nan")}, "greater than 0"),
        ({"simulate": ("robto",)}, "--simulate robto: the cell has actuator, robot"),
        (
            {"simulate": ("metrology",)},
            "only 'actuator', 'force_sensor', 'loader', 'monitor'",
        ),
        ({"simulate": ("robot", "robot")}, "one device of a port"),
    ],
)
def test_what_cannot_be_tried_is_said_before(cell: Path, asked: dict[str, Any], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        foreseen(HilRequest(cell=cell, **asked))


@pytest.mark.parametrize("text", [None, "\n \n"])
def test_a_motion_without_blocks_is_said_before(cell: Path, tmp_path: Path, text: str | None) -> None:
    motion = tmp_path / "air.nc"
    if text is not None:
        motion.write_text(text)
    with pytest.raises(ConfigError, match=r"--motion .*air\.nc: (cannot be read: |the program has no blocks)"):
        said(cell, motion=motion)


@pytest.mark.full
@pytest.mark.parametrize(
    ("mark", "least"),
    [("polishd_moves", Level.NO_CONTACT), ("polishd_presses", Level.CONTACT), ("polishd_cycles", Level.CYCLE)],
)
def test_no_level_goes_too_far(cell: Path, mark: str, least: Level) -> None:
    for level in Level:
        bench = foreseen(HilRequest(cell=cell, level=level, max_force_n=5.0))
        assert bench.allows({mark, "asyncio"}) == (level >= least)
        assert bench.allows({"asyncio"})
        for never in ("polishd_cuts", "polishd_mutes", "polishd_fresh"):
            assert not bench.allows({never})


def test_of_a_cell_what_acts_is_tried_and_never_harder_than_allowed(cell: Path) -> None:
    bench = foreseen(HilRequest(cell=cell, **PRESSES))
    assert [case.__name__ for case in bench.cases("any_device")] == ["actuator", "robot", "spindle"]
    (case,) = bench.cases("actuator")
    assert case.scope.force_n == 5.0
    assert case.scope.most_n is None
    assert foreseen(HilRequest(cell=cell, level=Level.CONTACT, max_force_n=50.0)).scope().force_n == 12.0


def test_without_simulated_devices_nothing_is_overridden(cell: Path, tmp_path: Path) -> None:
    with simulated_devices(load_config(cell), (), tmp_path) as laid_over:
        assert laid_over == {}
