"""Robot Web Services 1.0 and 2.0: requests in, answers out; sessions, mastership and subscriptions."""

from __future__ import annotations

import asyncio
import itertools
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, Literal
from urllib.parse import parse_qs, unquote, urlsplit

from polishd.model.errors import ProgramError, ProtocolError
from polishd.sim_backends.abb_rws.controller import AbbController, module_names

Version = Literal["1.0", "2.0"]
State = Mapping[str, Any]
MOST_SESSIONS = 70
FORBIDDEN, BAD, MISSING, LOAD_FAILED = 403, 400, 404, 400
NO_MASTERSHIP, NO_SYMBOL, BAD_VALUE, BAD_STATE, BAD_MODULE, BAD_FILE = (
    -1073445865, -1073442809, -1073414146, -1073442816, -1073442801, -1073414143,
)  # fmt: skip


@dataclass(eq=False, slots=True)
class RwsSession:
    """A client, by its cookies."""

    cookie: str
    connections: int = 0


@dataclass(frozen=True, slots=True)
class RwsRequest:
    """A request."""

    method: str
    path: str
    query: Mapping[str, str]
    values: Mapping[str, list[str]]
    body: bytes
    session: RwsSession
    wants_json: bool
    host: str

    def value(self, name: str, default: str = "") -> str:
        """Return a value of the form."""
        return self.values.get(name, [default])[0]


@dataclass(frozen=True, slots=True)
class RwsAnswer:
    """An answer."""

    status: int
    body: bytes = b""
    kind: str = "application/xhtml+xml"
    headers: tuple[tuple[str, str], ...] = ()


def problem(status: int, code: int, text: str) -> ProtocolError:
    """Return the error of a request that is refused: its text, HTTP status and code."""
    return ProtocolError(text, status, code)


@dataclass(eq=False, slots=True)
class RwsSubscription:
    """A group of resources, and the WebSocket that gets their events."""

    number: int
    resources: tuple[str, ...]
    session: RwsSession
    last: dict[str, str] = field(default_factory=dict)
    send: Callable[[str], None] | None = None


class RwsService:
    """All that answers over HTTP."""

    def __init__(self, controller: AbbController, version: Version, folder: Path, boot_id: str) -> None:
        self.controller = controller
        self.version: Version = version
        self.folder = folder
        self.boot_id = boot_id
        self.sessions: dict[str, RwsSession] = {}
        self.master: RwsSession | None = None
        self.subscriptions: dict[int, RwsSubscription] = {}
        self._numbers = itertools.count(1)
        self._loads = 0

    # sessions

    def session(self, cookie: str) -> RwsSession | None:
        """Return the session of a cookie, or a new one; None if there are too many."""
        found = self.sessions.get(cookie)
        if found is None and len(self.sessions) < MOST_SESSIONS:
            found = RwsSession(f"{self.boot_id}{next(self._numbers)}")
            self.sessions[found.cookie] = found
        return found

    def left(self, session: RwsSession) -> None:
        """End a session whose last connection is closed: its mastership is free."""
        if session.connections > 0:
            return
        self.sessions.pop(session.cookie, None)
        self.subscriptions = {n: one for n, one in self.subscriptions.items() if one.session is not session}
        if self.master is session:
            self.master = None

    # answers

    async def answer(self, request: RwsRequest) -> RwsAnswer:
        """Answer a request."""
        try:
            states = await self._act(request)
        except ProtocolError as refusal:
            return self._refusal(request, *refusal.args)
        if isinstance(states, RwsAnswer):
            return states
        return RwsAnswer(204) if states is None else self._shown(request, states)

    def _shown(self, request: RwsRequest, states: Sequence[State]) -> RwsAnswer:
        if request.wants_json:
            links = {"base": {"href": f"{request.host}/rw/"}}
            found: Any = {"_links": links, "_embedded": {"_state": list(states)}}
            if self.version == "2.0":
                found = {"_links": links, "status": {"code": 294912}, "state": list(states)}
            kind = "application/json" if self.version == "1.0" else "application/hal+json;v=2.0"
            return RwsAnswer(200, json.dumps(found).encode(), kind)
        return RwsAnswer(200, _html("Response", "".join(map(_item, states))))

    def _refusal(self, request: RwsRequest, text: str, http_status: int, code: int) -> RwsAnswer:
        status = {"code": code, "msg": text}
        if request.wants_json:
            found: Any = {"_links": {}, "_embedded": {"status": status}}
            if self.version == "2.0":
                found = {"_links": {}, "status": status}
            kind = "application/json" if self.version == "1.0" else "application/hal+json;v=2.0"
            return RwsAnswer(http_status, json.dumps(found).encode(), kind)
        return RwsAnswer(http_status, _html("Error", _item({"_type": "status", **status}), "status"))

    async def _act(self, request: RwsRequest) -> Sequence[State] | RwsAnswer | None:
        parts = [unquote(part) for part in request.path.strip("/").split("/")]
        match parts:
            case ["fileservice", *rest]:
                return self._files(request, "/".join(rest))
            case ["subscription", *rest]:
                return self._subscription(request, rest)
            case ["logout"]:
                request.session.connections = 0
                self.left(request.session)
                return [{"_type": "user-logout", "_title": "logout"}]
            case ["rw", *rest]:
                return await self._robotware(request, rest)
        raise problem(MISSING, BAD_STATE, f"no resource {request.path}")

    async def _robotware(self, request: RwsRequest, parts: list[str]) -> Sequence[State] | RwsAnswer | None:
        action = request.query.get("action", "")
        if self.version == "2.0" and request.method == "POST":
            parts, action = self._split_action(parts)
        match parts:
            case ["system"]:
                return [self._system()]
            case ["panel", resource]:
                return self._panel(request, resource, action)
            case ["mastership", *_]:
                self._mastership(request, action)
                return None
            case ["elog", *_]:
                return self._log()
            case ["rapid", *rest]:
                return await self._rapid(request, rest, action)
            case ["motionsystem", "mechunits", "ROB_1", "robtarget"]:
                return [self._robtarget()]
            case ["motionsystem", "mechunits", "ROB_1", "jointtarget"]:
                return [self._jointtarget()]
        raise problem(MISSING, BAD_STATE, f"no resource {request.path}")

    @staticmethod
    def _split_action(parts: list[str]) -> tuple[list[str], str]:
        """In 2.0 the action is the last segment of the path, but for what is only written."""
        if parts[-1] in {"data", "speedratio", "ctrl-state"}:
            return parts, {"data": "set", "speedratio": "setspeedratio", "ctrl-state": "setctrlstate"}[parts[-1]]
        return parts[:-1], parts[-1]

    def _system(self) -> State:
        version = "6.15.0" if self.version == "1.0" else "7.10.0"
        return {
            "_type": "sys-system-li" if self.version == "1.0" else "sys-system",
            "_title": "system",
            "name": "simulated IRB",
            "rwversion": version,
            "sysid": "{SIM-ABB-1}",
            "starttm": self.boot_id,
        }

    # panel

    def _panel(self, request: RwsRequest, resource: str, action: str) -> Sequence[State] | None:
        controller = self.controller
        names = {"ctrlstate": "ctrlstate", "ctrl-state": "ctrlstate", "opmode": "opmode", "speedratio": "speedratio"}
        if resource not in names or (resource == "ctrlstate" and self.version == "2.0"):
            raise problem(MISSING, BAD_STATE, f"no resource {request.path}")
        if request.method == "GET":
            name = names[resource]
            return [{"_type": f"pnl-{name}", "_title": name, name: self.panel_value(name)}]
        self._require_free(request)
        if action == "setspeedratio":
            try:
                ratio = float(request.value("speed-ratio"))
            except ValueError:
                ratio = -1.0
            if not 0.0 <= ratio <= 100.0:
                raise problem(BAD, BAD_VALUE, "the speed ratio is 0 to 100")
            controller.ratio = ratio
            return None
        if action == "setctrlstate":
            wanted = request.value("ctrl-state")
            if (
                controller.mode != "AUTO"
                or controller.state == "emergencystop"
                or wanted not in {"motoron", "motoroff"}
            ):
                raise problem(FORBIDDEN, BAD_STATE, f"not possible in state {controller.state}, mode {controller.mode}")
            if wanted == "motoroff":
                controller.stop("motors off")
            controller.state = wanted
            return None
        raise problem(BAD, BAD_STATE, f"no action {action!r}")

    def panel_value(self, name: str) -> str:
        """Return state, mode or speed."""
        controller = self.controller
        return {
            "ctrlstate": controller.state,
            "opmode": controller.mode,
            "speedratio": f"{controller.reported_ratio:.0f}",
        }[name]

    # mastership

    def _mastership(self, request: RwsRequest, action: str) -> None:
        if action == "request":
            self._require_free(request)
            if self.controller.mode != "AUTO":
                raise problem(FORBIDDEN, NO_MASTERSHIP, "no remote mastership in manual mode")
            self.master = request.session
        elif action == "release":
            if self.master is not request.session:
                raise problem(FORBIDDEN, NO_MASTERSHIP, "the client does not hold the mastership")
            self.master = None
        else:
            raise problem(BAD, BAD_STATE, f"no action {action!r}")

    def _require_free(self, request: RwsRequest) -> None:
        if self.master not in {None, request.session}:
            raise problem(FORBIDDEN, NO_MASTERSHIP, "another client holds the mastership")

    def _require_master(self, request: RwsRequest, *, implicit: bool) -> None:
        """In 1.0 a write takes a free mastership for itself; in 2.0 only where the request says so."""
        self._require_free(request)
        allowed = implicit and (self.version == "1.0" or request.query.get("mastership") == "implicit")
        if self.master is None and not allowed:
            raise problem(FORBIDDEN, NO_MASTERSHIP, "the operation needs mastership")

    # RAPID

    async def _rapid(self, request: RwsRequest, parts: list[str], action: str) -> Sequence[State] | None:
        match parts:
            case ["execution"]:
                return self._execution(request, action)
            case ["tasks"]:
                return [self._task(name) for name in self.controller.tasks]
            case ["tasks", task, *rest] if task in self.controller.tasks:
                return await self._in_task(request, task, rest, action)
            case ["modules"]:
                return self._modules(request.query.get("task", "T_ROB1"))
            case ["symbol", "data", "RAPID", task, *path] if self.version == "1.0" and path:
                return self._symbol(request, task, path[-1])
            case ["symbol", "RAPID", task, *path, "data"] if self.version == "2.0" and path:
                return self._symbol(request, task, path[-1])
        raise problem(MISSING, NO_SYMBOL, f"no resource {request.path}")

    def _execution(self, request: RwsRequest, action: str) -> Sequence[State] | None:
        controller = self.controller
        if request.method == "GET":
            return [
                {
                    "_type": "rap-execution",
                    "_title": "execution",
                    "ctrlexecstate": "running" if controller.running else "stopped",
                    "cycle": "once",
                }
            ]
        if action == "start":
            self._require_master(request, implicit=True)
            if request.value("execmode", "continue") != "continue" or request.value("regain") not in {
                "continue",
                "clear",
            }:
                raise problem(BAD, BAD_VALUE, "execmode and regain are needed; only continue is simulated")
            if why := controller.start():
                raise problem(FORBIDDEN, BAD_STATE, why)
        elif action == "stop":
            if not controller.running:
                raise problem(FORBIDDEN, BAD_STATE, "no program runs")
            controller.stop()
        elif action == "resetpp":
            self._require_master(request, implicit=True)
            try:
                controller.reset_pointer()
            except ProgramError as error:
                raise problem(FORBIDDEN, BAD_STATE, str(error.args[0])) from None
        else:
            raise problem(BAD, BAD_STATE, f"no action {action!r}")
        return None

    def _task(self, name: str) -> State:
        moves = name == "T_ROB1"
        runs = self.controller.running if moves else bool(self.controller.tasks[name].modules)
        return {
            "_type": "rap-task-li",
            "_title": name,
            "name": name,
            "type": "normal" if moves else "semistatic",
            "taskstate": "linked",
            "excstate": "started" if runs else "ready",
            "active": "On" if moves else "",
            "motiontask": "TRUE" if moves else "FALSE",
        }

    def _modules(self, task: str) -> Sequence[State]:
        names = module_names(self.controller.tasks, task)
        return [{"_type": "rap-module-info-li", "_title": name, "name": name, "type": "ProgMod"} for name in names]

    async def _in_task(self, request: RwsRequest, task: str, parts: list[str], action: str) -> Sequence[State] | None:
        owner = self.controller.tasks[task]
        if request.method == "GET":
            if parts == ["modules"]:
                return self._modules(task)
            if parts == ["pcp"]:
                place = {"modulename": owner.module, "begposition": f"{owner.line},1", "endposition": f"{owner.line},1"}
                return [{"_type": "pcp-info", "_title": "progpointer", **place}]
            return [self._task(task)]
        if action in {"activate", "deactivate"}:
            return None
        self._require_master(request, implicit=False)
        if action == "loadmod":
            await self._load(request, task)
        elif action == "unloadmod" and request.value("module").lower() in owner.modules:
            owner.unload(request.value("module"))
        else:
            raise problem(BAD, BAD_MODULE, f"{action} of {request.value('module')!r} is not possible")
        return None

    async def _load(self, request: RwsRequest, task: str) -> None:
        path = self._path(request.value("modulepath"))
        if path is None or not path.is_file():
            raise problem(BAD, BAD_FILE, f"no file {request.value('modulepath')}")
        text = path.read_bytes()
        try:
            for _ in self.controller.loading(task, text, replace=request.value("replace") == "true"):
                await asyncio.sleep(0)  # other clients have their turn
        except ProgramError as error:
            place = f"{path.name} line {error.args[1]}: " if error.args[1] else ""
            self.controller.note(40160, f"{place}{error.args[0]}")
            raise problem(LOAD_FAILED, BAD_MODULE, f"{place}{error.args[0]}") from None

    def _symbol(self, request: RwsRequest, task: str, name: str) -> Sequence[State] | None:
        value = self.controller.read(task, name)
        if value is None:
            raise problem(BAD, NO_SYMBOL, f"symbol {task}/{name} not found")
        if request.method == "GET":
            return [{"_type": "rap-data", "_title": f"RAPID/{task}/{name}", "value": value}]
        self._require_master(request, implicit=True)
        if why := self.controller.write(task, name, request.value("value")):
            raise problem(BAD, BAD_VALUE, why)
        return None

    def _robtarget(self) -> State:
        position, turn = self.controller.robtarget()
        values = dict(zip(("x", "y", "z", "q1", "q2", "q3", "q4"), (*position, *turn), strict=True))
        zeros = dict.fromkeys(("cf1", "cf4", "cf6", "cfx"), "0") | dict.fromkeys((f"eax{a}" for a in "abcdef"), "9E+09")
        shown = {name: f"{value:.6f}" for name, value in values.items()}
        return {"_type": "ms-robtargets", "_title": "ROB_1", **shown, **zeros}

    def _jointtarget(self) -> State:
        """Return the joint angles. The plant has none: five change with the pose, as those of an arm do."""
        joints = dict(
            zip((f"rax_{number}" for number in range(1, 7)), (*self.controller.motion.pose, 0.0), strict=True)
        )
        shown = {name: f"{value:.6f}" for name, value in joints.items()}
        return {
            "_type": "ms-jointtarget",
            "_title": "ROB_1",
            **shown,
            **dict.fromkeys((f"eax_{a}" for a in "abcdef"), "9E+09"),
        }

    def _log(self) -> Sequence[State]:
        def entry(number: int, code: int, text: str) -> State:
            empty = dict.fromkeys(("conseqs", "causes", "actions"), "")
            about = {
                "msgtype": "1",
                "code": str(code),
                "src-name": "sim",
                "tstamp": "2026-01-01 T  00:00:00",
                "argc": "0",
            }
            return {
                "_type": "elog-message-li",
                "_title": f"/rw/elog/0/{number}",
                **about,
                "title": text,
                "desc": text,
                **empty,
            }

        return [entry(number, *logged) for number, logged in enumerate(self.controller.log, 1)][::-1]

    # files

    def _path(self, name: str) -> Path | None:
        """Return a file in the controller's home folder."""
        plain = re.sub(r"^(?:\$HOME|HOME:)/*", "", name, flags=re.IGNORECASE)
        return self.folder / plain if plain and plain == Path(plain).name else None

    def _files(self, request: RwsRequest, name: str) -> Sequence[State] | RwsAnswer | None:
        if request.method == "GET" and re.fullmatch(r"(?:\$HOME|HOME:)?/*", name, flags=re.IGNORECASE):
            return [{"_type": "fs-file", "_title": path.name} for path in sorted(self.folder.iterdir())]
        path = self._path(name)
        if path is None:
            raise problem(BAD, BAD_FILE, f"{name!r} is no file of $HOME")
        if request.method == "PUT":
            path.write_bytes(request.body)
            return RwsAnswer(201)
        if not path.is_file():
            raise problem(MISSING, BAD_FILE, f"no file {name}")
        if request.method == "DELETE":
            path.unlink()
            return None
        return RwsAnswer(200, path.read_bytes(), "application/octet-stream")

    # subscriptions

    def _subscription(self, request: RwsRequest, parts: list[str]) -> RwsAnswer | None:
        if request.method == "DELETE" and parts and parts[0].isdigit():
            if self.subscriptions.pop(int(parts[0]), None) is None:
                raise problem(MISSING, BAD_VALUE, "no such subscription")
            return None
        if request.method != "POST":
            raise problem(BAD, BAD_STATE, "POST a subscription")
        resources = tuple(request.value(number) for number in request.values.get("resources", []))
        for resource in resources:
            if not resource or self.resource_value(resource) is None:
                raise problem(BAD, NO_SYMBOL, f"{resource!r} cannot be subscribed")
        number = next(self._numbers)
        self.subscriptions[number] = RwsSubscription(number, resources, request.session)
        scheme = "ws" if self.version == "1.0" else "wss"
        url = f"{scheme}://{request.host}/poll/{number}"
        links = f'<a href="subscription/{number}" rel="group"/><a href="{url}" rel="self"></a>'
        return RwsAnswer(201, _html("Event", "", links=links), headers=(("Location", url),))

    def resource_value(self, resource: str) -> str | None:
        """Return the present value of what can be subscribed."""
        path, _, _ = resource.partition(";")
        if path == "/rw/rapid/execution":
            return "running" if self.controller.running else "stopped"
        panel = {"/rw/panel/ctrlstate": "1.0", "/rw/panel/ctrl-state": "2.0"}
        if panel.get(path, self.version) == self.version and path.startswith("/rw/panel/"):
            name = path.rpartition("/")[2].replace("-", "")
            return self.panel_value(name) if name in {"ctrlstate", "opmode", "speedratio"} else None
        pattern = r"/rw/rapid/symbol/data/RAPID/(\w+)/(?:\w+/)?(\w+)"
        if self.version == "2.0":
            pattern = r"/rw/rapid/symbol/RAPID/(\w+)/(?:\w+/)?(\w+)/data"
        match = re.fullmatch(pattern, path)
        return self.controller.read(match[1], match[2]) if match is not None else None

    def publish(self) -> None:
        """Send the events of all that has changed since the last call."""
        for one in self.subscriptions.values():
            if one.send is None:
                continue
            items = ""
            for resource in one.resources:
                value = self.resource_value(resource)
                if value is not None and one.last.get(resource) != value:
                    one.last[resource] = value
                    items += _event(resource, value)
            if items:
                links = f'<a href="subscription/{one.number}" rel="group"/>'
                one.send(_html("Event", items, links=links).decode())


def request_of(method: str, target: str, headers: Mapping[str, str], body: bytes, session: RwsSession) -> RwsRequest:
    """Return a request."""
    url = urlsplit(target)
    query = {name: values[0] for name, values in parse_qs(url.query, keep_blank_values=True).items()}
    is_form = "form" in headers.get("content-type", "") or (method == "POST" and b"=" in body)
    values = parse_qs(body.decode("latin-1"), keep_blank_values=True) if is_form else {}
    wants_json = query.get("json") == "1" or "json" in headers.get("accept", "")
    return RwsRequest(method, url.path, query, values, body, session, wants_json, headers.get("host", "localhost"))


def _html(title: str, items: str, kind: str = "state", links: str = "") -> bytes:
    return (
        '<?xml version="1.0" encoding="utf-8"?><html xmlns="http://www.w3.org/1999/xhtml"><head>'
        f'<title>{title}</title></head><body><div class="{kind}">{links}<ul>{items}</ul></div></body></html>'
    ).encode()


def _item(state: State) -> str:
    spans = "".join(
        f'<span class="{escape(name)}">{escape(str(value))}</span>'
        for name, value in state.items()
        if not name.startswith("_")
    )
    return f'<li class="{escape(str(state["_type"]))}" title="{escape(str(state.get("_title", "")))}">{spans}</li>'


def _event(resource: str, value: str) -> str:
    path, _, what = resource.partition(";")
    kind, span = "rap-data", "value"
    if path == "/rw/rapid/execution":
        kind, span = "rap-ctrlexecstate-ev", "ctrlexecstate"
    elif path.startswith("/rw/panel/"):
        span = path.rpartition("/")[2].replace("-", "")
        kind = f"pnl-{span}-ev"
    link = f'<a href="{resource}" rel="self"/>'
    return f'<li class="{kind}" title="{what}">{link}<span class="{span}">{escape(value)}</span></li>'
