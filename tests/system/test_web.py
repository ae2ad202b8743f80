"""The page of a whole simulated cell in a browser: live, held, resumed, and after its daemon was killed."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, write_demo
from polishd.config.cell import load_config
from polishd.web.http.users import Role, UserFile, users_path
from tests.system.browser import Page, browsing, each_browser
from tests.system.cell_rig import Daemon, small_cell, with_keys
from tests.system.sim_rig import wait_for
from tests.time_limits import SOON_S
from tests.unit.web.page_server import Answers, answering

pytestmark = [pytest.mark.system, pytest.mark.full]

SEEN_S = 1.5
"""Time in s within which the page shows that the daemon was killed, on an idle machine."""
FREE = {"web": {"port": 0}}


WEB = ("-m", "polishd.cli.app", "web")
OFTEN = (
    "-c",
    "from polishd.cli import app as cli\nfrom polishd.web import watcher\nwatcher.LOOK_S = 0.01\ncli.main()",
    "web",
)
"""Program that sends as many updates in a minute as the page usually receives in an hour."""
LOOKS = 120
"""Number of updates in a minute."""


@contextlib.contextmanager
def web_process(files: DemoFiles, program: Sequence[str] = WEB) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run `polishd web` for the duration of the block; its address and process."""
    command = [sys.executable, *program, str(files.cell)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().strip(), process
        finally:
            process.terminate()
            process.wait(SOON_S)


@contextlib.contextmanager
def web_of(files: DemoFiles, program: Sequence[str] = WEB) -> Iterator[str]:
    """Run `polishd web` for the duration of the block; its address."""
    with web_process(files, program) as (url, _):
        yield url


def signed_in(page: Page, url: str, token: str) -> None:
    page.go(url)
    page.until("!document.getElementById('sign-in').hidden")
    page.run(f"document.getElementById('token').value = '{token}'")
    page.run("document.querySelector('#sign-in button').click()")
    page.until("!document.getElementById('main').hidden")


FRESH = "document.querySelector('#tile-force:not(.old) .value').textContent.endsWith('N')"
STATE = "document.getElementById('state').dataset.state === '{}' && !document.body.classList.contains('stale')"
HOLD_BECAUSE = """fetch('/api/session').then((one) => one.json()).then((session) => fetch('/api/orders/hold', {{
    method: 'POST', headers: {{ 'content-type': 'application/json', 'x-csrf-token': session.csrf }},
    body: JSON.stringify({{ reason: {!r} }}) }}))"""
"""Script that sends a hold with a reason, as another page does."""


@each_browser
def test_a_cycle_is_watched_held_gone_on_with_and_a_dead_daemon_is_seen(tmp_path: Path, browser: str) -> None:
    with small_cell(tmp_path / "cell", speed=5.0, tolerance_nm=0.1, max_cycles=4) as files:
        part = "<img src=x onerror=alert(1)>"
        files.cell.write_text(with_keys(files.cell.read_text(), FREE))
        token = UserFile(users_path(load_config(files.cell))).add("anna", Role.OPERATE)
        with web_of(files) as url, browsing(tmp_path / "browser", browser=browser) as page:
            signed_in(page, url, token)
            page.until("document.getElementById('lost').textContent.includes('NO DAEMON')")
            with Daemon(files) as daemon:
                page.until(FRESH)
                page.until("document.getElementById('lost').hidden")
                page.until("document.querySelectorAll('#convergence .u-wrap').length > 0")
                page.until("document.getElementById('map-summary').textContent.includes('nm')")
                page.press("hold")
                page.until(STATE.format("held"))
                page.until("document.getElementById('journal').textContent.includes('Hold by anna (web)')")
                page.until("document.getElementById('guide').dataset.guide === 'ordered'")
                page.run(HOLD_BECAUSE.format(part))
                page.until("document.getElementById('guide').textContent.includes('onerror')")
                page.press("resume")
                page.until("document.getElementById('confirm').open")
                page.press("confirm-yes")
                page.until(STATE.format("polishing"))
                daemon.process.send_signal(signal.SIGKILL)
                killed_s = time.monotonic()
                page.until("!document.getElementById('lost').hidden")
                took_s = time.monotonic() - killed_s
                assert page.run("document.body.classList.contains('stale')")
                page.until("[...document.querySelectorAll('.order')].every((one) => one.disabled)")
                cores = os.cpu_count() or 1
                assert took_s < SEEN_S or os.getloadavg()[0] > cores / 2, took_s
            assert page.requests
            assert all(one.startswith((url, "data:", "about:")) for one in page.requests), page.requests
            assert page.problems == []


def test_a_link_that_is_pulled_in_contact_is_seen_and_explained_at_once(tmp_path: Path) -> None:
    """The page reports the hold at once, not only when the tool is lifted and the cell is held."""
    with small_cell(tmp_path / "cell", speed=5.0, tolerance_nm=0.1, max_cycles=1) as files:
        files.cell.write_text(with_keys(files.cell.read_text(), FREE))
        lost_s = tomllib.loads(files.cell.read_text())["actuator"]["silence_s"]
        token = UserFile(users_path(load_config(files.cell))).add("anna", Role.WATCH)
        with web_of(files) as url, browsing(tmp_path / "browser") as page:
            signed_in(page, url, token)
            with Daemon(files) as daemon:
                daemon.wait_in_contact(20)
                page.until(FRESH)
                actuator = json.loads((files.sim_dir / "pids.json").read_text())["actuator"]
                os.kill(actuator, signal.SIGSTOP)
                pulled_s = time.monotonic()
                try:
                    page.until("/lifted: LinkError.*actuator/.test(document.getElementById('why').textContent)")
                    took_s = time.monotonic() - pulled_s
                    page.until("document.getElementById('alarms').textContent.includes('actuator')")
                finally:
                    os.kill(actuator, signal.SIGCONT)
                idle = os.getloadavg()[0] < (os.cpu_count() or 1) / 2
                assert took_s < lost_s + 0.5 or not idle, took_s
            assert page.problems == []


def memory(page: Page) -> tuple[int, int]:
    """Collect garbage; return the bytes that the page's scripts use and the number of its nodes."""
    page.call("HeapProfiler.collectGarbage")
    return page.call("Runtime.getHeapUsage")["usedSize"], page.call("Memory.getDOMCounters")["nodes"]


def reached(daemon: Answers, looks: int) -> bool:
    return daemon.looks >= looks


def minutes(daemon: Answers, count: int) -> None:
    """Something changes in each of the updates."""
    for _ in range(count):
        daemon.send_event({"name": "measured", "run_dir": "run"})
        upto = daemon.looks + LOOKS
        wait_for(partial(reached, daemon, upto), "a minute")


@pytest.mark.slow
def test_a_page_that_is_left_open_for_an_hour_keeps_its_memory(tmp_path: Path) -> None:
    files = write_demo(tmp_path / "cell", None, 2.0, 4, None)
    files.cell.write_text(with_keys(files.cell.read_text(), FREE))
    config = load_config(files.cell)
    token = UserFile(users_path(config)).add("anna", Role.WATCH)
    force = {"force_n": 12.0, "setpoint_n": 12.0, "in_contact": True, "retracted": False, "fault": 0, "age_s": 0.01}
    with (
        answering(config.state_dir) as daemon,
        web_of(files, OFTEN) as url,
        browsing(tmp_path / "browser") as page,
    ):
        daemon.live |= {"readings": {"force": force, "speed": {"rpm": 800.0, "age_s": 0.01}}, "pressing": True}
        signed_in(page, url, token)
        page.until(FRESH)
        minutes(daemon, 6)
        begun = memory(page)
        minutes(daemon, 60)
        ended = memory(page)
        page.until(FRESH)
    assert ended[0] < begun[0] + 500_000, (begun, ended)
    assert ended[1] < begun[1] + 1000, (begun, ended)  # some wait to be collected; a leak is one or more a look


@each_browser
def test_the_servers_own_end_is_seen_too(tmp_path: Path, browser: str) -> None:
    with small_cell(tmp_path / "cell") as files, browsing(tmp_path / "browser", browser=browser) as page:
        files.cell.write_text(with_keys(files.cell.read_text(), FREE))
        token = UserFile(users_path(load_config(files.cell))).add("anna", Role.WATCH)
        with web_of(files) as url:
            signed_in(page, url, token)
            page.until("document.getElementById('lost').textContent.includes('NO DAEMON')")
        page.until("document.getElementById('lost').textContent.includes('No connection')")
        page.until("[...document.querySelectorAll('.order')].every((one) => one.disabled)")
