"""Maps, surface and cell on the page in a browser: colors and readings are those of the data; mouse, touch and keys."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.rendering.scales import DIVERGING
from polishd.web.http.users import Role, UserFile, users_path
from tests.system.browser import Page, browsing, each_browser
from tests.system.cell_rig import with_keys
from tests.system.test_web import FREE, signed_in, web_of
from tests.unit.web.page_server import Answers, answering
from tests.unit.web.test_maps import PITCH, SPIKE, X, Y, fill, plan, surface

pytestmark = [pytest.mark.system, pytest.mark.full, each_browser]

READ = "document.querySelector('.m-read').textContent"
FACTS = "[...document.querySelectorAll('.m-facts dl > *')].map((one) => one.textContent).join(' ')"
INK = """(() => {{ const canvas = document.querySelector('{}'), one = document.createElement('canvas');
  one.width = canvas.width; one.height = canvas.height;
  const g = one.getContext('2d'); g.drawImage(canvas, 0, 0);
  const data = g.getImageData(0, 0, one.width, one.height).data; let sum = 0, count = 0;
  for (let k = 0; k < data.length; k += 4) {{
    if (data[k + 3] < 200) continue;
    count++;
    sum = (sum * 31 + data[k] + 7 * data[k + 1] + 13 * data[k + 2]) % 1000003;
  }}
  return [count, sum]; }})()"""
"""Number of opaque pixels of a canvas, and a hash of them."""
DRAWN = """(async () => { const { drawHeightMap } = await import('/maps/height_map.js');
  const data = await (await fetch('/api/jobs/1/cycles/0/map/measured?encoding=float32')).json();
  const canvas = document.createElement('canvas'); canvas.style.width = canvas.style.height = '400px';
  canvas.style.position = 'fixed'; document.body.append(canvas);
  const { toPx } = drawHeightMap(canvas, data, { compact: true, outside: 'hide' }), dpr = canvas.width / 400;
  const found = %s.map(([x, y]) => { const [px, py] = toPx(x, y);
    return [...canvas.getContext('2d').getImageData(Math.round(px * dpr), Math.round(py * dpr), 1, 1).data]; });
  canvas.remove(); return found; })()"""


UNNAMED = """[...document.querySelectorAll('#view :is(canvas, select, input, button)')].filter((one) =>
  one.checkVisibility() && !one.closest('[aria-hidden=true]')
  && !(one.getAttribute('aria-label') || one.labels?.length || one.textContent)).map((one) => one.outerHTML)"""
NO_WEBGL = """{ const was = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, how) {
    return kind === 'webgl2' ? null : was.call(this, kind, how); }; }"""
SLIDE = """{ const one = document.querySelector('.m-view input[type=range]');
  one.value = 10; one.dispatchEvent(new Event('input')); }"""


@dataclass
class Maps:
    """Open the page of a cell with a job of two measurements."""

    page: Page
    daemon: Answers

    def goes_to(self, name: str, ready: str) -> None:
        self.page.run(f"location.hash = '{name}'")
        self.page.until(ready)

    def middle(self, selector: str) -> tuple[float, float]:
        box = self.page.run(f"(() => {{ const b = document.querySelector('{selector}').getBoundingClientRect(); "
                            "return [b.left + b.width / 2, b.top + b.height / 2]; })()")  # fmt: skip
        return float(box[0]), float(box[1])

    def chooses(self, value: str) -> None:
        self.page.run(f"document.querySelector('.m-view input[value={value}]').click()")

    def changes(self, selector: str, act: Any) -> None:
        """Do something and wait until the picture has changed."""
        before = self.page.run(INK.format(selector))
        act()
        self.page.until(f"{INK.format(selector)}.join() !== '{before[0]},{before[1]}'")


@contextmanager
def maps(folder: Path, browser: str) -> Iterator[Maps]:
    files = write_demo(folder / "cell", None, 2.0, 4, None)
    files.cell.write_text(with_keys(files.cell.read_text(), FREE))
    config = load_config(files.cell)
    token = UserFile(users_path(config)).add("anna", Role.WATCH)
    fill(config.state_dir)
    with (
        answering(config.state_dir) as daemon,
        web_of(files) as url,
        browsing(folder / "browser", browser=browser) as page,
    ):
        daemon.live |= {"job": "demo", "part": "P", "cycle": 1, "phase": "solve", "pressing": False, "leaving": "",
                        "approval": "", "ages_s": {}, "unsafe": []}  # fmt: skip
        signed_in(page, url, token)
        yield Maps(page, daemon)
        assert page.problems == []
        assert page.run(UNNAMED) == [], "each control has a name for screen readers"


def reading(x: float, y: float, z: float) -> str:
    return f"x {x:.2f}   y {y:.2f} mm   z {z:.2f} nm".replace("-", "\u2212")


def test_the_map_has_the_colors_of_the_reports_and_reads_out_its_samples(tmp_path: Path, browser: str) -> None:
    with maps(tmp_path, browser) as shown:
        page = shown.page
        shown.goes_to("maps?cycle=0", f"{READ}.includes('nm')")
        height, limit = (
            surface(10.0)["height_nm"],
            page.run(
                "fetch('/api/jobs/1/cycles/0/map/measured').then((answer) => answer.json()).then((one) => one.scale[1])"
            ),
        )
        places = [SPIKE, (10, 8), (10, 16)]
        spots = page.run(DRAWN % [[float(X[one]), float(Y[one])] for one in places] + "")
        for place, spot in zip(places, spots, strict=True):
            wanted = np.array(mpl.colormaps[DIVERGING](0.5 + height[place] / limit / 2)[:3]) * 255
            assert np.abs(np.array(spot[:3]) - wanted).max() <= 6, (place, spot, wanted)
            assert spot[3] == 255
        assert page.run(DRAWN % "[[0, 44], [50, 50]]")[0][3] == 0, "outside the clear aperture"
        page.run("document.querySelector('.m-map').focus()")
        page.key("Home")
        page.until(f"{READ}.startsWith('x 0.00   y 0.00')")
        page.key("ArrowRight")
        page.key("ArrowUp", shift=True)
        page.until(f"{READ}.startsWith('x 5.00   y ')")
        page.key("Home")
        for _ in range(2):
            page.key("ArrowDown")
        page.until(f"{READ} === '{reading(0.0, -2 * PITCH, 10.0 * 0.5)}'")
        for kind in ("predicted", "removal", "dwell", "gamma", "residual"):
            shown.changes(".m-map", lambda kind=kind: shown.chooses(kind))
        shown.goes_to("maps", f"{FACTS}.includes('PV')")


def test_the_map_is_zoomed_by_keys_wheel_and_two_fingers_and_says_what_is_missing(tmp_path: Path, browser: str) -> None:
    with maps(tmp_path, browser) as shown:
        page = shown.page
        shown.goes_to("maps?cycle=1", f"{READ}.includes('nm')")
        page.run("document.querySelector('.m-map').focus()")
        shown.changes(".m-map", lambda: page.key("+"))
        page.until(f"{FACTS}.endsWith('1.3 ×') || {FACTS}.endsWith('1.2 ×')")
        page.key("0")
        page.until(f"{FACTS}.endsWith('1.0 ×')")
        x, y = shown.middle(".m-map")
        page.wheel(x, y, -400)
        page.until(f"{FACTS}.endsWith('2.2 ×')")
        page.mouse("move", x - 60, y - 30)
        page.until(f"!{READ}.startsWith('x 0.00')")
        page.key("0")
        page.pinch(x, y, (20, 40, 60))
        page.until(f"{FACTS}.endsWith('3.0 ×')")
        shown.chooses("residual")
        page.until("document.querySelector('.m-message').textContent.includes('no measurement after pass 1 yet')")


def test_the_surface_is_drawn_turned_and_missed_where_there_is_no_webgl(tmp_path: Path, browser: str) -> None:
    with maps(tmp_path, browser) as shown:
        page = shown.page
        mesh = ".m-stage canvas"
        shown.goes_to("maps?cycle=0&look=solid", f"{INK.format(mesh)}[0] > 20000")
        page.run("document.querySelector('.m-stage canvas:last-of-type').focus()")
        shown.changes(mesh, lambda: page.key("ArrowLeft"))
        shown.changes(mesh, lambda: page.key("+"))
        shown.changes(mesh, lambda: shown.chooses("removal"))
        page.until("/Vertical exaggeration: [0-9,]+ ×/.test(document.querySelector('.m-view').textContent)")
        shown.goes_to("queue", "!document.querySelector('.m-view')")
        page.run(NO_WEBGL)
        shown.goes_to("maps", "document.querySelector('.m-message')?.textContent.includes('no WebGL 2')")


def test_the_cell_shows_the_robot_at_the_block_that_it_has_executed(tmp_path: Path, browser: str) -> None:
    with maps(tmp_path, browser) as shown:
        page, picture = shown.page, ".m-stage canvas"
        blocks = plan()["block"]
        shown.goes_to("cell", f"{INK.format(picture)}[0] > 3000")
        page.until(f"{FACTS}.includes('Block {blocks[0]} ') && {FACTS}.includes('no pass runs')")
        for view in ("top", "side", "free", "part"):
            shown.changes(picture, lambda view=view: shown.chooses(view))
        page.run("document.querySelector('.m-stage canvas').focus()")
        shown.changes(picture, lambda: page.key("ArrowRight"))
        robot = {"state": "running", "executed": int(blocks[300]), "buffer_s": 3.0, "age_s": 0.1}
        shown.daemon.live |= {"phase": "run", "pressing": True, "readings": {"robot": robot}}
        page.until(f"{FACTS}.includes('Block {blocks[300]} ') && {FACTS}.includes('tool on the part')")
        page.run(SLIDE)
        page.until(f"{FACTS}.includes('Block {blocks[10]} ')")
