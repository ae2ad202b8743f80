"""The services of a controller that the driver uses, in both versions of Robot Web Services."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import ssl
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from polishd.api import DeviceRefused, LinkError, ProtocolError
from polishd.drivers.abb_rws.http_link import EventStream, HttpAnswer, HttpLink, Login, form
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import RequestQueue

Version = Literal["1.0", "2.0"]
LOAD_S, BYTES_S = 10.0, 2e5
"""Longest time to load a module, and the least rate at which the controller takes one."""


@dataclass(frozen=True, slots=True)
class Account:
    """Where the controller is, and who logs in."""

    address: Tcp
    version: Version
    user: str
    password: str
    tls: ssl.SSLContext | None = None


@dataclass(frozen=True, slots=True)
class Symbol:
    """A variable of a task."""

    task: str
    module: str
    name: str

    @property
    def path(self) -> str:
        """As in a URL."""
        return f"{self.task}/{self.module}/{self.name}"


def _newer(old: str, new: str) -> Mapping[Version, str]:
    return {"1.0": old, "2.0": new}


EXECUTION = _newer("/rw/rapid/execution;ctrlexecstate", "/rw/rapid/execution;ctrlexecstate")
CTRL_STATE = _newer("/rw/panel/ctrlstate", "/rw/panel/ctrl-state")
MODE = "/rw/panel/opmode"
SPEED = "/rw/panel/speedratio"
START = {
    "regain": "continue", "execmode": "continue", "cycle": "once", "condition": "none", "stopatbp": "disabled",
    "alltaskbytsp": "false",
}  # fmt: skip
JOINTS = (*(f"rax_{number}" for number in range(1, 7)), *(f"eax_{letter}" for letter in "abcdef"))
"""An external axis that a robot does not have is 9E9."""
STOP = {"stopmode": "stop", "usetsp": "normal"}


class RwsServices:
    """One session: requests one after the other, a stop before all that wait, and the events of one subscription."""

    def __init__(self, account: Account, silence_s: float) -> None:
        self._account = account
        self.version: Version = account.version
        self._name = str(account.address)
        login = Login(account.user, account.password, digest=account.version == "1.0")
        self._http = HttpLink(account.address, login, silence_s, account.tls)
        self._queue = RequestQueue(self._name)
        self.events: EventStream | None = None
        self._group = ""

    async def open(self) -> None:
        """Connect and log in by a first request."""
        await self._http.open()
        await self._queue.start()
        await self.get("/rw/system")

    async def close(self) -> None:
        """End the session; idempotent. A controller has 70 sessions, so a living one is logged out."""
        if self.events is not None:
            await self.events.stop()
            self.events = None
        if self._queue.running:
            with contextlib.suppress(LinkError, ProtocolError, DeviceRefused, TimeoutError):
                async with asyncio.timeout(0.3):
                    if self._group:
                        await self._ask("DELETE", self._group)
                    await self._ask("GET", "/logout")
        await self._queue.stop()
        await self._http.close()

    async def get(self, path: str) -> Mapping[str, Any]:
        """Read a resource: its first state."""
        answer = await self._ask("GET", path if self.version == "2.0" else f"{path}?json=1")
        return self._state(path, answer)

    async def execution(self) -> bool:
        """Whether the controller runs its normal tasks."""
        state = str((await self.get("/rw/rapid/execution")).get("ctrlexecstate", ""))
        if state not in {"running", "stopped"}:
            raise ProtocolError(f"{self._name}: the execution state is {state!r}, neither running nor stopped")
        return state == "running"

    async def panel(self, path: str) -> str:
        """Read the controller's state, mode or speed."""
        state, key = await self.get(path), path.rpartition("/")[2].replace("-", "")
        if key not in state:
            raise ProtocolError(f"{self._name}: the answer to {path} has no {key}")
        return str(state[key])

    async def joints(self, unit: str) -> tuple[float, ...]:
        """Read the measured joint angles of a mechanical unit and of its external axes, (12,) deg or mm."""
        path = f"/rw/motionsystem/mechunits/{unit}/jointtarget"
        try:
            state = await self.get(path)
        except DeviceRefused as refusal:
            raise DeviceRefused(f"{refusal}. Correct robot.mechanical_unit, {unit}.") from None
        try:
            joints = tuple(float(state[name]) for name in JOINTS)
        except (KeyError, TypeError, ValueError):
            raise ProtocolError(f"{self._name}: the answer to {path} has no joint angles") from None
        if not all(map(math.isfinite, joints)):
            raise ProtocolError(f"{self._name}: the answer to {path} has a joint angle that is no number")
        return joints

    async def value(self, symbol: Symbol) -> str:
        """Read a variable, as RAPID writes its value. DeviceRefused if the controller does not have it.

        An answer names its variable, with or without the module; some controllers leave the name out.
        """
        old, new = f"/rw/rapid/symbol/data/RAPID/{symbol.path}", f"/rw/rapid/symbol/RAPID/{symbol.path}/data"
        state = await self.get(old if self.version == "1.0" else new)
        title = str(state.get("_title", symbol.name))
        if "value" not in state or title.rpartition("/")[2].lower() != symbol.name.lower():
            raise ProtocolError(f"{self._name}: the answer to {symbol.path} is another request's: {title}")
        return str(state["value"])

    async def write(self, symbol: Symbol, value: str) -> None:
        """Write a variable."""
        if self.version == "1.0":
            await self._post(f"/rw/rapid/symbol/data/RAPID/{symbol.path}?action=set", {"value": value})
        else:
            await self._post(f"/rw/rapid/symbol/RAPID/{symbol.path}/data?mastership=implicit", {"value": value})

    async def start(self, is_wanted: Callable[[], bool]) -> None:
        """Start or continue, if that is still wanted when the request's turn comes."""
        old, new = "/rw/rapid/execution?action=start", "/rw/rapid/execution/start?mastership=implicit"
        await self._post(old if self.version == "1.0" else new, START, is_wanted=is_wanted)

    async def stop(self) -> None:
        """Stop along the path, before all requests that wait. No error if nothing runs."""
        old, new = "/rw/rapid/execution?action=stop", "/rw/rapid/execution/stop"
        with contextlib.suppress(DeviceRefused):  # refused if nothing runs: the state decides
            await self._post(old if self.version == "1.0" else new, STOP, urgent=True)

    async def upload(self, path: str, content: bytes) -> None:
        """Write a file of the controller."""
        kind = "application/octet-stream" + (";v=2.0" if self.version == "2.0" else "")
        within_s = LOAD_S + len(content) / BYTES_S
        self._require(path, await self._ask("PUT", f"/fileservice/{path}", content, kind, within_s=within_s))

    async def load(self, task: str, path: str, size: int) -> None:
        """Load a module in place of the one with its name, and set the program pointer to main."""
        domain = "rapid" if self.version == "1.0" else "edit"
        tail = "?action=" if self.version == "1.0" else "/"
        await self._post(f"/rw/mastership/{domain}{tail}request", {})
        try:
            values = {"modulepath": path, "replace": "true"}
            within_s = LOAD_S + size / BYTES_S
            await self._post(f"/rw/rapid/tasks/{task}{tail}loadmod", values, within_s=within_s)
            await self._post(f"/rw/rapid/execution{tail}resetpp", {})
        finally:
            with contextlib.suppress(DeviceRefused):  # it is held no more, where the controller has ended the session
                await self._post(f"/rw/mastership/{domain}{tail}release", {})

    async def subscribe(self, symbols: tuple[Symbol, ...]) -> EventStream:
        """Subscribe to variables, execution state, mode and speed; opens the stream of events."""
        old = self.version == "1.0"
        where = "/rw/rapid/symbol/data/RAPID/{};value" if old else "/rw/rapid/symbol/RAPID/{}/data;value"
        resources = [(where.format(symbol.path), 2) for symbol in symbols]
        resources += [(path, 1) for path in (EXECUTION[self.version], CTRL_STATE[self.version], MODE, SPEED)]
        values: dict[str, str] = {}
        for number, (resource, priority) in enumerate(resources, 1):
            values |= {str(number): resource, f"{number}-p": str(priority)}
        body = "&".join(f"resources={number}" for number in range(1, len(resources) + 1)).encode()
        answer = await self._ask("POST", "/subscription", body + b"&" + form(values))
        self._require("/subscription", answer)
        key = answer.headers.get("location", "").partition("/poll/")[2] or _between(answer.body, "/poll/", '"')
        if answer.status != 201 or not key:
            raise ProtocolError(f"{self._name}: the answer to a subscription names no WebSocket")
        self._group = f"/subscription/{key}"
        protocol = "robapi2_subscription" if old else "rws_subscription"
        self.events = EventStream(self._http, f"/poll/{key}", protocol, self._account.tls)
        await self.events.start(self.events.run, within_s=2.0)
        return self.events

    async def _post(
        self,
        path: str,
        values: Mapping[str, object],
        *,
        urgent: bool = False,
        within_s: float = 0.0,
        is_wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        answer = await self._ask("POST", path, form(values), urgent=urgent, within_s=within_s, is_wanted=is_wanted)
        self._require(path, answer)

    async def _ask(
        self,
        method: str,
        path: str,
        body: bytes = b"",
        kind: str = "",
        *,
        urgent: bool = False,
        within_s: float = 0.0,
        is_wanted: Callable[[], bool] = lambda: True,
    ) -> HttpAnswer:
        suffix = ";v=2.0" if self.version == "2.0" else ""
        headers = {"Accept": f"application/hal+json{suffix}"} if suffix else {"Accept": "*/*"}
        if method == "POST" or kind:
            headers["Content-Type"] = kind or f"application/x-www-form-urlencoded{suffix}"

        async def work() -> HttpAnswer:
            if not is_wanted():
                return HttpAnswer(204, {}, b"")
            return await self._http.request(method, path, headers, body, within_s)

        return await self._queue.ask(work, urgent=urgent)

    def _require(self, path: str, answer: HttpAnswer) -> None:
        """DeviceRefused with the controller's code and message unless the answer is a success."""
        if 200 <= answer.status < 300:
            return
        code, text = _problem(answer.body)
        if answer.status >= 500 and not code:
            raise LinkError(f"{self._name}: {path}: HTTP {answer.status}. Check the controller.")
        raise DeviceRefused(f"{self._name}: {path.partition('?')[0]}: {text or f'HTTP {answer.status}'}{code}")

    def _state(self, path: str, answer: HttpAnswer) -> Mapping[str, Any]:
        self._require(path, answer)
        try:
            found = json.loads(answer.body)
            states = found["state"] if self.version == "2.0" else found["_embedded"]["_state"]
            state = states[0]
        except (ValueError, LookupError, TypeError):
            raise ProtocolError(f"{self._name}: {path}: the answer has no state. Check [robot] version.") from None
        if not isinstance(state, dict):
            raise ProtocolError(f"{self._name}: {path}: the state is not a table")
        return state


def _between(body: bytes, begin: str, end: str) -> str:
    return body.decode("utf-8", "replace").partition(begin)[2].partition(end)[0]


def _problem(body: bytes) -> tuple[str, str]:
    """Return (" (code)", message) of an error's body, JSON or XML."""
    text = body.decode("utf-8", "replace")
    try:
        found = json.loads(text)
        status = found.get("status") or found["_embedded"]["status"]
        code, message = str(status.get("code", "")), str(status.get("msg", ""))
    except (ValueError, LookupError, TypeError, AttributeError):
        code, message = _between(body, 'class="code">', "<"), _between(body, 'class="msg">', "<")
    return (f" ({code})" if code else ""), message.strip()
