"""The page in a browser, for a cell that does not change: its layouts, commands, keys, sound and themes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

from tests.screenshots.frozen_cell import FrozenServer, frozen_server
from tests.screenshots.scenes import DASHBOARD, SCENES, Shot, solid
from tests.system.browser import BROWSERS, Page, browsing
from tests.system.sim_rig import wait_for

pytestmark = [pytest.mark.system, pytest.mark.full]

Open = Callable[..., AbstractContextManager[tuple[Page, FrozenServer]]]


@pytest.fixture(params=BROWSERS)
def opened(tmp_path: Path, request: pytest.FixtureRequest) -> Open:
    @contextmanager
    def _open(scene: str, width: int = 1440, height: int = 900) -> Iterator[tuple[Page, FrozenServer]]:
        with (
            frozen_server(tmp_path, SCENES[scene]) as server,
            browsing(tmp_path / "browser", browser=request.param) as page,
        ):
            page.aim(width, height, "light")
            server.sign_in(page)
            page.until(DASHBOARD)
            yield page, server
            assert page.problems == []

    return _open


def orders(server: FrozenServer) -> list[str]:
    """Commands that the daemon received."""
    assert server.daemon is not None
    return [verb for verb, args in server.daemon.asked if "by" in args]


def bottom(page: Page, selector: str) -> float:
    return float(page.run(f"document.querySelector({selector!r}).getBoundingClientRect().bottom"))


@pytest.mark.parametrize("scene", ["polishing", "held"])
def test_all_of_the_dashboard_is_on_one_screen(opened: Open, scene: str) -> None:
    with opened(scene) as (page, _):
        for part in ("#now", "#alarms-card", "#map-card", "#progress-chart", "#force-chart", "#psd", "#journal-card"):
            assert bottom(page, part) <= 900, part
        assert page.run("document.getElementById('main').scrollHeight <= document.getElementById('main').clientHeight")


def test_a_phone_shows_state_time_left_force_hold_and_stop_first(opened: Open) -> None:
    with opened("polishing", 390, 844) as (page, _):
        orders_top = float(page.run("document.querySelector('.orders').getBoundingClientRect().top"))
        seen = [bottom(page, part) for part in ("#state", "#tile-left", "#tile-force", "#does", "#done-text")]
        assert seen == sorted(seen)
        assert seen[-1] < orders_top < bottom(page, ".orders") <= 844
        assert page.run("document.documentElement.scrollWidth <= 390")


def test_figures_have_units_and_sensible_digits(opened: Open) -> None:
    with opened("polishing") as (page, server):
        assert page.run("document.getElementById('tile-force').textContent") == "Force12.03Nset to 12.0 N"
        left = page.run("document.getElementById('tile-left').textContent")
        assert left.startswith("Time left9min± "), left
        server.show(page, "host")
        page.until("document.getElementById('host-figures').textContent.includes('2.6\u00a0ms')")
        assert "81.8\u00a0GB" in page.run("document.getElementById('host-figures').textContent")


def test_hold_is_one_tap_and_stop_holds_at_that_tap_before_it_asks(opened: Open) -> None:
    with opened("polishing") as (page, server):
        page.press("hold")
        wait_for(lambda: orders(server) == ["hold"], "the order")
        page.press("stop")
        page.until("document.getElementById('confirm').open")
        wait_for(lambda: orders(server) == ["hold", "hold"], "leaving the part at the tap")
        page.key("Escape")
        page.until("!document.getElementById('confirm').open")
        page.press("stop")
        page.until("document.activeElement.id === 'confirm-yes'")
        page.key("Enter")
        wait_for(lambda: orders(server) == ["hold", "hold", "hold", "stop"], "the end of the run")


def test_resume_asks_and_its_reason_and_keys_reach_the_daemon(opened: Open) -> None:
    with opened("held") as (page, server):
        page.press("resume")
        page.until("document.activeElement.id === 'confirm-yes'")
        page.key("Escape")
        page.until("!document.getElementById('confirm').open")
        assert orders(server) == []
        page.press("resume")
        page.run("document.getElementById('reason').value = 'cable'; document.getElementById('reason').focus()")
        page.key("Enter")
        wait_for(lambda: orders(server) == ["resume"], "the order")
        assert server.daemon is not None
        assert ("resume", {"reason": "cable", "by": "anna (web)"}) in server.daemon.asked


@pytest.mark.parametrize(("scene", "guide"), [("held", "held"), ("killed", "killed"), ("approve", "approval")])
def test_what_to_do_is_said_for_each_ending(opened: Open, scene: str, guide: str) -> None:
    with opened(scene) as (page, _):
        assert page.run("document.getElementById('guide').dataset.guide") == guide
        assert page.run("document.querySelectorAll('#guide .steps li').length") >= 3


def test_an_alarm_sounds_until_it_is_silenced_and_the_sound_can_be_tested_and_switched_off(opened: Open) -> None:
    with opened("held") as (page, _):
        page.until("[...document.querySelectorAll('#alarm-line button')].some((one) => one.textContent === 'Silence')")
        page.run("document.querySelector('#alarm-line button').click()")
        page.until("![...document.querySelectorAll('#alarm-line button')].some((one) => one.textContent === 'Silence')")
        page.press("settings-button")
        page.run("document.getElementById('sound-test').focus()")
        page.key("Enter")  # a click by a script is no gesture, which a browser wants before it plays
        page.until("document.getElementById('sound-message').textContent.startsWith('Three tones')")
        page.press("sound-button")
        assert page.run("localStorage.getItem('polishd.sound')") == "off"


def test_the_theme_follows_the_system_until_it_is_chosen_and_the_choice_stays(opened: Open) -> None:
    with opened("polishing") as (page, server):
        assert page.run("document.documentElement.dataset.theme") == "light"
        page.aim(1440, 900, "dark")
        page.until("document.documentElement.dataset.theme === 'dark'")
        page.press("settings-button")
        page.run("[...document.querySelectorAll('#theme button')].find((one) => one.textContent === 'Light').click()")
        server.show(page, "dashboard")
        assert page.run("document.documentElement.dataset.theme") == "light"


def test_every_tab_and_order_is_reached_by_the_tab_key(opened: Open) -> None:
    with opened("held") as (page, _):
        reached = set()
        for _ in range(40):
            page.key("Tab")
            reached.add(page.run("document.activeElement.id || document.activeElement.hash || ''"))
        assert {
            "#dashboard",
            "#maps",
            "#cell",
            "#queue",
            "#history",
            "#host",
            "stop",
            "resume",
            "acknowledge",
        } <= reached


def test_every_view_is_opened_by_keys_and_drawn_without_a_request_to_elsewhere(opened: Open) -> None:
    with opened("polishing") as (page, server):
        for view in ("maps", "cell", "queue", "history", "host", "dashboard"):
            for _ in range(60):
                if page.run("document.activeElement.hash") == f"#{view}":
                    break
                page.key("Tab", shift=view != "maps")  # back: out of a view that may have hundreds of links
            page.key("Enter")
            page.until(f"document.querySelector('#view > .view-{view}')")
            page.until(Shot(view, "polishing", view).ready)
            if view == "maps":
                solid(page)
                page.until("document.querySelector('.m-view').dataset.ready.endsWith('solid')")
        assert f"{server.url}api/overview" in page.requests
        assert [one for one in page.requests if not one.startswith((server.url, "data:", "about:"))] == []


def test_no_view_fails_where_the_server_is_not_reached(opened: Open) -> None:
    with opened("polishing") as (page, _):
        page.run("globalThis.fetch = () => Promise.reject(new TypeError('lost')); 0")
        for view in ("maps", "cell", "queue", "history", "host", "approve", "dashboard"):
            page.run(f"location.hash = '{view}'")
            page.until(f"document.querySelector('#view > .view-{view}')")
        page.press("hold")
        page.until("document.getElementById('message').textContent.includes('No connection')")
