"""Measure the page: weight, time to the first paint, and the cost of 50 watchers. Prints one line each.

``python -m tests.screenshots.measure``. The figures in docs/how-to/web.md come from here.
"""

from __future__ import annotations

import json
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.util.worker_process import process_cpu_s
from polishd.web.http.static_files import static_files
from polishd.web.http.users import Role, UserFile, users_path
from tests.screenshots.camera import OPTIONS
from tests.screenshots.frozen_cell import frozen_server, live
from tests.screenshots.scenes import DASHBOARD, SCENES
from tests.system.browser import browsing
from tests.system.cell_rig import with_keys
from tests.system.test_web import FREE, web_process
from tests.unit.web.page_server import answering

WATCHERS, LASTS_S, OVERVIEW_S = 50, 30.0, 5.0
PAINT = """JSON.stringify({
    paint: performance.getEntriesByType('paint').map((one) => [one.name, Math.round(one.startTime)]),
    bytes: performance.getEntriesByType('resource').concat(performance.getEntriesByType('navigation'))
        .filter((one) => !one.name.includes('/api/')).reduce((sum, one) => sum + one.transferSize, 0),
})"""


def say(line: str) -> None:
    """Print at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def weight() -> None:
    """Print the size of all files, as they are and as they are sent."""
    files = static_files().values()
    plain, sent = sum(len(one.content) for one in files), sum(len(one.sent) for one in files)
    say(f"all files: {plain} bytes, {sent} as they are sent")


def paint() -> None:
    """Print the time to the first paint of the dashboard on loopback, with an empty cache, three times."""
    with tempfile.TemporaryDirectory() as folder, frozen_server(Path(folder), SCENES["polishing"]) as server:
        for number in range(3):
            with browsing(Path(folder) / f"browser-{number}", *OPTIONS) as page:
                page.aim(1440, 900, "light")
                server.sign_in(page)
                page.call("Network.clearBrowserCache")
                began_s = time.monotonic()
                server.show(page, "dashboard")
                page.until(DASHBOARD)
                found = json.loads(page.run(PAINT))
                whole_ms = round(1000 * (time.monotonic() - began_s))
                say(f"{dict(found['paint'])} ms; dashboard complete after {whole_ms} ms, {found['bytes']} bytes")


def _watch(url: str, token: str, ended: threading.Event, received: list[int], number: int) -> None:
    """Read the stream as a page does, and the overview every five seconds."""
    headers = {"Authorization": f"Bearer {token}"}
    with urllib.request.urlopen(urllib.request.Request(f"{url}api/events", headers=headers)) as stream:
        next_s = time.monotonic() + OVERVIEW_S * number / WATCHERS
        while not ended.is_set() and (line := stream.readline()):
            received[number] += line.startswith(b"event: state")
            if time.monotonic() > next_s and not ended.is_set():
                next_s += OVERVIEW_S
                urllib.request.urlopen(urllib.request.Request(f"{url}api/overview", headers=headers)).read()


def watchers(count: int) -> None:
    """Print what so many pages cost: CPU time of the page's server, and requests that reach the daemon.

    The daemon here is a stand-in: `make bench ARGS=watchers` measures what the pages cost a daemon in contact.
    """
    with tempfile.TemporaryDirectory() as folder:
        files = write_demo(Path(folder) / "cell", None, 2.0, 4, None)
        files.cell.write_text(with_keys(files.cell.read_text(), FREE))
        config = load_config(files.cell)
        users = UserFile(users_path(config))
        tokens = [users.add(f"user-{k}", Role.WATCH) for k in range(max(count // 10, 1))]
        with answering(config.state_dir) as daemon, web_process(files) as (url, process):
            daemon.live |= live()
            ended, received = threading.Event(), [0] * count
            work = [(url, tokens[k % len(tokens)], ended, received, k) for k in range(count)]
            threads = [threading.Thread(target=_watch, args=args, daemon=True) for args in work]
            for thread in threads:
                thread.start()
            time.sleep(3)
            used_s, looks, states, began_s = process_cpu_s(process.pid), daemon.looks, sum(received), time.monotonic()
            time.sleep(LASTS_S)
            took_s = time.monotonic() - began_s
            share, asked = (process_cpu_s(process.pid) - used_s) / took_s, (daemon.looks - looks) / took_s
            got = (sum(received) - states) / took_s
            ended.set()
            for thread in threads:
                thread.join(5)
        cost = f"{100 * share:.1f} % of a core for the server, {asked:.2f} requests/s to the daemon"
        say(f"{count} watchers: {cost}, {got:.0f} states/s")


if __name__ == "__main__":
    weight()
    for pages in (0, 1, WATCHERS):
        watchers(pages)
    paint()
