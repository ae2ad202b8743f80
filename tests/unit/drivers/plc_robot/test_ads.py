"""Variables over ADS: pyads against the simulated PLC's own server, on a separate loopback address."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.api import LinkError, ProtocolError
from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.plc_robot.ads import Ads
from polishd.sim_backends.plc_robot.device import AMS_PORT, TCP_PORT, AdsServer
from tests.fakes.plc_robot import HOST, NETID, FakePlc, serving

PROFILE = load_controller_profile("plc-ads", Path())


def link(silence_s: float = 5.0, **changed: str) -> Ads:
    table = PROFILE.variables
    if changed:
        (name, address), *_ = changed.items()
        point = getattr(table, name).model_copy(update={"address": address})
        table = table.model_copy(update={name: point})
    return Ads(HOST, NETID, AMS_PORT, table, silence_s)


async def test_all_that_is_watched_comes_in_one_reading(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path)
    async with serving(fake, AdsServer, HOST, TCP_PORT):
        ads = link()
        await ads.open()
        fake.plc.shown |= {"line": 70_000, "state": 3, "in_motion": True, "clock": 12.5, "alarm_text": "Düse"}
        values = (await ads.read()).values
        assert {name: values[name] for name in ("line", "state", "in_motion", "clock", "session", "alarm_text")} == {
            "line": 70_000,
            "state": 3,
            "in_motion": True,
            "clock": 12.5,
            "session": "boot-1",
            "alarm_text": "Düse",
        }
        identity = await ads.identify()
        assert (identity.model, identity.serial) == ("polishd sim PLC", NETID)
        await ads.close()


async def test_orders_are_written_together(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path)
    async with serving(fake, AdsServer, HOST, TCP_PORT):
        ads = link()
        await ads.open()
        await ads.write({"hold": False, "start": True, "program": "a.nc", "heartbeat": 7})
        found = {name: fake.plc.inputs[name] for name in ("hold", "start", "program", "heartbeat")}
        assert found == {"hold": False, "start": True, "program": "a.nc", "heartbeat": 7}
        await ads.close()


async def test_a_symbol_that_is_not_there_is_named(tmp_path: Path) -> None:
    async with serving(FakePlc(tmp_path), AdsServer, HOST, TCP_PORT):
        with pytest.raises(ProtocolError, match="addresses in the profile"):
            await link(line="GVL_polishd.lines").open()


async def test_an_error_that_no_table_has_is_an_answer_that_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a garbled frame; its checksum is of what was sent."""
    fake = FakePlc(tmp_path)
    async with serving(fake, AdsServer, HOST, TCP_PORT):
        ads = link()
        await ads.open()
        monkeypatch.setattr(AdsServer, "_read", lambda *asked: (0x20000, bytes(asked[-1])))
        with pytest.raises(ProtocolError, match="invalid answer"):
            await ads.read()
        await ads.close()


async def test_a_missing_and_a_silent_server_are_lost_links(tmp_path: Path) -> None:
    with pytest.raises(LinkError):
        await link().open()
    fake = FakePlc(tmp_path)
    async with serving(fake, AdsServer, HOST, TCP_PORT):
        ads = link(silence_s=0.3)
        await ads.open()
        fake.silent = True
        with pytest.raises(LinkError):
            await ads.read()
        await ads.close()
        with pytest.raises(LinkError, match="is not open"):
            await ads.read()
