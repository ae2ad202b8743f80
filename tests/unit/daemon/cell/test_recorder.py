"""The recorder's bounds: what is dropped is counted, a full file says so, and each device's links are its own."""

from __future__ import annotations

import asyncio
import gzip
import logging
import os
import random
import resource
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from polishd.config.cell import CellConfig
from polishd.daemon.cell import recorder
from polishd.daemon.cell.recorder import place, recording_to
from polishd.model.errors import ConfigError
from polishd.util.wire_recording import LinkTap, read_recording, record_sent, tap

CELL = cast(
    CellConfig,
    SimpleNamespace(
        path=Path("left.toml"),
        cell=SimpleNamespace(name="left"),
        devices={"robot": SimpleNamespace(type="acme", address="tcp://h:1", password="opened sesame")},
    ),
)


def tapped(link: str) -> LinkTap:
    found = tap(link)
    assert found is not None
    return found


@pytest.mark.parametrize("packed", [True, False])
def test_a_recording_is_read_from_a_pipe_too(tmp_path: Path, packed: bool) -> None:
    with recording_to(tmp_path / "a.jsonl.gz", CELL):
        pass
    content = (tmp_path / "a.jsonl.gz").read_bytes()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_bytes, args=(content if packed else gzip.decompress(content),))
    writer.start()
    found = read_recording(pipe)
    writer.join()
    assert found.header["cell"] == "left"
    assert not found.notes


def test_no_recorder_runs() -> None:
    assert tap("tcp://h:1") is None


def test_a_password_stays_in_the_config(tmp_path: Path) -> None:
    with recording_to(tmp_path / "a.jsonl.gz", CELL):
        pass
    header = read_recording(tmp_path / "a.jsonl.gz").header
    assert header["devices"] == {"robot": {"type": "acme", "link": "tcp"}}
    assert "sesame" not in str(header)


async def test_a_link_is_of_the_device_that_the_cell_talks_to(tmp_path: Path) -> None:
    """Also one that is opened by a task which that device has started, while the cell talks to another."""
    again, path = asyncio.Event(), tmp_path / "a.jsonl.gz"

    async def reconnects() -> None:
        await again.wait()
        tapped("tcp://h:1")("out", b"again")

    with recording_to(path, CELL):
        with record_sent("robot"):
            task = asyncio.create_task(reconnects())
        with record_sent("spindle"):
            tapped("slcan:x")("in", b"\x05", 0x705)
            again.set()
            await task
    found = read_recording(path)
    assert [(one.role, one.way, one.data) for one in found.passed] == [
        ("spindle", "open", b""),
        ("spindle", "in", b"\x05"),
        ("robot", "open", b""),
        ("robot", "out", b"again"),
    ]
    assert found.passed[1].identifier == 0x705


def test_a_full_file_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.jsonl.gz"
    with caplog.at_level(logging.WARNING), recording_to(path, CELL, limit=20_000):
        link = tapped("tcp://h:1")
        for _ in range(200):
            link("in", random.randbytes(4096))
    found = read_recording(path)
    assert 0 < len(found.passed) < 200
    assert found.notes[-1].endswith("it is full: nothing more was recorded")
    assert f"{path}: reached its limit of 20000 bytes" in caplog.text


def test_what_the_disk_cannot_take_is_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "LONGEST", 10)
    line, held = recorder.passed_line, recorder.threading.Event()

    def slow(*given: Any) -> bytes:
        held.wait()
        return line(*given)

    monkeypatch.setattr(recorder, "passed_line", slow)
    path = tmp_path / "a.jsonl.gz"
    with caplog.at_level(logging.WARNING), recording_to(path, CELL):
        link = tapped("tcp://h:1")
        for number in range(50):
            link("in", bytes([number]))
        held.set()
    found = read_recording(path)
    (note,) = found.notes
    lost = int(note.split(": ")[1].split()[0])
    assert lost + len(found.passed) == 51, "each is there, or counted"
    assert lost >= 39
    assert f"{lost} records were dropped" in caplog.text


def test_a_disk_that_fails_ends_the_recording_and_nothing_else(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, (soft, hard) = tmp_path / "a.jsonl.gz", resource.getrlimit(resource.RLIMIT_FSIZE)
    with caplog.at_level(logging.ERROR), recording_to(path, CELL):
        link = tapped("tcp://h:1")
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
        try:
            while not caplog.records:
                link("in", random.randbytes(4096))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        link("in", b"goes on")
    assert f"{path}: File too large: the recording ends here" in caplog.text


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    there = tmp_path / "there"
    there.write_text("precious")
    with pytest.raises(ConfigError, match=f"--record {there}: exists already. Name another file or a folder"):
        place(there, CELL)
    first = place(tmp_path, CELL)
    assert first.name.startswith("left-")
    first.touch()
    assert place(tmp_path, CELL) != first, "two cells of one name, in one second"
    with (
        pytest.raises(ConfigError, match=r"--record .*: No such file or directory"),
        recording_to(tmp_path / "no" / "a.gz", CELL),
    ):
        pass
