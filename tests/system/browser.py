"""Headless Chromium, driven by its DevTools protocol over a pipe: no library, and no port that others could use."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.patience import SOON_S

OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run", "--mute-audio",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics card
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--remote-debugging-pipe",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", "--window-size=1200,1600",
)  # fmt: skip


class Page:
    """Its one page."""

    def __init__(self, said: int, heard: int) -> None:
        self._said, self._heard, self._rest, self._last = said, heard, b"", 0
        self._session = ""
        self.requests: list[str] = []
        """Each URL that was asked for."""
        self.problems: list[str] = []
        """Exceptions, errors on its console, and alerts."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Network", "Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Its answer."""
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
        self.call("Page.navigate", url=url)

    def run(self, script: str) -> Any:
        """The value of a script, which may be a promise."""
        found = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def until(self, condition: str) -> None:
        """Returns once that holds on the page."""
        look = f"(() => {{ try {{ return Boolean({condition}); }} catch {{ return false; }} }})()"
        limit_ms = 1000 * SOON_S
        done = self.run(
            f"new Promise((done) => {{ const end = performance.now() + {limit_ms}; const look = () => {look} "
            "? done(true) : performance.now() > end ? done(false) : setTimeout(look, 20); look(); })"
        )
        assert done, f"waited in vain for {condition}; the page: {self.run('document.body.innerText')[:3000]}"

    def press(self, name: str) -> None:
        self.until(f"!document.getElementById('{name}').disabled")
        self.run(f"document.getElementById('{name}').click()")

    def _next(self) -> dict[str, Any]:
        end = time.monotonic() + 2 * SOON_S
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._heard], [], [], max(end - time.monotonic(), 0))
            assert ready, "the browser does not answer"
            part = os.read(self._heard, 1 << 20)
            assert part, "the browser has ended"
            self._rest += part
        message, _, self._rest = self._rest.partition(b"\0")
        return dict(json.loads(message))

    def _note(self, message: dict[str, Any]) -> None:
        params = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(params["request"]["url"])
            case "Runtime.exceptionThrown" | "Page.javascriptDialogOpening":
                self.problems.append(json.dumps(params))
            case "Log.entryAdded" if "Content Security Policy" in params["entry"]["text"]:
                self.problems.append(params["entry"]["text"])
            case _:
                pass


@contextlib.contextmanager
def browsing(folder: Path, *options: str) -> Iterator[Page]:
    """A browser for the time of the block, with these options, too; the test is skipped where there is none."""
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("chromium is not installed: apt-get install chromium")
    its_in, said = os.pipe()
    heard, its_out = os.pipe()
    far = [fcntl.fcntl(one, fcntl.F_DUPFD, 20) for one in (its_in, its_out)]

    def place() -> None:
        os.dup2(far[0], 3)
        os.dup2(far[1], 4)

    command = [chromium, *OPTIONS, *options, f"--user-data-dir={folder}", "about:blank"]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=quiet, stderr=quiet, pass_fds=(3, 4), preexec_fn=place) as process:  # noqa: PLW1509 - it only moves descriptors
        for one in (its_in, its_out, *far):
            os.close(one)
        try:
            yield Page(said, heard)
        finally:
            process.terminate()
            process.wait(SOON_S)
            os.close(said)
            os.close(heard)
