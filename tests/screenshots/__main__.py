"""`make screenshots`: pictures of each view and state of the page into docs/images/page. Arguments: names of views or pictures."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tests.screenshots import frozen_cell as cell
from tests.screenshots.camera import OPTIONS, SIZES, Camera
from tests.screenshots.frozen_cell import Scene, frozen_server, live, off_the_part, readings
from tests.system import browser
from tests.system.browser import Page, browsing

OUT = Path(__file__).resolve().parents[2] / "docs" / "images" / "page"
MOST_BYTES = 1_500_000
"""Of all pictures together."""

POLISHING = Scene(live(), cell.POLISHING)
HELD = Scene(
    off_the_part(state="held", reason=cell.LINK_LOST, phase="run", ages_s={**live()["ages_s"], "actuator": 196.2}),
    cell.HELD,
    running=False,
)
KILLED = Scene(
    {},
    cell.POLISHING,
    daemon=False,
    ending={"state": "polishing", "reason": "", "unsafe": ["actuator: it was not asked"], "tool_off": "not confirmed",
            "robot_at_rest": "yes", "next": ""},
)  # fmt: skip
APPROVE = Scene(off_the_part(phase="plan", approval=cell.PROGRAM), (*cell.POLISHING[:2],), running=False)
MEASURING = Scene(
    off_the_part(phase="measure", cycle=2),
    (*cell.HELD, (20, "alarm_acknowledged", {"alarms": [15, 14, 16, 17, 18, 19, 20, 21, 22], "by": "anna (web)"}),
     (12, "command_received", {"order": "resume", "reason": "cable of the actuator replaced", "by": "anna (web)"})),
    running=False,
)  # fmt: skip

ROWS: Mapping[str, list[Any]] = {
    "polishing": readings(900.0),
    "held": readings(900.0, 196.0),
    "killed": readings(900.0, 2.0),
    "approve": readings(0.0),
    "measuring": readings(900.0, 196.0),
}
SCENES = {"polishing": POLISHING, "held": HELD, "killed": KILLED, "approve": APPROVE, "measuring": MEASURING}

READY = "!document.getElementById('main').hidden && document.getElementById('view').firstElementChild"
DASHBOARD = (
    f"{READY} && document.querySelectorAll('#journal li').length > 3 && document.querySelectorAll('.u-wrap').length > 1"
)
Shot = tuple[str, str, str, Callable[[Page], None] | None]
"""Name, scene, hash, and what is done before the picture."""


def nothing(_page: Page) -> None:
    """The view as it opens."""


def below(selector: str) -> Callable[[Page], None]:
    """Scroll there."""
    return lambda page: page.run(
        f"document.querySelector({selector!r}).scrollIntoView({{ block: 'start' }}); scrollBy(0, -64)"
    )


def asked(page: Page) -> None:
    """Press Resume: the page asks."""
    page.press("resume")
    page.until("document.getElementById('confirm').open")


VIEWS: tuple[Shot, ...] = (
    ("polishing", "polishing", "dashboard", None),
    ("held", "held", "dashboard", None),
    ("alarm", "killed", "dashboard", None),
    ("approve", "approve", "approve", None),
    ("queue", "polishing", "queue", None),
    ("history", "polishing", "history", None),
    ("map-2d", "polishing", "maps", None),
    ("map-3d", "polishing", "maps?show=solid", None),
    ("cell", "polishing", "cell", None),
)
"""In all sizes."""
NIGHT: tuple[Shot, ...] = (
    ("night-alarms", "held", "dashboard", below("#alarms-card")),
    ("night-host", "held", "host", below("#host-devices")),
    ("night-resume", "held", "dashboard", asked),
    ("night-measuring", "measuring", "dashboard", None),
)
"""On the phone: docs/how-to/at-3-am.md."""


def main(names: list[str]) -> int:
    """Make the pictures; 1 where they take too much room."""
    browser.SOON_S = 40.0  # a picture that does not come is missing something: say it soon
    OUT.mkdir(parents=True, exist_ok=True)
    shots = [(shot, list(SIZES)) for shot in VIEWS] + [(shot, ["phone"]) for shot in NIGHT]
    if names:  # of views, or of single pictures: "held", "held-phone"
        chosen = [(shot, [size for size in sizes if {shot[0], f"{shot[0]}-{size}"} & set(names)]) for shot, sizes in shots]
        shots = [(shot, sizes) for shot, sizes in chosen if sizes]
    for scene in dict.fromkeys(shot[1] for shot, _ in shots):
        with (
            tempfile.TemporaryDirectory() as folder,
            frozen_server(Path(folder), SCENES[scene], ROWS[scene]) as (url, token, _),
            browsing(Path(folder) / "browser", *OPTIONS) as page,
        ):
            camera = Camera(page)
            camera.aim("light")
            page.go(url)
            page.until("!document.getElementById('sign-in').hidden")
            page.run(
                f"fetch('/api/session', {{ method: 'POST', headers: {{ 'content-type': 'application/json' }}, body: JSON.stringify({{ token: '{token}' }}) }}).then(() => true)"
            )
            for (name, _, view, act), sizes in ((shot, sizes) for shot, sizes in shots if shot[1] == scene):
                for size in sizes:
                    camera.aim(size)
                    page.go("about:blank")
                    page.go(f"{url}#{view}")
                    page.until(DASHBOARD if view == "dashboard" else READY)
                    if act is not None:
                        act(page)
                    path = OUT / f"{name}-{size}.png"
                    sys.stdout.write(f"{path.name} {camera.shoot(path)} bytes\n")
                    sys.stdout.flush()
            for problem in page.problems:
                sys.stderr.write(f"{scene}: {problem}\n")
    total = sum(path.stat().st_size for path in OUT.glob("*.png"))
    sys.stdout.write(f"{total} bytes in all, at most {MOST_BYTES}\n")
    return int(total > MOST_BYTES)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
