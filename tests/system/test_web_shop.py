"""Queue, history and approval on the page: order by keys and pointer, figures before approval, comparison."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import CellConfig, load_config
from polishd.daemon.queue.queue import Queue
from polishd.web.http.users import Role, UserFile, users_path
from tests.system.browser import Page, browsing, each_browser
from tests.system.cell_rig import with_keys
from tests.system.test_web import FREE, signed_in, web_of
from tests.unit.web.filled_journal import shop_cell
from tests.unit.web.page_server import Answers, answering

pytestmark = [pytest.mark.system, pytest.mark.full, each_browser]

ORDER = "[...document.querySelectorAll('#queue-waiting [data-job]')].map((one) => one.dataset.job).join(' ')"
GRIP = "document.querySelector('[data-job=\"{}\"] [data-what=grip]')"
READINGS = "performance.getEntriesByType('resource').filter((one) => one.name.endsWith('/api/queue')).length"


@dataclass
class Shop:
    """Page of a cell in a shop, with the daemon that receives its commands."""

    page: Page
    daemon: Answers
    program: str

    def goes_to(self, name: str, ready: str) -> None:
        self.page.run(f"location.hash = '{name}'")
        self.page.until(ready)

    def orders(self, verb: str) -> list[dict[str, Any]]:
        return [args for asked, args in self.daemon.asked if asked == verb]


def queue_of(config: CellConfig, verb: str, args: dict[str, Any]) -> None:
    """Change the queue as the daemon does."""
    if verb == "queue_move":
        with Queue.at_rest(config.state_dir) as queue:
            queue.move(args["job"], args["where"], args["other"])
    elif verb == "queue_remove":
        with Queue.at_rest(config.state_dir) as queue:
            queue.remove_waiting(args["job"], args["reason"])


@contextmanager
def shop(folder: Path, browser: str, role: Role = Role.OPERATE) -> Iterator[Shop]:
    files = write_demo(folder / "cell", None, 2.0, 4, None)
    files.cell.write_text(with_keys(files.cell.read_text(), FREE))
    config = load_config(files.cell)
    token = UserFile(users_path(config)).add("anna", role)
    program = shop_cell(config, time.time(), parts=12)
    with (
        answering(config.state_dir) as daemon,
        web_of(files) as url,
        browsing(folder / "browser", browser=browser) as page,
    ):
        daemon.does = lambda verb, args: queue_of(config, verb, args)
        daemon.live |= {"approval": program, "job": "lens-2001", "part": "part-lens-2001", "cycle": 1, "phase": "plan",
                        "pressing": False, "leaving": "", "ages_s": {}, "unsafe": []}  # fmt: skip
        signed_in(page, url, token)
        yield Shop(page, daemon, program)
        assert page.problems == []


def test_jobs_are_moved_by_keys_and_by_pointer_and_removed_with_a_reason(tmp_path: Path, browser: str) -> None:
    with shop(tmp_path, browser) as shown:
        page = shown.page
        shown.goes_to("queue", f"{ORDER} === 'lens-2002 lens-2003 mirror-7 mirror-8'")
        page.until(f"!{GRIP.format('lens-2002')}.disabled")
        page.run(f"{GRIP.format('lens-2002')}.focus()")
        page.key("ArrowDown")
        page.until(f"{ORDER} === 'lens-2003 lens-2002 mirror-7 mirror-8'")
        page.until("document.activeElement.closest('[data-job]')?.dataset.job === 'lens-2002'")
        page.key("End")
        page.until(f"{ORDER} === 'lens-2003 mirror-7 mirror-8 lens-2002'")
        assert shown.orders("queue_move")[0] == {
            "job": "lens-2002", "where": "after", "other": "lens-2003", "by": "anna (web)",
        }  # fmt: skip
        where = page.run(
            "JSON.stringify([...document.querySelectorAll('#queue-waiting .grip')].map((one) => "
            "{ const box = one.getBoundingClientRect(); return [box.x + box.width / 2, box.y + box.height / 2]; }))"
        )
        (x, first), (_, second) = json.loads(where)[:2]
        for what, y in (("move", first), ("down", first), ("move", second), ("move", second + 4)):
            page.mouse(what, x, y)
        before = page.run(READINGS)
        page.run("location.hash = 'queue?job=lens-2003'")  # the queue is read anew, as after an order from another page
        page.until(f"{READINGS} > {before}")
        page.mouse("up", x, second + 4)
        page.until(f"{ORDER} === 'mirror-7 lens-2003 mirror-8 lens-2002'")
        page.run("document.querySelector('[data-job=mirror-8] [data-what=remove]').click()")
        page.until("document.getElementById('confirm').open")
        page.run("document.getElementById('reason').value = 'a chip'")
        page.run("document.getElementById('confirm-yes').click()")
        page.until(f"{ORDER} === 'mirror-7 lens-2003 lens-2002'")
        assert shown.orders("queue_remove") == [{"job": "mirror-8", "reason": "a chip", "by": "anna (web)"}]


def test_the_button_approves_only_the_plan_whose_figures_are_shown(tmp_path: Path, browser: str) -> None:
    ready = "document.getElementById('approve-run') && !document.getElementById('approve-run').disabled"
    with shop(tmp_path, browser) as shown:
        page = shown.page
        shown.goes_to("approve", ready)
        text = page.run("document.getElementById('approve-figures').innerText")
        for figure in ("1.40", "4.60", "18.4", "0.420", "96", shown.program[:12]):
            assert figure in text
        assert "ripple of 0.42 nm RMS" in page.run("document.getElementById('approve-warnings').innerText")
        assert "Largest removal" in page.run("document.getElementById('approve-limits').innerText")
        page.until("document.querySelectorAll('#approve-maps canvas.thumb').length === 3")
        shown.daemon.live["approval"] = "ab" * 32
        page.until("!document.getElementById('approve-run')")
        shown.daemon.live["approval"] = shown.program
        page.until(ready)
        page.press("approve-run")
        page.until("document.getElementById('confirm').open")
        page.run("document.getElementById('confirm-yes').click()")
        page.until("document.getElementById('message').textContent.includes('obeyed')")
        assert shown.orders("approve") == [{"program_sha256": shown.program, "by": "anna (web)"}]


def test_two_parts_are_compared_and_one_is_shown(tmp_path: Path, browser: str) -> None:
    with shop(tmp_path, browser) as shown:
        page = shown.page
        shown.goes_to("history", "document.querySelectorAll('#history-parts tbody tr').length === 13")
        page.until("document.querySelectorAll('#weeks-parts canvas').length === 1")
        page.run("document.getElementById('history-search').value = 'lens-000'")
        page.run("document.getElementById('history-search').dispatchEvent(new Event('input'))")
        page.until("document.querySelectorAll('#history-parts tbody tr').length === 9")
        page.run("document.querySelector('[data-sort=first]').click()")
        page.until("document.querySelector('[data-sort=first]').closest('th').ariaSort === 'descending'")
        for number in (1, 2):
            page.run(f"document.querySelector('[data-number=\"{number}\"] input').click()")
        page.press("history-compare")
        page.until("document.querySelectorAll('#compare-maps-0 canvas.thumb').length === 2")
        figures = page.run("document.getElementById('compare-figures').innerText")
        assert "part-lens-0001" in figures
        assert "part-lens-0002" in figures
        shown.goes_to("history?job=1", "document.querySelectorAll('#part-passes tbody tr').length === 2")
        shown.goes_to(
            "history?job=99", "document.querySelector('.problem')?.textContent.includes('there is no job 99')"
        )


def test_who_may_only_watch_sees_all_and_changes_nothing(tmp_path: Path, browser: str) -> None:
    with shop(tmp_path, browser, Role.WATCH) as shown:
        page = shown.page
        shown.goes_to("queue", f"{ORDER} === 'lens-2002 lens-2003 mirror-7 mirror-8'")
        page.until("[...document.querySelectorAll('.grip, .job-tools button')].every((one) => one.disabled)")
        shown.goes_to("approve", "document.getElementById('approve-why').textContent.includes('operate')")
        assert page.run("document.getElementById('approve-run').disabled")
