"""Mischief, pacing, the pseudo-terminal and the config."""

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.simulator import Faults, SimConfig, load_simulator
from polishd.model.errors import ConfigError
from polishd.sim_backends import bus
from polishd.sim_backends.faults import Mischief, Outlet
from polishd.sim_backends.wire import PtyPort
from tests.patience import SOON_S


def mischief(**faults: Any) -> Mischief:
    return Mischief(Faults(**faults), np.random.default_rng(1))


def test_no_faults_no_mischief() -> None:
    assert mischief().idle
    assert not mischief(drop_rate=0.1).idle
    assert mischief().treat(b"abc") == (0.0, b"abc")


def test_rates_are_kept() -> None:
    devil = mischief(drop_rate=0.2, garble_rate=0.1, late_rate=0.3, late_s=1.0)
    treated = [devil.treat(b"abcd") for _ in range(4000)]
    dropped = sum(frame == b"" for _, frame in treated)
    damaged = sum(frame not in {b"", b"abcd"} for _, frame in treated)
    assert dropped == pytest.approx(800, rel=0.15)
    assert damaged == pytest.approx(320, rel=0.2)
    assert sum(delay == 1.0 for delay, _ in treated) == pytest.approx(1200, rel=0.15)


def test_damage_is_one_bit() -> None:
    devil = mischief(garble_rate=1.0)
    for _ in range(100):
        _, frame = devil.treat(bytes(8))
        assert sum((byte).bit_count() for byte in frame) == 1


def test_the_same_seed_gives_the_same_mischief() -> None:
    one, two = (mischief(drop_rate=0.3, garble_rate=0.3, jitter_s=0.1) for _ in range(2))
    assert [one.treat(b"xyz") for _ in range(50)] == [two.treat(b"xyz") for _ in range(50)]


async def paced(outlet: Outlet, frames: list[bytes], written: list[bytes], expected: int) -> float:
    """Seconds until all has been written."""
    begin = time.monotonic()
    async with asyncio.timeout(SOON_S), asyncio.TaskGroup() as group:
        worker = group.create_task(outlet.run())
        for frame in frames:
            outlet.send(frame)
        while len(b"".join(written)) < expected:  # noqa: ASYNC110  (what is waited for knows no event)
            await asyncio.sleep(0.001)
        worker.cancel()
    return time.monotonic() - begin


async def test_bytes_take_the_time_of_the_line_and_stay_in_order() -> None:
    written: list[bytes] = []
    outlet = Outlet(written.append, mischief(), byte_s=10.0 / 9600)
    took = await paced(outlet, [b"a" * 50, b"b" * 50], written, 100)
    assert b"".join(written) == b"a" * 50 + b"b" * 50
    assert took >= 100 * 10.0 / 9600 * 0.98


async def test_late_frames_do_not_overtake() -> None:
    written: list[bytes] = []
    outlet = Outlet(written.append, mischief(jitter_s=0.01))
    frames = [bytes([k]) for k in range(20)]
    await paced(outlet, frames, written, 20)
    assert b"".join(written) == b"".join(frames)


async def test_a_terminal_behind_a_stable_name(tmp_path: Path) -> None:
    heard = asyncio.Queue()
    port = PtyPort(tmp_path / "line", heard.put_nowait)
    port.open()
    try:
        host = os.open(tmp_path / "line", os.O_RDWR | os.O_NOCTTY)
        os.write(host, b"\x01\r\n\x04")
        assert await asyncio.wait_for(heard.get(), SOON_S) == b"\x01\r\n\x04"
        port.write(b"\x03\r\xff")
        assert os.read(host, 10) == b"\x03\r\xff"
        os.close(host)
        for _ in range(50):
            port.write(b"x" * 1000)
        before = (tmp_path / "line").readlink()
        port.close()
        port.open()
        assert (tmp_path / "line").exists()
        assert before.is_absolute()
    finally:
        port.close()


async def test_bus_frames_round_trip() -> None:
    reader = asyncio.StreamReader()
    rows = np.arange(12.0).reshape(3, 4)
    reader.feed_data(bus.pack_json({"mark": 1.5}) + bus.pack_rows(rows) + bus.pack_json({"event": "x"}))
    reader.feed_eof()
    assert await bus.read_frame(reader) == {"mark": 1.5}
    got = await bus.read_frame(reader)
    assert np.array_equal(got, rows)
    assert await bus.read_frame(reader) == {"event": "x"}
    assert await bus.read_frame(reader) is None


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("[plant]\nsped = 1", "plant.sped"),
        ("[plant]\nspeed = 0", "plant.speed"),
        ("[robot.faults]\ndrop_rate = 2", "drop_rate"),
    ],
)
def test_a_wrong_key_or_value_is_named(tmp_path: Path, text: str | None, where: str) -> None:
    path = tmp_path / "sim.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=where):
        load_simulator(path)


def test_every_fault_of_the_file_is_told_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "sim.toml"
    path.write_text('[plant]\nspeed = "60"\nsede = 1\n[robot]\nx_mm = [1.0]\n')
    with pytest.raises(ConfigError) as caught:
        load_simulator(path)
    told = str(caught.value).replace(str(path), "S").splitlines()
    assert told[0] == "S:2: plant.speed: must be a number, not the string '60'; mend it"
    assert told[1].startswith("S:3: plant.sede: unknown key; did you mean 'seed'? Known here: 'aperture_mm', ")
    assert told[2] == "S:5: robot.x_mm: has too few entries: [1.0]; add the others"


@pytest.mark.parametrize("text", ["[plant", None])
def test_no_config(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "sim.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=r"sim\.toml"):
        load_simulator(path)


def test_an_empty_config_is_the_demo(tmp_path: Path) -> None:
    path = tmp_path / "sim.toml"
    path.write_text("")
    assert load_simulator(path).model_dump() == SimConfig().model_dump()
