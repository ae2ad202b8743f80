"""Drive Firefox with WebDriver BiDi over a WebSocket on loopback: without a library and without a driver process.

It has no WebGL when it is headless: it runs on a virtual display.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import re
import socket
import socketserver
import subprocess
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.system.browser_page import Page
from tests.system.sim_rig import wait_for
from tests.time_limits import SOON_S

NEEDED = {"firefox-esr": "firefox-esr", "Xvfb": "xvfb"}
"""Program names and their Debian packages."""
OPTIONS = ("--no-remote", "--remote-debugging-port=0", "--remote-allow-system-access")
"""Options. The last one permits preferences, which set the preferred colors: BiDi cannot set those."""
PREFERENCES: Mapping[str, bool | int | str] = {
    "ui.prefersReducedMotion": 1,
    "focusmanager.testmode": True,  # without a window manager
    "webgl.force-enabled": True,  # without a graphics card
    "gfx.webrender.software": True,
    "media.cubeb.force_mock_context": True,  # without a sound card
    "browser.shell.checkDefaultBrowser": False,
    "browser.startup.homepage": "about:blank",
    "browser.startup.page": 0,
    "browser.newtabpage.enabled": False,
    "browser.search.update": False,
    "browser.safebrowsing.malware.enabled": False,
    "browser.safebrowsing.phishing.enabled": False,
    "browser.region.network.url": "",
    "app.normandy.enabled": False,
    "app.update.disabledForTesting": True,
    "datareporting.healthreport.uploadEnabled": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "extensions.getAddons.cache.enabled": False,
    "extensions.systemAddon.update.enabled": False,
    "extensions.update.enabled": False,
    "media.gmp-manager.updateEnabled": False,
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
    "network.dns.disablePrefetch": True,
    "network.trr.mode": 5,
    "services.settings.server": "data:,",  # obeyed with ENVIRONMENT only
    "toolkit.telemetry.enabled": False,
    "toolkit.telemetry.server": "",
    # All but loopback goes to a proxy, which notes it: see Outside.
    "network.proxy.type": 1,
    "network.proxy.http": "127.0.0.1",
    "network.proxy.ssl": "127.0.0.1",
    "network.proxy.no_proxies_on": "127.0.0.1, localhost",
    "network.proxy.failover_direct": False,
}
ENVIRONMENT = {
    "MOZ_REMOTE_SETTINGS_DEVTOOLS": "1", "MOZ_CRASHREPORTER_DISABLE": "1",
    "NO_AT_BRIDGE": "1", "DBUS_SESSION_BUS_ADDRESS": "disabled:",  # no other process of a desktop
}  # fmt: skip
DARK = {"dark": 0, "light": 1}
"""Values of the preference layout.css.prefers-color-scheme.content-override."""
KEYS = {
    "Enter": "\ue007", "Escape": "\ue00c", "Tab": "\ue004", "Shift": "\ue008", "Home": "\ue011", "End": "\ue010",
    "ArrowLeft": "\ue012", "ArrowUp": "\ue013", "ArrowRight": "\ue014", "ArrowDown": "\ue015",
}  # fmt: skip
"""Key codes of WebDriver; other keys have their character as code."""
MOUSE = {"down": [{"type": "pointerDown", "button": 0}], "move": [], "up": [{"type": "pointerUp", "button": 0}]}
POLICY = """() => addEventListener("securitypolicyviolation", (event) =>
  console.error("Content Security Policy:", event.effectiveDirective, event.blockedURI))"""
EVENTS = ("network.beforeRequestSent", "log.entryAdded", "browsingContext.userPromptOpened")
# Of a WebSocket's frame.
TEXT, CLOSE, LAST, MASKED = 0x1, 0x8, 0x80, 0x80
TWO_BYTES, EIGHT_BYTES = 126, 127
MASK = b"\1\2\3\4"
"""Any mask except zero: masks protect from proxies, and there is none."""


class WebSocket:
    """WebSocket connection to a server on loopback, for text messages (RFC 6455)."""

    def __init__(self, port: int, path: str) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=2 * SOON_S)
        self._heard = self._socket.makefile("rb")
        key = base64.b64encode(os.urandom(16)).decode()
        head = (
            f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{port}", "Upgrade: websocket", "Connection: Upgrade",
            f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", "", "",
        )  # fmt: skip
        self._socket.sendall("\r\n".join(head).encode())
        answer = [line.strip().decode() for line in iter(self._heard.readline, b"\r\n")]
        assert " 101 " in answer[0], answer

    def send(self, text: str) -> None:
        """Send a text as one masked frame."""
        data = text.encode()
        count = len(data)
        if count < TWO_BYTES:
            length = bytes([MASKED | count])
        elif count < 1 << 16:
            length = bytes([MASKED | TWO_BYTES]) + count.to_bytes(2, "big")
        else:
            length = bytes([MASKED | EIGHT_BYTES]) + count.to_bytes(8, "big")
        repeated = (MASK * (count // len(MASK) + 1))[:count]
        masked = (int.from_bytes(data, "big") ^ int.from_bytes(repeated, "big")).to_bytes(count, "big")
        self._socket.sendall(bytes([LAST | TEXT]) + length + MASK + masked)

    def receive(self) -> str:
        """Return the next text message."""
        text = b""
        while True:
            kind, length = self._read(2)
            if length in {TWO_BYTES, EIGHT_BYTES}:
                length = int.from_bytes(self._read(2 if length == TWO_BYTES else 8), "big")
            data = self._read(length)
            assert kind & 0xF != CLOSE, f"the browser has closed the connection: {data!r}"
            if kind & 0xF > TEXT:
                continue  # a ping
            text += data
            if kind & LAST:
                return text.decode()

    def close(self) -> None:
        """Close the connection."""
        self._heard.close()
        self._socket.close()

    def _read(self, count: int) -> bytes:
        data = self._heard.read(count)
        assert len(data) == count, "the browser has ended"
        return data


class Firefox(Page):
    """Implement the method of Page."""

    def __init__(self, wire: WebSocket) -> None:
        super().__init__()
        self._wire, self._last = wire, 0
        self.call("session.new", capabilities={})
        self._page = self._context("content")
        self._window = self._context("chrome")
        self.call("session.subscribe", events=EVENTS)
        self.call("script.addPreloadScript", functionDeclaration=POLICY)
        # At the start its address field has the focus.
        self._run("window.focus(); gBrowser.selectedBrowser.focus()", self._window)
        self.until("document.hasFocus()")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Implement the method of Page."""
        self._last += 1
        self._wire.send(json.dumps({"id": self._last, "method": method, "params": params}))
        while (answer := json.loads(self._wire.receive())).get("id") != self._last:
            self._note(answer)
        assert answer["type"] == "success", answer
        return dict(answer["result"])

    def go(self, url: str) -> None:
        """Implement the method of Page."""
        self.call("browsingContext.navigate", context=self._page, url=url, wait="interactive")

    def run(self, script: str) -> Any:
        """Implement the method of Page."""
        return self._run(script, self._page)

    def aim(self, width: int, height: int, scheme: str) -> None:
        """Implement the method of Page."""
        viewport = {"width": width, "height": height}
        self.call("browsingContext.setViewport", context=self._page, viewport=viewport, devicePixelRatio=1)
        name = "layout.css.prefers-color-scheme.content-override"
        self._run(f"Services.prefs.setIntPref('{name}', {DARK[scheme]})", self._window)
        self.until(f"innerWidth === {width} && matchMedia('(prefers-color-scheme: {scheme})').matches")

    def key(self, name: str, *, shift: bool = False) -> None:
        """Implement the method of Page."""
        names = [*(["Shift"] if shift else []), name]
        codes = [KEYS.get(one, one) for one in names]
        down = [{"type": "keyDown", "value": one} for one in codes]
        up = [{"type": "keyUp", "value": one} for one in reversed(codes)]
        self._act({"type": "key", "id": "keys", "actions": [*down, *up]})

    def mouse(self, what: str, x: float, y: float) -> None:
        """Implement the method of Page."""
        actions = [_to(x, y), *MOUSE[what]]
        self._act({"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": actions})

    def wheel(self, x: float, y: float, down: float) -> None:
        """Implement the method of Page."""
        turn = {"type": "scroll", "x": round(x), "y": round(y), "deltaX": 0, "deltaY": round(down)}
        self._act({"type": "wheel", "id": "wheel", "actions": [turn]})

    def pinch(self, x: float, y: float, apart: Sequence[float]) -> None:
        """Implement the method of Page."""
        down, up = {"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}
        fingers = []
        for side in (-1, 1):
            first, *rest = [_to(x + side * far, y) for far in apart]
            touch = {"parameters": {"pointerType": "touch"}, "actions": [first, down, *rest, up]}
            fingers.append({"type": "pointer", "id": f"finger {side}", **touch})
        self._act(*fingers)

    def _act(self, *sources: dict[str, Any]) -> None:
        self.call("input.performActions", context=self._page, actions=list(sources))

    def _context(self, scope: str) -> str:
        return str(self.call("browsingContext.getTree", **{"moz:scope": scope})["contexts"][0]["context"])

    def _run(self, script: str, context: str) -> Any:
        found = self.call("script.evaluate", expression=script, target={"context": context}, awaitPromise=True)
        assert found["type"] == "success", found
        return _value(found["result"])

    def _note(self, message: dict[str, Any]) -> None:
        params = message.get("params", {})
        match message.get("method"):
            case "network.beforeRequestSent":
                self._asked(params["request"]["url"])
            case "log.entryAdded" if params["level"] == "error":
                self.problems.append(params["text"])
            case "browsingContext.userPromptOpened":
                self.problems.append(json.dumps(params))
            case _:
                pass


def _to(x: float, y: float) -> dict[str, Any]:
    return {"type": "pointerMove", "x": round(x), "y": round(y)}


def _value(remote: Mapping[str, Any]) -> Any:
    """Return the value of a BiDi result; None for types that JSON does not have."""
    value = remote.get("value")
    match remote["type"]:
        case "number":
            return float(value) if isinstance(value, str) else value
        case "string" | "boolean":
            return value
        case "array":
            return [_value(one) for one in value or ()]
        case "object":
            return {name: _value(one) for name, one in value or ()}
        case _:
            return None


class Outside(socketserver.ThreadingTCPServer):
    """Proxy that refuses and records every request: those to other hosts than loopback."""

    daemon_threads = True
    received: list[str]


class _Refusal(socketserver.StreamRequestHandler):
    server: Outside

    def handle(self) -> None:
        """Record the first line of a request."""
        self.server.received.append(self.rfile.readline(1000).decode(errors="replace").strip())


@contextlib.contextmanager
def outside() -> Iterator[Outside]:
    """Run the proxy for the duration of the block."""
    with Outside(("127.0.0.1", 0), _Refusal) as server:
        server.received = []
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join(SOON_S)


def _port(said: Path) -> int:
    found = re.search(r"WebDriver BiDi listening on ws://127\.0\.0\.1:(\d+)\n", said.read_text(errors="replace"))
    return int(found[1]) if found else 0


@contextlib.contextmanager
def display() -> Iterator[str]:
    """Run a virtual display for the duration of the block; its name."""
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "1600x1200x24", "-nolisten", "tcp", "-noreset"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            number = process.stdout.readline().strip()
            assert number, "Xvfb does not start"
            yield f":{number}"
        finally:
            process.terminate()
            process.wait(SOON_S)


@contextlib.contextmanager
def browsing(folder: Path, options: Sequence[str]) -> Iterator[Firefox]:
    """Run Firefox with these additional options for the block. Requests of the browser itself count as problems."""
    profile, said = folder / "profile", folder / "said.txt"
    profile.mkdir(parents=True)
    with outside() as proxy, display() as screen, said.open("wb") as log:
        port = proxy.server_address[1]
        wanted = {**PREFERENCES, "network.proxy.http_port": port, "network.proxy.ssl_port": port}
        lines = [f"user_pref({json.dumps(name)}, {json.dumps(value)});\n" for name, value in wanted.items()]
        (profile / "user.js").write_text("".join(lines))
        command = ["firefox-esr", *OPTIONS, *options, "--profile", str(profile), "about:blank"]
        env = {**os.environ, "HOME": str(folder), "DISPLAY": screen, **ENVIRONMENT}
        with subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=env) as process:
            try:
                wire = WebSocket(wait_for(lambda: _port(said), "the port of Firefox"), "/session")
                with contextlib.closing(wire):
                    page = Firefox(wire)
                    yield page
                    assert proxy.received == [], f"Firefox itself asks for something outside: {proxy.received}"
            finally:
                process.terminate()
                process.wait(SOON_S)
