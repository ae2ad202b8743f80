"""The scenes: states of the frozen cell, and what is photographed in each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tests.screenshots import frozen_cell as cell
from tests.screenshots.frozen_cell import Scene, live, off_the_part, readings
from tests.system.browser import Page

SCENES = {
    "polishing": Scene(live(), cell.POLISHING, readings(900.0)),
    "held": Scene(
        off_the_part(state="held", reason=cell.LINK_LOST, phase="run", ages_s={**live()["ages_s"], "actuator": 196.2}),
        cell.HELD,
        readings(900.0, 196.0),
        running=False,
    ),
    "killed": Scene(
        {},
        cell.POLISHING,
        readings(900.0, 2.0),
        daemon=False,
        ending={
            "state": "polishing",
            "reason": "",
            "next": "",
            "tool_off": "not confirmed",
            "robot_at_rest": "not confirmed",
            "unsafe": ["actuator: it was not asked", "robot: it was not asked"],
        },
    ),
    "approve": Scene(
        off_the_part(phase="plan", approval=cell.PROGRAM), cell.POLISHING[:2], readings(0.0), running=False
    ),
    "measuring": Scene(
        off_the_part(phase="measure", cycle=2),
        (
            *cell.HELD,
            (20, "alarm_acknowledged", {"alarms": list(range(1, 40)), "by": "anna (web)"}),
            (12, "command_received", {"order": "resume", "reason": "cable of the actuator", "by": "anna (web)"}),
        ),
        readings(900.0, 196.0),
        running=False,
    ),
}

DASHBOARD = (
    "document.querySelectorAll('#journal li').length > 3 && document.querySelectorAll('.u-wrap').length > 1"
    " && document.getElementById('map-summary').textContent.includes('nm')"
)


def nothing(_page: Page) -> None:
    """Take the view as it opens."""


def at(selector: str) -> Callable[[Page], None]:
    """Scroll there."""
    script = f"document.querySelector({selector!r}).scrollIntoView({{ block: 'start' }}); scrollBy(0, -64)"

    def scroll(page: Page) -> None:
        page.until(f"document.querySelector({selector!r})")
        page.run(script)

    return scroll


def asked(page: Page) -> None:
    """Press Resume: the page asks."""
    page.press("resume")
    page.until("document.getElementById('confirm').open")


def solid(page: Page) -> None:
    """Show the map as a surface."""
    buttons = "[...document.querySelectorAll('.view-maps button, .view-maps label')]"
    choice = f"{buttons}.find((one) => one.textContent === '3-D surface')"
    page.until(choice)
    page.run(f"{choice}.click()")


@dataclass(frozen=True, slots=True)
class Shot:
    """A picture, or one of each size."""

    name: str
    scene: str
    view: str
    """Hash of the view in the URL."""
    act: Callable[[Page], None] = nothing
    """Done before the picture."""

    @property
    def ready(self) -> str:
        """What holds on the page once it is complete."""
        if self.view.startswith(("maps", "cell")):
            look = "flat" if self.view == "maps" else "cell"
            return f"document.querySelector('.m-view')?.dataset.ready?.endsWith('{look}')"
        return DASHBOARD if self.view == "dashboard" else "document.querySelectorAll('#view *').length > 10"


VIEWS = (
    Shot("polishing", "polishing", "dashboard"),
    Shot("held", "held", "dashboard"),
    Shot("alarm", "killed", "dashboard"),
    Shot("approve", "approve", "approve"),
    Shot("queue", "polishing", "queue"),
    Shot("history", "polishing", "history"),
    Shot("map-2d", "polishing", "maps"),
    Shot("map-3d", "polishing", "maps", solid),
    Shot("cell", "polishing", "cell"),
)
"""In all sizes."""
NIGHT = (
    Shot("night-alarms", "held", "dashboard", at("#alarms-card")),
    Shot("night-journal", "held", "dashboard", at("#journal-card")),
    Shot("night-host", "held", "host", at("#host-devices")),
    Shot("night-map", "held", "maps"),
    Shot("night-resume", "held", "dashboard", asked),
    Shot("night-measuring", "measuring", "dashboard"),
)
"""On the phone: docs/how-to/at-3-am.md."""
