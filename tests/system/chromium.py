"""Drive headless Chromium with its DevTools protocol over a pipe: without a library and without an open port."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import select
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tests.system.browser_page import Page
from tests.time_limits import SOON_S

NEEDED = {"chromium": "chromium"}
"""Program names and their Debian packages."""
OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run", "--mute-audio",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics card
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--remote-debugging-pipe",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", "--window-size=1200,1600",
)  # fmt: skip
KEYS = {
    "Enter": 13, "Escape": 27, "Tab": 9, "Home": 36, "End": 35, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39,
    "ArrowDown": 40, "0": 48, "+": 187, "-": 189,
}  # fmt: skip
"""Virtual key codes of Windows."""
SHIFT = 8
PHONE_PX = 800
"""Width in CSS pixels below which the page is that of a phone."""
MOUSE = {"down": "mousePressed", "move": "mouseMoved", "up": "mouseReleased"}


class Chromium(Page):
    """Implement the method of Page."""

    def __init__(self, said: int, received: int) -> None:
        super().__init__()
        self._said, self._received, self._rest, self._last = said, received, b"", 0
        self._session, self._held = "", False
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Network", "Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Implement the method of Page."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": params}
        os.write(
            self._said,
            json.dumps({**message, **({"sessionId": self._session} if self._session else {})}).encode() + b"\0",
        )
        while (answer := self._next()).get("id") != self._last:
            self._note(answer)
        assert "error" not in answer, answer
        return dict(answer["result"])

    def go(self, url: str) -> None:
        """Implement the method of Page."""
        self.call("Page.navigate", url=url)

    def run(self, script: str) -> Any:
        """Implement the method of Page."""
        found = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def aim(self, width: int, height: int, scheme: str) -> None:
        """Implement the method of Page."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < PHONE_PX}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)
        wanted = {"prefers-color-scheme": scheme, "prefers-reduced-motion": "reduce"}
        self.call("Emulation.setEmulatedMedia", features=[{"name": k, "value": v} for k, v in wanted.items()])

    def key(self, name: str, *, shift: bool = False) -> None:
        """Implement the method of Page."""
        text = {"text": "\r"} if name == "Enter" else {}
        code = {"key": name, "code": name, "windowsVirtualKeyCode": KEYS[name], "modifiers": SHIFT * shift}
        self.call("Input.dispatchKeyEvent", type="keyDown", **code, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", **code)

    def mouse(self, what: str, x: float, y: float) -> None:
        """Implement the method of Page."""
        button = {"button": "left", "clickCount": 1} if self._held or what != "move" else {}
        self._held = what == "down" or (what == "move" and self._held)
        self.call("Input.dispatchMouseEvent", type=MOUSE[what], x=x, y=y, buttons=int(self._held), **button)

    def wheel(self, x: float, y: float, down: float) -> None:
        """Implement the method of Page."""
        self.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=down)

    def pinch(self, x: float, y: float, apart: Sequence[float]) -> None:
        """Implement the method of Page."""
        self.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        for number, far in enumerate(apart):
            points = [{"x": x - far, "y": y, "id": 1}, {"x": x + far, "y": y, "id": 2}]
            self.call("Input.dispatchTouchEvent", type="touchMove" if number else "touchStart", touchPoints=points)
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def _next(self) -> dict[str, Any]:
        end = time.monotonic() + 2 * SOON_S
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._received], [], [], max(end - time.monotonic(), 0))
            assert ready, "the browser does not answer"
            part = os.read(self._received, 1 << 20)
            assert part, "the browser has ended"
            self._rest += part
        message, _, self._rest = self._rest.partition(b"\0")
        return dict(json.loads(message))

    def _note(self, message: dict[str, Any]) -> None:
        params = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self._asked(params["request"]["url"])
            case "Runtime.exceptionThrown" | "Page.javascriptDialogOpening":
                self.problems.append(json.dumps(params))
            case "Runtime.consoleAPICalled" if params["type"] == "error":
                self.problems.append(json.dumps(params))
            case "Log.entryAdded" if "Content Security Policy" in params["entry"]["text"]:
                self.problems.append(params["entry"]["text"])
            case _:
                pass


@contextlib.contextmanager
def browsing(folder: Path, options: Sequence[str]) -> Iterator[Chromium]:
    """Run Chromium with these additional options for the duration of the block."""
    its_in, said = os.pipe()
    received, its_out = os.pipe()
    far = [fcntl.fcntl(one, fcntl.F_DUPFD, 20) for one in (its_in, its_out)]

    def place() -> None:
        os.dup2(far[0], 3)
        os.dup2(far[1], 4)

    command = ["chromium", *OPTIONS, *options, f"--user-data-dir={folder}", "about:blank"]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=quiet, stderr=quiet, pass_fds=(3, 4), preexec_fn=place) as process:  # noqa: PLW1509 - it only moves descriptors
        for one in (its_in, its_out, *far):
            os.close(one)
        try:
            yield Chromium(said, received)
        finally:
            process.terminate()
            process.wait(SOON_S)
            os.close(said)
            os.close(received)
