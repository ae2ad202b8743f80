"""Every command that reads a map, and gets a cell or a profile, reads it by that instrument's profile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from polishd.cli.app import app
from polishd.commissioning.rehearsal.simulated_cell import with_values
from polishd.config.instrument_profile import load_profile, write_system
from polishd.maps.convert import store
from polishd.maps.map_files import MapSource
from polishd.model.instrument import SystemErrorRecord
from polishd.model.surface import FloatArray, MapStep, SurfaceMap
from polishd.process.metrology.absolute_test import AbsoluteTestResult
from polishd.process.metrology.statistics import remove_terms
from tests.commissioned import commissioned
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import PITCH_MM, dat, surface

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "cell.toml"
FACTOR = 0.5
RAW, BASE = surface(), surface(seed=8) * 0.4
RAW_X, RAW_Y = np.meshgrid(np.linspace(-1, 1, RAW.shape[1]), np.linspace(1, -1, RAW.shape[0]))
SYSTEM = np.where(np.isfinite(RAW), 9 * RAW_X**2 + 4 * RAW_X * RAW_Y, np.nan)[:, ::-1]
LINES = {"tolerance": [{"figure": "rms", "limit": 1.0}]}


def seen(raw: FloatArray, *, system: bool = True) -> FloatArray:
    """What the part is, by the profile."""
    lying: FloatArray = FACTOR * raw[:, ::-1] - (SYSTEM if system else 0.0)
    return lying


def rms(height: FloatArray) -> float:
    return float(height[np.isfinite(height)].std())


class Desk:
    """A cell whose instrument mirrors, says wavefronts, and has an error; and the command line."""

    def __init__(self, polishd: Polishd, folder: Path) -> None:
        self.run, self.folder = polishd, folder
        self.profile = commissioned(folder, orientation={"mirror": True}, height={"factor": FACTOR})
        self.cell = folder / "cell.toml"
        self.cell.write_text(with_values(EXAMPLE.read_text(), {"instrument": {"profile": "instrument.toml"}}))
        self.raw, self.base = dat(folder / "raw.dat", RAW), dat(folder / "base.dat", BASE)
        self._write_system()

    def _write_system(self) -> None:
        profile = load_profile(self.profile)
        source = MapSource.of(None, self.profile)
        one = source.read(self.raw)
        shown = AbsoluteTestResult(4, ((0, 0),), np.eye(1), {}, 0.0, (29.5, 23.5, 30.0))
        options = {"profile": profile.instrument.name, "result": "instrument", "terms": shown.facts()}
        system = replace(one, height_nm=SYSTEM, history=MapStep("absolute", "0", options, ()))
        sha256 = store(system, self.folder / "system.x3p", source)["sha256"]
        at = datetime(2026, 5, 5, tzinfo=UTC)
        write_system(self.profile, SystemErrorRecord("system.x3p", at, sha256, profile.sha256))

    def read(self, path: Path) -> SurfaceMap:
        """As it was written."""
        return MapSource.of().read(path)


@pytest.fixture(params=["--cell", "--profile"])
def by(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def desk(polishd: Polishd, tmp_path: Path) -> Desk:
    return Desk(polishd, tmp_path)


def option(desk: Desk, by: str) -> tuple[str, Path]:
    return by, desk.cell if by == "--cell" else desk.profile


def figures(desk: Desk, *how: Any) -> None:
    answer = desk.run("map", desk.raw, "--json", *how).answer
    assert answer["rms_nm"] == pytest.approx(rms(seen(RAW)), rel=1e-3)


def compare(desk: Desk, *how: Any) -> None:
    answer = desk.run("map", "compare", desk.raw, desk.base, "--json", *how).answer
    assert answer["before"]["rms_nm"] == pytest.approx(rms(seen(RAW)), rel=1e-3)
    assert answer["after"]["rms_nm"] == pytest.approx(rms(seen(BASE)), rel=1e-3)


def report(desk: Desk, *how: Any) -> None:
    out = desk.folder / "r.html"
    answer = desk.run("map", "report", desk.raw, "--out", out, "--json", *how).answer
    assert answer["rms_nm"] == pytest.approx(rms(seen(RAW)), rel=1e-3)


def convert(desk: Desk, *how: Any) -> None:
    out = desk.folder / "c.x3p"
    assert desk.run("map", "convert", desk.raw, out, *how).code == 0
    np.testing.assert_allclose(desk.read(out).height_nm, seen(RAW), atol=0.02)
    again = desk.run("map", out, "--json", *how).answer
    assert again["rms_nm"] == pytest.approx(rms(seen(RAW)), rel=1e-3), "once: not again of what was made so"


def average(desk: Desk, *how: Any) -> None:
    repeats = [desk.raw, dat(desk.folder / "r2.dat", RAW + 1e-2), dat(desk.folder / "r3.dat", RAW - 1e-2)]
    out = desk.folder / "a.x3p"
    said = desk.run("map", "average", *repeats, "--out", out, *how)
    assert said.code == 0, said.err
    level = remove_terms(seen(RAW), np.isfinite(RAW[:, ::-1]), "tilt")
    np.testing.assert_allclose(desk.read(out).height_nm, level, atol=0.05)


def average_less_a_system(desk: Desk, *how: Any) -> None:
    """The instrument's error is taken off once where it is named besides."""
    repeats = [desk.raw, dat(desk.folder / "r2.dat", RAW + 1e-2), dat(desk.folder / "r3.dat", RAW - 1e-2)]
    out = desk.folder / "a.x3p"
    said = desk.run("map", "average", *repeats, "--system", desk.folder / "system.x3p", "--out", out, *how)
    assert said.code == 0, said.err
    level = remove_terms(seen(RAW), np.isfinite(RAW[:, ::-1]), "tilt")
    np.testing.assert_allclose(desk.read(out).height_nm, level, atol=0.05)


def subtract(desk: Desk, *how: Any) -> None:
    out = desk.folder / "s.x3p"
    assert desk.run("map", "subtract", desk.raw, desk.base, "--out", out, *how).code == 0
    np.testing.assert_allclose(desk.read(out).height_nm, FACTOR * (RAW - BASE)[:, ::-1], atol=0.05)


def subtract_the_system(desk: Desk, *how: Any) -> None:
    out = desk.folder / "s.x3p"
    assert desk.run("map", "subtract", desk.raw, desk.folder / "system.x3p", "--out", out, *how).code == 0
    np.testing.assert_allclose(desk.read(out).height_nm, seen(RAW), atol=0.05)


def stitch(desk: Desk, *how: Any) -> None:
    at, out = desk.folder / "at.csv", desk.folder / "st.x3p"
    moved = np.roll(RAW, 8, axis=1)
    moved[:, :8] = np.nan
    other = dat(desk.folder / "moved.dat", moved)
    at.write_text(f"file,x_mm,y_mm\nraw.dat,0,0\nmoved.dat,{8 * PITCH_MM},0\n")
    said = desk.run("map", "stitch", desk.raw, other, "--at", at, "--out", out, "--json", *how)
    assert said.code == 0, said.err
    found = desk.read(out)
    assert found.history is not None
    assert found.history.options["profile"] == load_profile(desk.profile).instrument.name
    assert "system" in found.history.options


def absolute(desk: Desk, *how: Any) -> None:
    """The profile, and not the system map: that is what is looked for."""
    turned = [desk.raw, *(dat(desk.folder / f"t{k}.dat", RAW) for k in range(3))]
    said = desk.run("map", "absolute", *turned, "--angles", "0,90,180,270", "--order", "4", "--json", *how)
    assert said.code == 0, said.err
    out = desk.folder / "i.x3p"
    assert desk.run(
        "map", "absolute", *turned, "--angles", "0,90,180,270", "--order", "4", "--out-instrument", out, *how
    ).code == 0  # fmt: skip
    found = desk.read(out)
    assert found.history is not None
    assert found.history.options["profile"] == load_profile(desk.profile).instrument.name
    assert "system" not in found.history.options


def tif(desk: Desk, *how: Any) -> None:
    """A volume off by 2, and a spot on the wrong side, were the answer."""
    spot = np.where(np.isfinite(RAW), 400 * np.exp(-((RAW_X - 0.3) ** 2 + (RAW_Y - 0.2) ** 2) / 0.02), np.nan)
    flat = np.nan_to_num(RAW) * 0.01 + 1.0
    full = [flat, flat - np.nan_to_num(spot)]
    before, after = (dat(desk.folder / f"{k}.dat", height, 0.2) for k, height in enumerate(full))
    system = load_profile(desk.profile)
    assert system.system is not None
    plain = desk.run("calibrate", "tif", before, after, "--seconds", "20", "--json").answer
    text = desk.profile.read_text()
    desk.profile.write_text(text[: text.index("[system]")])  # its frame is another
    shown = desk.run("calibrate", "tif", before, after, "--seconds", "20", "--json", *how).answer
    assert shown["volume_mm3_min"] == pytest.approx(FACTOR * plain["volume_mm3_min"], rel=0.02)
    assert shown["centroid_mm"][0] == pytest.approx(-plain["centroid_mm"][0], abs=0.05)
    assert shown["centroid_mm"][1] == pytest.approx(plain["centroid_mm"][1], abs=0.05)
    assert shown["read_by"]["profile"] == system.instrument.name
    desk.profile.write_text(text)
    assert desk.run("calibrate", "tif", before, after, "--seconds", "20", *how).code == 8, "the system map's frame"


VERBS: dict[str, tuple[Callable[..., None], ...]] = {
    "map figures": (figures,),
    "map compare": (compare,),
    "map report": (report,),
    "map convert": (convert,),
    "map average": (average, average_less_a_system),
    "map subtract": (subtract, subtract_the_system),
    "map stitch": (stitch,),
    "map absolute": (absolute,),
    "calibrate tif": (tif,),
}
ELSEWHERE = {
    "map commission": "proves the profile itself: test_commission",
    "map formats": "reads no map",
    "calibrate instrument": "makes the system map: calibration/test_instrument",
    "calibrate stiffness": "reads no map",
    "calibrate first-touch": "reads no map",
    "program make": "below: an aperture of a map",
    "program inspect": "reads no map",
    "program rewrite": "reads no map",
    "program verify": "reads no map",
}


@pytest.mark.one_of_each
@pytest.mark.parametrize("check", [one for some in VERBS.values() for one in some], ids=lambda one: one.__name__)
def test_the_profile_is_applied(desk: Desk, by: str, check: Callable[..., None]) -> None:
    check(desk, *option(desk, by))


def test_no_verb_is_forgotten() -> None:
    """Each that takes a cell or a profile, of the groups that read maps, is in one of the tables."""
    groups: Any = typer.main.get_command(app)
    found = set()
    for group in ("map", "calibrate", "program"):
        context = typer.Context(groups)
        command = groups.get_command(context, group)
        for name in command.list_commands(context):
            names = {parameter.name for parameter in command.get_command(context, name).params}
            if names & {"cell", "profile"}:
                found.add(f"{group} {name}")
    assert found <= set(VERBS) | set(ELSEWHERE), "give it a check above, or say where it is checked"
    assert set(VERBS) <= found


def test_an_aperture_of_a_map_is_turned_as_the_cell_does(desk: Desk) -> None:
    half = np.where(RAW_X < 0, 1.0, np.nan)
    mask = dat(desk.folder / "half.dat", half, 1.0)
    text = desk.profile.read_text()
    desk.profile.write_text(text[: text.index("[system]")])
    source = MapSource.of(desk.cell)
    x = source.read(mask).grid.x_mm
    columns = source.read(mask).valid.any(axis=0)
    assert x[columns].min() > 0, "mirrored"
    out = desk.folder / "p.rnc"
    said = desk.run(
        "program", "make", "raster", "--aperture", f"mask:{mask}", "--cell", desk.cell, "--out", out, "--json"
    )
    assert said.code in {0, 4, 9}, said.err
    if said.code == 0:
        assert said.answer
