"""A controller's variables in a recording: what was read and written, and how the link was lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.api import LinkError
from polishd.drivers.handover.recorded import Recorded
from polishd.model.errors import ConfigError
from polishd.ports.tap import Passed, heard_by, talking_to
from polishd.ports.wire_file import header_line, passed_line, read_recording
from polishd.testing.replay import replayed
from tests.fakes.handover import Direct, FakePlc

LINK = "opc.tcp://plc:4840"


async def test_values_are_recorded_and_read_again(tmp_path: Path) -> None:
    fake, heard = FakePlc(tmp_path), list[Passed]()
    with heard_by(heard.append), talking_to("robot"):
        link = Recorded(Direct(fake), LINK)
        await link.open()
        read = (await link.read()).values
        await link.write({"hold": False, "heartbeat": 41})
        fake.dead = True
        with pytest.raises(LinkError):
            await link.read()
        await link.close()
    assert [one.way for one in heard] == ["open", "in", "out", "end"], "an end is told once"
    assert heard[-1].why
    path = tmp_path / "case.jsonl"
    path.write_bytes(header_line("0", "cell", "", {}) + b"".join(passed_line(one, heard[0].at_s) for one in heard))
    found = read_recording(path)
    assert [one.values for one in found.passed] == [None, read, {"hold": False, "heartbeat": 41}, None]
    assert {(one.role, one.link) for one in found.passed} == {("robot", LINK)}
    with pytest.raises(ConfigError, match="robot is recorded as values of variables; only bytes and frames are played"):
        async with replayed(path, "robot"):
            pass
