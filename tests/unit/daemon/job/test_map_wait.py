"""A map that is refused while the cell waits for one: event, notification and status line at once, and a reminder."""

# ruff: noqa: ASYNC110, ASYNC240  (a test may block its own loop for a moment)

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.cli.status import _refused
from polishd.daemon.job import map_wait
from polishd.hookspecs import DeviceContext
from polishd.model.devices import MapRefusal
from polishd.model.events import MapRefused
from polishd.model.states import Outcome, Severity
from polishd.plugins.interferometer.formats.metropro import METROPRO
from polishd.plugins.interferometer.watched_folder import WATCHED_FOLDER, FolderOptions
from tests.time_limits import SOON_S
from tests.unit.daemon.small_job import Bench, open_journal
from tests.unit.daemon.test_app import Running
from tests.unit.plugins.interferometer.test_watched_folder import dat


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with open_journal(tmp_path) as journal:
        yield Bench(tmp_path, journal)


REFUSED = MapRefusal("a.dat", "WrongPart", "it shows part 'X', the part is 'Y'", "Measure part 'Y'.", "/q/a.dat")


def refusals(running: Running) -> list[MapRefused]:
    return [event for event in running.daemon.job.published if isinstance(event, MapRefused)]  # type: ignore[union-attr]


async def refused(running: Running, count: int = 1) -> None:
    async with asyncio.timeout(SOON_S):
        while len(refusals(running)) < count:
            await asyncio.sleep(0.001)


async def test_a_refusal_is_an_event_a_notification_and_in_the_status(bench: Bench) -> None:
    metrology = bench.fake.metrology
    metrology.refuses = [REFUSED]
    metrology.acts.hangs.add("next_map")
    async with Running(bench) as running:
        await refused(running)
        (event,) = refusals(running)
        concern = event.concern()
        assert concern.severity is Severity.WARNING
        assert concern.what == "map a.dat refused: WrongPart: it shows part 'X', the part is 'Y'"
        assert concern.todo == "Measure part 'Y'."
        facts = (await running.daemon.status())["map_refused"]
        assert _refused(facts) == (
            "a.dat: WrongPart: it shows part 'X', the part is 'Y'; the file is in /q/a.dat. To do: Measure part 'Y'."
        )


async def test_it_is_reported_again_while_no_map_comes(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    assert map_wait.REMIND_S == 600
    monkeypatch.setattr(map_wait, "REMIND_S", 0.01)
    metrology = bench.fake.metrology
    metrology.refuses = [REFUSED]
    metrology.acts.hangs.add("next_map")
    async with Running(bench) as running:
        await refused(running, 3)
        assert [event.waited_s for event in refusals(running)[:3]] == pytest.approx([0.0, 0.01, 0.02])


async def test_a_map_ends_it(bench: Bench) -> None:
    bench.fake.metrology.refuses = [REFUSED]
    async with Running(bench) as running:
        assert await running.outcome() is Outcome.IN_TOLERANCE
        assert len(refusals(running)) == 1
        assert bench.fake.cell.map_refusal is None


@pytest.mark.parametrize(
    ("name", "content", "kind", "todo"),
    [
        ("other.dat", dat(1, part="OTHER"), "WrongPart", "Measure part 'D1'"),
        ("old.dat", dat(1, part="D1", at=1e9), "StaleMap", "Measure again"),
    ],
)
async def test_the_watched_folder_reports_what_it_refuses(
    bench: Bench, tmp_path: Path, name: str, content: bytes, kind: str, todo: str
) -> None:
    (tmp_path / "maps").mkdir()
    options: dict[str, Any] = {"folder": "maps", "poll_s": 0.01, "stable_polls": 2, "stable_s": 0.0}
    if kind == "StaleMap":
        options["request_file"] = "request"
    context = DeviceContext(base_dir=tmp_path, state_dir=tmp_path / "state", part_id="D1", readers=[METROPRO])
    device = WATCHED_FOLDER.build(FolderOptions.model_validate(options), context)
    bench.fake.cell.devices = {**bench.fake.cell.devices, "metrology": device}
    async with Running(bench) as running:
        (tmp_path / "maps" / name).write_bytes(content)
        await refused(running)
        (event,) = refusals(running)
        assert (event.file, event.kind) == (name, kind)
        assert todo in event.todo
        assert Path(event.kept).read_bytes() == content
        assert (await running.daemon.status())["map_refused"]["reason"] == event.reason
