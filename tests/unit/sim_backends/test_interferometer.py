"""The simulated instrument: what it writes, in which order, and how its files come into being.

What the simulated interferometer adds: each error alone, on a part that is flat or has a known form.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polishd.config.fields import BumpSection
from polishd.config.simulator import SimConfig
from polishd.config.simulator_devices import Artefact, MapFaults, SimInterferometerSection
from polishd.config.simulator_devices import SimInterferometerSection as Section
from polishd.config.simulator_faults import FaultSection
from polishd.config.simulator_physics import InstrumentErrors, Truth
from polishd.model.surface import FloatArray, Grid
from polishd.process.metrology import zernike
from polishd.sim_backends.common import metropro
from polishd.sim_backends.common.faults import FaultScript
from polishd.sim_backends.common.wire import SimWire
from polishd.sim_backends.interferometer import (
    SimInterferometer,
    add_imaging_errors,
    add_instrument_errors,
    write_artefact,
)
from tests.time_limits import SOON_S

TRUE = np.where(np.hypot(*np.mgrid[-8:9, -8:9]) < 8.5, 10.0 * np.mgrid[-8:9, -8:9][0], np.nan)


class Link:
    """The plant, as the instrument sees it."""

    def __init__(self) -> None:
        self.events: list[tuple[str, dict[str, Any]]] = []
        self.requested = asyncio.Event()

    def event(self, name: str, **data: Any) -> None:
        """Keep it."""
        self.events.append((name, data))

    def send_message(self, **_message: Any) -> None:
        """Request a measurement."""
        self.requested.set()


def instrument(folder: Path, *, faults: MapFaults | None = None, **section: Any) -> SimInterferometer:
    config = SimConfig(
        hidden_truth=Truth(map_noise_nm=0.5),
        interferometer=Section(write_s=section.pop("write_s", 0.0), faults=faults or MapFaults(), **section),
    )
    runtime: Any = SimpleNamespace(start=SimpleNamespace(config=config), link=Link())
    return SimInterferometer(runtime, folder, np.random.default_rng(1))


def files(folder: Path) -> list[Path]:
    """Maps in the order of their numbers."""
    return sorted(folder.glob("*.dat"), key=lambda path: path.stem.rsplit("-", 1)[1])


def sizes_of(folder: Path, end: str) -> list[int]:
    """Sizes of the files there whose names end so."""
    return [path.stat().st_size for path in folder.iterdir() if path.name.endswith(end)]


async def until(condition: Callable[[], object]) -> None:
    """Wait until it is so."""
    async with asyncio.timeout(SOON_S):
        while not condition():  # noqa: ASYNC110 -- no event exists
            await asyncio.sleep(0.005)


async def test_a_map_is_the_truth_with_noise_and_a_piston(tmp_path: Path) -> None:
    await instrument(tmp_path).drop(TRUE)
    (path,) = files(tmp_path)
    found = metropro.read(path)
    assert (found.part, found.pitch_mm) == ("DEMO-100", pytest.approx(0.5))
    np.testing.assert_array_equal(np.isnan(found.height_nm), np.isnan(TRUE))
    error = (found.height_nm - TRUE)[np.isfinite(TRUE)]
    assert error.std() == pytest.approx(0.5, rel=0.25)
    assert 0.0 < abs(error.mean()) <= 200.5


async def test_two_maps_of_one_surface_differ(tmp_path: Path) -> None:
    one = instrument(tmp_path)
    await one.drop(TRUE)
    await one.drop(TRUE)
    first, second = files(tmp_path)
    assert first.read_bytes() != second.read_bytes()


async def test_nasty_files_come_first_and_the_right_one_last(tmp_path: Path) -> None:
    faulty = instrument(tmp_path, faults=MapFaults(wrong_part_first=True, duplicate_first=True, preallocate=True))
    await faulty.drop(TRUE)
    await faulty.drop(TRUE + 1.0)
    found = files(tmp_path)
    assert [path.name.split("-")[0] for path in found] == ["wrong", "map", "wrong", "again", "map"]
    assert [metropro.read(path).part for path in found] == ["OTHER-7", "DEMO-100", "OTHER-7", "DEMO-100", "DEMO-100"]
    assert found[1].read_bytes() == found[3].read_bytes(), "the last map, again under a new name"
    np.testing.assert_allclose(
        metropro.read(found[0]).height_nm, -metropro.read(found[1]).height_nm, atol=metropro.UNIT_NM
    )
    link: Any = faulty.runtime.link
    assert [data["file"] for name, data in link.events if name == "map_dropped"] == [found[1].name, found[4].name]


@pytest.mark.one_of_each
@pytest.mark.parametrize("preallocate", [False, True])
@pytest.mark.parametrize("suffix", [".part", ""])
async def test_a_file_grows_or_fills_under_the_name_that_is_configured(
    tmp_path: Path, preallocate: bool, suffix: str
) -> None:
    slow = instrument(tmp_path, faults=MapFaults(preallocate=preallocate), temporary_suffix=suffix, write_s=0.4)
    data = metropro.pack(metropro.DatMap(TRUE, 0.5))
    writing = asyncio.create_task(slow.write("map", data))
    sizes: list[int] = []
    while not writing.done():
        await asyncio.sleep(0.005)
        sizes += sizes_of(tmp_path, ".dat" + suffix)
    (path,) = files(tmp_path)
    assert path.name == writing.result()
    assert path.read_bytes() == data
    assert sizes == sorted(sizes)
    if preallocate:
        assert set(sizes) <= {0, len(data)}
    else:
        assert len(set(sizes)) > 3, "an early reader sees an incomplete file"


async def test_one_request_one_map(tmp_path: Path) -> None:
    device = instrument(tmp_path)
    link: Any = device.runtime.link
    running = asyncio.create_task(device.run())
    request = tmp_path / "measure.request"
    for count in (1, 2):
        link.requested.clear()
        request.write_text("{}")
        await asyncio.wait_for(link.requested.wait(), SOON_S)
        assert not request.exists()
        assert len(files(tmp_path)) == count - 1, "the plant has not given the surface yet"
        device.maps.put_nowait(TRUE)
        await until(lambda count=count: len(files(tmp_path)) == count)
    running.cancel()
    await asyncio.wait({running})
    assert [name for name, _ in link.events].count("map_requested") == 2


# the wire that devices hang on


class Loopback:
    """A runtime that serves on a free port and remembers its tasks."""

    def __init__(self, tmp_path: Path, group: asyncio.TaskGroup) -> None:
        self.name, self.group = "actuator", group
        self.start = SimpleNamespace(seed=3, state=tmp_path, config=SimConfig())
        self.server: asyncio.Server | None = None
        self.link = Link()
        self.script = FaultScript(self.name, 3, self.link.event)

    async def serve(self, protocol: Any, port: int) -> int:
        """Listen."""
        self.server = await asyncio.get_running_loop().create_server(protocol, "127.0.0.1", port)
        return int(self.server.sockets[0].getsockname()[1])


async def test_every_connection_has_its_own_receiver(tmp_path: Path) -> None:
    receivers: Iterator[int] = iter(range(10))

    def feed(outlet: Any) -> Any:
        number = next(receivers)
        return lambda data: outlet.send(b"%d:%b" % (number, data))

    async with asyncio.TaskGroup() as group:
        runtime: Any = Loopback(tmp_path, group)
        wire = SimWire(runtime, feed)
        host, port = (await wire.open_tcp(0, b"hello ")).split(":")
        lines = [await asyncio.open_connection(host, int(port)) for _ in range(2)]
        for number, (reader, writer) in enumerate(lines):
            assert await asyncio.wait_for(reader.readexactly(6), SOON_S) == b"hello "
            writer.write(b"abc")
            assert await asyncio.wait_for(reader.readexactly(5), SOON_S) == b"%d:abc" % number
        for _, writer in lines:
            writer.close()
        await until(lambda: not wire.cuts)
        runtime.server.close()


async def test_an_unplugged_link_refuses_connections(tmp_path: Path) -> None:
    async with asyncio.TaskGroup() as group:
        runtime: Any = Loopback(tmp_path, group)
        wire = SimWire(runtime, lambda outlet: outlet.send)
        host, port = (await wire.open_tcp(0)).split(":")
        before = await asyncio.open_connection(host, int(port))
        await until(lambda: wire.cuts)
        unplug = FaultSection(device="actuator", what="unplug", at_s=1.0, duration_s=2.0)
        runtime.script.set([unplug], now_s=0.0)
        runtime.script.look(1.0)
        during = await asyncio.open_connection(host, int(port))
        for reader, writer in (before, during):
            with contextlib.suppress(ConnectionError):
                assert await asyncio.wait_for(reader.read(), SOON_S) == b""
            writer.close()
        await until(lambda: not wire.cuts)
        runtime.script.look(3.0)
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(b"abc")
        assert await asyncio.wait_for(reader.readexactly(3), SOON_S) == b"abc"
        writer.close()
        runtime.server.close()
    assert [name for name, _ in runtime.link.events] == ["fault_begins", "wire_cut", "fault_ends"]


# the artefact, and an instrument that is not as its profile says


def test_an_instrument_mirrors_first_and_turns_then() -> None:
    height = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert add_imaging_errors(height, MapFaults()).tolist() == height.tolist()
    assert add_imaging_errors(height, MapFaults(mirror=True)).tolist() == [[2.0, 1.0], [4.0, 3.0]]
    assert add_imaging_errors(height, MapFaults(mirror=True, rotation_deg=90)).tolist() == [[1.0, 3.0], [2.0, 4.0]]
    assert add_imaging_errors(height, MapFaults(sign=-1, factor=2.0)).tolist() == [[-2.0, -4.0], [-6.0, -8.0]]


def test_the_artefact_has_its_bump_where_it_says(tmp_path: Path) -> None:
    bump = BumpSection(x_mm=5.0, y_mm=8.0, sigma_x_mm=3.0, sigma_y_mm=1.5, height_nm=100.0)
    section = Section(artefact=Artefact(diameter_mm=40.0, bumps=(bump,)))
    config = SimConfig(hidden_truth=Truth(map_noise_nm=0.0), interferometer=section)
    write_artefact(config, tmp_path / "a.dat", np.random.default_rng(1))
    found = metropro.read(tmp_path / "a.dat")
    row, column = np.unravel_index(int(np.nanargmax(found.height_nm)), found.height_nm.shape)
    middle = (found.height_nm.shape[0] - 1) / 2
    assert ((column - middle) * found.pitch_mm, (middle - row) * found.pitch_mm) == pytest.approx((5.0, 8.0))
    assert np.nanmax(found.height_nm) == pytest.approx(100.0, abs=0.01)
    assert found.height_nm[row, column + 6] == pytest.approx(100.0 * np.exp(-0.5), abs=0.1)
    assert np.isnan(found.height_nm[0, 0])
    assert found.part == "ARTEFACT"


GRID = Grid(81, 81, 0.5)
DISC = GRID.radius_mm() <= 20.0
X, Y = (np.broadcast_to(a / 20.25, GRID.shape) for a in GRID.axes_mm)


def seen(true_nm: FloatArray | float = 0.0, *, quarters: int = 0, noise_nm: float = 0.0, **errors: Any) -> FloatArray:
    section = SimInterferometerSection(errors=InstrumentErrors(**errors))
    config = SimConfig(hidden_truth=Truth(map_noise_nm=noise_nm), interferometer=section)
    part = np.where(DISC, true_nm, np.nan)
    return add_instrument_errors(part, config, GRID.pitch_mm, np.random.default_rng(1), quarters=quarters)


def rms(values: FloatArray) -> float:
    return float(np.nanstd(values))


def test_a_perfect_one_shows_the_part() -> None:
    true = np.where(DISC, np.random.default_rng(0).normal(size=GRID.shape), np.nan)
    np.testing.assert_array_equal(seen(true), true)
    np.testing.assert_array_equal(seen(true, quarters=1), np.rot90(true))


@pytest.mark.parametrize(
    ("errors", "noll"),
    [
        ({"power_nm": 5.0}, {4: 5.0}),
        ({"power_nm": -5.0}, {4: -5.0}),
        ({"astigmatism_nm": 3.0, "astigmatism_deg": 0.0}, {6: 3.0}),
        ({"astigmatism_nm": 3.0, "astigmatism_deg": 45.0}, {5: 3.0}),
        ({"coma_nm": 2.0}, {8: 2.0}),
        ({"mount_nm": 2.0}, {9: 2.0}),
    ],
)
def test_a_reference_has_the_errors_that_it_is_given(errors: dict[str, float], noll: dict[int, float]) -> None:
    """Against the controller's own Zernike terms, which the simulator does not have."""
    pairs = zernike.order("noll", 11)
    terms = zernike.values(pairs, "rms", X[DISC], Y[DISC]).T
    found = np.linalg.lstsq(terms, seen(**errors)[DISC], rcond=None)[0]
    want = np.zeros(11)
    for term, size in noll.items():
        want[term - 1] = size
    np.testing.assert_allclose(found, want, atol=0.02)


@pytest.mark.parametrize("turns", [True, False])
def test_a_mount_turns_with_the_part_or_does_not(turns: bool) -> None:
    still, turned = (seen(mount_nm=2.0, mount_turns=turns, quarters=q) for q in (0, 1))
    want = np.rot90(still) if turns else still
    np.testing.assert_allclose(turned[DISC], want[DISC], atol=1e-9)
    assert rms(np.rot90(still) - still) > 2.0


@pytest.mark.full
def test_a_mount_that_presses_anew_is_a_trefoil_of_another_size_and_direction_in_each_map() -> None:
    section = SimInterferometerSection(errors=InstrumentErrors(mount_nm=2.0, mount_anew=True))
    config, rng = SimConfig(hidden_truth=Truth(map_noise_nm=0.0), interferometer=section), np.random.default_rng(3)
    terms = zernike.values(zernike.order("noll", 11), "rms", X[DISC], Y[DISC]).T
    part = np.where(DISC, 0.0, np.nan)
    maps = [add_instrument_errors(part, config, 0.5, rng)[DISC] for _ in range(300)]
    found = np.linalg.lstsq(terms, np.column_stack(maps), rcond=None)[0]
    trefoil = found[[8, 9]]
    assert abs(np.delete(found, [8, 9], axis=0)).max() < 0.03, "nothing else"
    assert np.sqrt((trefoil**2).sum(axis=0).mean()) == pytest.approx(2.0, rel=0.1)
    assert abs(np.corrcoef(trefoil)[0, 1]) < 0.15, "any direction"
    assert trefoil.std(axis=1) == pytest.approx(2.0 / np.sqrt(2.0), rel=0.15)


def test_tilt_is_another_with_each_map() -> None:
    section = SimInterferometerSection(errors=InstrumentErrors(tilt_nm=50.0))
    config, rng = SimConfig(hidden_truth=Truth(map_noise_nm=0.0), interferometer=section), np.random.default_rng(3)
    first, second = (add_instrument_errors(np.zeros(GRID.shape), config, 0.5, rng) for _ in range(2))
    for one in (first, second):
        plane = np.linalg.lstsq(np.column_stack([X.ravel(), Y.ravel()]), one.ravel(), rcond=None)[0]
        np.testing.assert_allclose(one.ravel(), plane @ [X.ravel(), Y.ravel()], atol=1e-9)
        assert 0 < abs(plane).max() <= 100.0
    assert rms(first - second) > 1.0


@pytest.mark.parametrize(("errors", "at_rim"), [({"magnification": 0.05}, 1.05), ({"distortion": 0.05}, 1.037)])
def test_what_is_magnified_lies_farther_out(errors: dict[str, float], at_rim: float) -> None:
    x, y = GRID.axes_mm
    bump = 10.0 * np.exp(-((x - 15.0) ** 2 + y**2) / 8.0)
    found = np.nan_to_num(seen(bump, **errors))
    centre = (found * x).sum() / found.sum()
    true = np.where(DISC, bump, 0.0)
    assert centre / ((true * x).sum() / true.sum()) == pytest.approx(at_rim, abs=0.012)


def test_slopes_add_what_they_should() -> None:
    slope = 4.0 * np.broadcast_to(GRID.axes_mm[0], GRID.shape)  # 4 nm/mm: 4 urad
    level = seen(slope, retrace_nm_per_urad=0.5) - np.where(DISC, slope, np.nan)
    inner = GRID.radius_mm() < 18.0
    np.testing.assert_allclose(level[inner], 2.0, atol=1e-9)
    noise = seen(slope, slope_noise_nm_per_urad=0.1) - np.where(DISC, slope, np.nan)
    assert noise[inner].std() == pytest.approx(0.4, rel=0.1)
    assert rms(seen(0.0, slope_noise_nm_per_urad=0.1)) == 0.0, "a flat has none"


def test_dead_pixels_are_the_camera_s() -> None:
    first, turned = (np.isnan(seen(dead_pixels=0.02, quarters=q))[DISC] for q in (0, 1))
    assert first.mean() == pytest.approx(0.02, abs=0.008)
    np.testing.assert_array_equal(first, turned)
