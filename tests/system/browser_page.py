"""Interface of a page in a headless browser, which each browser implements with its own protocol."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from tests.time_limits import SOON_S

LOCAL = ("http://127.0.0.1:", "data:", "blob:", "about:")


class Page(ABC):
    """The one page of a browser."""

    def __init__(self) -> None:
        self.requests: list[str] = []
        """URLs of all requests."""
        self.problems: list[str] = []
        """Exceptions, console errors, alerts, violations of the content security policy, requests to other hosts."""

    @abstractmethod
    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Return the answer to a command of the browser's protocol, and record the events that arrived before it."""

    @abstractmethod
    def go(self, url: str) -> None:
        """Load that address."""

    @abstractmethod
    def run(self, script: str) -> Any:
        """Return the value of a script, which may be a promise."""

    @abstractmethod
    def aim(self, width: int, height: int, scheme: str) -> None:
        """Set the size in CSS pixels and the preferred colors ("light", "dark"), with reduced motion."""

    @abstractmethod
    def key(self, name: str, *, shift: bool = False) -> None:
        """Press and release a key, by its DOM name (``"ArrowUp"``, ``"+"``)."""

    @abstractmethod
    def mouse(self, what: str, x: float, y: float) -> None:
        """Move the mouse to a point (``"move"``), or press (``"down"``) or release (``"up"``) its left button there."""

    @abstractmethod
    def wheel(self, x: float, y: float, down: float) -> None:
        """Turn the mouse wheel at a point by a number of CSS pixels."""

    @abstractmethod
    def pinch(self, x: float, y: float, apart: Sequence[float]) -> None:
        """Put two fingers on either side of a point at the first distance, move them to the others, and lift them."""

    def until(self, condition: str) -> None:
        """Wait until a script's condition is true on the page."""
        look = f"(() => {{ try {{ return Boolean({condition}); }} catch {{ return false; }} }})()"
        limit_ms = 1000 * SOON_S
        done = self.run(
            f"new Promise((done) => {{ const end = performance.now() + {limit_ms}; const look = () => {look} "
            "? done(true) : performance.now() > end ? done(false) : setTimeout(look, 20); look(); })"
        )
        assert done, f"waited in vain for {condition}; the page: {self.run('document.body.innerText')[:3000]}"

    def press(self, name: str) -> None:
        """Wait until the element with that id is enabled, and click it."""
        self.until(f"!document.getElementById('{name}').disabled")
        self.run(f"document.getElementById('{name}').click()")

    def _asked(self, url: str) -> None:
        self.requests.append(url)
        if not url.startswith(LOCAL):
            self.problems.append(f"a request to elsewhere: {url}")
