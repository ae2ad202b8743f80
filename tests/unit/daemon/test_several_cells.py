"""Several cells in one daemon process: what is one's own, and what they share."""

from __future__ import annotations

import asyncio
import gc
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon import app
from polishd.daemon.app import CellRun, ShutdownRequest, run_cells
from polishd.daemon.cycle import short_collections
from polishd.daemon.journal.journal import Journal
from polishd.daemon.runtime.exit_record import locked
from polishd.daemon.runtime.process import SystemdNotifier
from polishd.model.errors import ConfigError, LinkError, SafetyStop
from polishd.model.program import Program
from tests.unit.daemon.test_app import CLOSED, SAFE, Site


class Sites:
    """Two sites, which ``run_cells`` distinguishes by their configs."""

    def __init__(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        journal = app._journal
        self.all = []
        for name in ("a", "b"):
            (tmp_path / name).mkdir()
            self.all.append(Site(tmp_path / name, monkeypatch))
        self.breaks: dict[int, Any] = {}

        def kept(config: Any, hooks: Any, program: Program) -> Journal:
            found = journal(config, hooks, program)
            bench = self.of(config).bench
            assert bench is not None
            bench.journal = found
            return found

        monkeypatch.setattr(app, "_journal", kept)
        monkeypatch.setattr(app, "build_cell", self.build)

    def of(self, config: Any) -> Site:
        return next(site for site in self.all if site.config is config)

    def build(self, config: Any, hooks: Any) -> Any:
        site = self.of(config)
        cell = site.build(config, hooks)
        if broken := self.breaks.get(self.all.index(site)):
            broken(site.bench)
        return cell

    async def run(self) -> list[Any]:
        return await run_cells([CellRun(site.config, site.hooks) for site in self.all])


@pytest.fixture
def sites(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Sites:
    return Sites(tmp_path, monkeypatch)


def logged(site: Site) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (site.config.state_dir / "polishd.log").read_text().splitlines()]


@pytest.mark.full
async def test_each_cell_has_a_job_of_its_own(sites: Sites) -> None:
    ended = await sites.run()
    for site, found in zip(sites.all, ended, strict=True):
        assert found["outcome"] == "in_tolerance"
        assert site.summary() == json.loads(json.dumps(found))
        folders = [line["event"]["data"]["run_dir"] for line in logged(site) if line["message"] == "map_measured"]
        assert set(folders) == {str(site.config.run_dir)}
        assert [event.name for event in site.published].count("run_folder_completed") == 1


def no_spindle(bench: Any) -> None:
    bench.fake.spindle.acts.fails["open"] = LinkError("spindle: no answer")


def no_run_folder(bench: Any) -> None:
    """What goes wrong before the daemon is there."""
    (bench.tmp_path / "run").write_text("in the way")


@pytest.mark.full
async def test_a_journal_that_is_lost_at_the_end_is_its_own_cells_affair(
    sites: Sites, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin = app._journal

    def lost_by_the_first(config: Any, hooks: Any, program: Program) -> Journal:
        journal = begin(config, hooks, program)
        if config is sites.all[0].config:
            close = journal.close

            def fails() -> None:
                close()
                raise SafetyStop("journal lost")

            monkeypatch.setattr(journal, "close", fails)
        return journal

    monkeypatch.setattr(app, "_journal", lost_by_the_first)
    first, second = await sites.run()
    assert (type(first), second["outcome"]) == (SafetyStop, "in_tolerance")


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("broken", [no_spindle, no_run_folder])
async def test_one_that_ends_does_not_end_the_other(sites: Sites, broken: Any) -> None:
    sites.breaks[0] = broken
    first, second = await sites.run()
    assert isinstance(first, ConfigError) if broken is no_run_folder else first["exit_code"] == 5
    assert second["outcome"] == "in_tolerance"
    with locked(sites.all[0].config.state_dir):
        pass


async def test_a_cell_that_cannot_begin_refuses_all_before_anything_is_opened(sites: Sites) -> None:
    taken, free = (site.config.state_dir for site in reversed(sites.all))
    with locked(taken), pytest.raises(ConfigError, match="another polishd runs this cell"):
        await sites.run()
    for site in sites.all:
        assert site.bench is not None
        assert site.bench.fake.events == []
    with locked(free), locked(taken):
        pass


@pytest.mark.full
async def test_an_ended_cell_is_given_back_while_the_other_goes_on(sites: Sites) -> None:
    sites.breaks[0] = no_spindle
    first, second = sites.all
    second.measure = None
    async with asyncio.TaskGroup() as group:
        task = group.create_task(sites.run())
        await second.in_contact()
        while (first.config.state_dir / "lock").read_text():  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        assert not task.done()
        os.kill(os.getpid(), signal.SIGTERM)
    assert [found["outcome"] for found in task.result()] == ["failed", "stopped"]


@pytest.mark.full
async def test_a_signal_stops_all_safely(sites: Sites) -> None:
    waiting, in_contact = asyncio.Barrier(len(sites.all)), set[int]()
    all_are = asyncio.Event()

    def waits(bench: Any) -> None:
        """It is not in contact before the other can be: a robot that waits in contact is one that stands."""

        async def before_block() -> None:
            await asyncio.sleep(0)
            if bench.fake.robot.done == 1:
                await waiting.wait()
            if bench.fake.robot.done == 50:
                in_contact.add(id(bench))
                if len(in_contact) == len(sites.all):
                    all_are.set()

        bench.fake.robot.before_block = before_block

    sites.breaks = {0: waits, 1: waits}
    async with asyncio.TaskGroup() as group:
        task = group.create_task(sites.run())
        await all_are.wait()
        os.kill(os.getpid(), signal.SIGTERM)
    assert [found["outcome"] for found in task.result()] == ["stopped", "stopped"]
    for site in sites.all:
        assert site.bench is not None
        assert site.bench.fake.events[-7:] == [*SAFE, *CLOSED]


def test_who_comes_after_the_signal_is_stopped_too() -> None:
    stopped: list[str] = []

    class Daemon:
        def __init__(self, name: str) -> None:
            self.name = name

        def stop(self) -> None:
            stopped.append(self.name)

    shutdown = ShutdownRequest(SystemdNotifier())
    with shutdown.stopping(Daemon("early")):  # type: ignore[arg-type]
        shutdown.request()
        with shutdown.stopping(Daemon("late")):  # type: ignore[arg-type]
            assert stopped == ["early", "late"]
    shutdown.request()
    assert stopped == ["early", "late"], "they have ended"


def test_the_collector_waits_for_the_last_pass() -> None:
    before = gc.get_freeze_count()
    with short_collections():
        other = short_collections()
        with other:
            pass
        assert gc.get_freeze_count() > before
    assert gc.get_freeze_count() == 0
