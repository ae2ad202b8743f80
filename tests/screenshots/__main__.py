"""`make screenshots`: pictures of each view and state of the page into docs/images/page (names: those alone)."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.screenshots.camera import OPTIONS, SIZES, Camera
from tests.screenshots.frozen_cell import frozen_server
from tests.screenshots.scenes import NIGHT, SCENES, VIEWS, Shot
from tests.system import browser_page
from tests.system.browser import browsing

OUT = Path(__file__).resolve().parents[2] / "docs" / "images" / "page"
MOST_BYTES = 1_500_000
"""Permitted size of all pictures together."""


def main(names: list[str]) -> int:
    """Make the pictures; 1 where they take too much room."""
    browser_page.SOON_S = 40.0  # a picture that does not come lacks something: say it soon
    OUT.mkdir(parents=True, exist_ok=True)
    for scene, shots in _by_scene(set(names)).items():
        with (
            tempfile.TemporaryDirectory() as folder,
            frozen_server(Path(folder), SCENES[scene]) as server,
            browsing(Path(folder) / "browser", *OPTIONS) as page,
        ):
            camera = Camera(page)
            camera.aim("light")
            server.sign_in(page)
            for shot, size in shots:
                camera.aim(size)
                server.show(page, shot.view)
                page.until(shot.ready)
                shot.act(page)
                path = OUT / f"{shot.name}-{size}.png"
                sys.stdout.write(f"{path.name} {camera.shoot(path)} bytes\n")
                sys.stdout.flush()
            for problem in page.problems:
                sys.stderr.write(f"{scene}: {problem}\n")
    total = sum(path.stat().st_size for path in OUT.glob("*.png"))
    sys.stdout.write(f"{total} bytes in all, at most {MOST_BYTES}\n")
    return int(total > MOST_BYTES)


def _by_scene(names: set[str]) -> dict[str, list[tuple[Shot, str]]]:
    """Return the pictures of each scene: all, or those of these views ("held") or pictures ("held-phone")."""
    found: dict[str, list[tuple[Shot, str]]] = {}
    for shot, sizes in [*((shot, tuple(SIZES)) for shot in VIEWS), *((shot, ("phone",)) for shot in NIGHT)]:
        for size in sizes:
            if not names or names & {shot.name, f"{shot.name}-{size}"}:
                found.setdefault(shot.scene, []).append((shot, size))
    return found


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
