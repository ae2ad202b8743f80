"""A page in a headless browser, as the tests use it: the same for each browser, by whatever protocol that one has."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from tests.patience import SOON_S

LOCAL = ("http://127.0.0.1:", "data:", "blob:", "about:")


class Page(ABC):
    """Its one page."""

    def __init__(self) -> None:
        self.requests: list[str] = []
        """Each URL that was asked for."""
        self.problems: list[str] = []
        """Exceptions, errors on its console, alerts, breaches of the content security policy, requests to elsewhere."""

    @abstractmethod
    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Return the answer to a command of the browser's own protocol; what has happened so far is noted."""

    @abstractmethod
    def go(self, url: str) -> None:
        """Load that address."""

    @abstractmethod
    def run(self, script: str) -> Any:
        """Return the value of a script, which may be a promise."""

    @abstractmethod
    def aim(self, width: int, height: int, scheme: str) -> None:
        """Set size in CSS pixels, and the colors that the system prefers ("light", "dark"); nothing moves."""

    @abstractmethod
    def key(self, name: str, *, shift: bool = False) -> None:
        """Press and release a key as a person does: its name in DOM (``"ArrowUp"``, ``"+"``)."""

    @abstractmethod
    def mouse(self, what: str, x: float, y: float) -> None:
        """``"move"`` the mouse there, or put its left button ``"down"`` or ``"up"`` there."""

    @abstractmethod
    def wheel(self, x: float, y: float, down: float) -> None:
        """Turn the mouse's wheel there by so many CSS pixels."""

    @abstractmethod
    def pinch(self, x: float, y: float, apart: Sequence[float]) -> None:
        """Put two fingers on the page, each so far left and right of a place, move them to the next distances, lift."""

    def until(self, condition: str) -> None:
        """Return once that holds on the page."""
        look = f"(() => {{ try {{ return Boolean({condition}); }} catch {{ return false; }} }})()"
        limit_ms = 1000 * SOON_S
        done = self.run(
            f"new Promise((done) => {{ const end = performance.now() + {limit_ms}; const look = () => {look} "
            "? done(true) : performance.now() > end ? done(false) : setTimeout(look, 20); look(); })"
        )
        assert done, f"waited in vain for {condition}; the page: {self.run('document.body.innerText')[:3000]}"

    def press(self, name: str) -> None:
        """Click the element of that id, once it can be."""
        self.until(f"!document.getElementById('{name}').disabled")
        self.run(f"document.getElementById('{name}').click()")

    def _asked(self, url: str) -> None:
        self.requests.append(url)
        if not url.startswith(LOCAL):
            self.problems.append(f"a request to elsewhere: {url}")
