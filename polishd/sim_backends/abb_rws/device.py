"""The process of the controller: HTTP, WebSockets and TLS on one port, its buttons, and reports to the plant."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import os
import signal
import ssl
import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from pathlib import Path

import h11
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from polishd.config.simulator_devices import SimRobotSection
from polishd.config.simulator_faults import MOTION, PANEL
from polishd.sim_backends.abb_rws.controller import WATCH_TASK, AbbController
from polishd.sim_backends.abb_rws.service import (
    RwsAnswer,
    RwsService,
    RwsSession,
    RwsSubscription,
    Version,
    request_of,
)
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire
from polishd.sim_backends.robot.motion import SimRobotBody

USERS: Mapping[str, str] = {"Default User": "robotics", "Admin": "robotics", "admin": "robotics"}
REALM = "validusers@robapi.abb"
MOST_CALLS = 400
"""Requests on one connection; then the controller closes it."""
TICK_S = 0.004
HOME = "controller_home"

# Encryption: a certificate that the controller makes for itself, and TLS over the link's bytes.


def tls_context(folder: Path) -> ssl.SSLContext:
    """Return the settings of an encrypted link, with a new certificate in the folder."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "simulated OmniCore")])
    now = datetime.now(UTC)
    built = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    built = built.serial_number(x509.random_serial_number()).not_valid_before(now - timedelta(days=1))
    certificate = built.not_valid_after(now + timedelta(days=365)).sign(key, hashes.SHA256())
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    public = certificate.public_bytes(serialization.Encoding.PEM)
    (folder / "controller_certificate.pem").write_bytes(public)
    both = folder / "controller_key.pem"
    both.touch(mode=0o600)
    both.write_bytes(private + public)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(both)
    return context


class TlsLayer:
    """TLS of one connection."""

    def __init__(self, context: ssl.SSLContext, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._is_ready = False

    def feed(self, data: bytes) -> bytes:
        """Take received bytes; return those within. ssl.SSLError where they are not TLS."""
        self._incoming.write(data)
        plain = b""
        try:
            if not self._is_ready:
                self._tls.do_handshake()
                self._is_ready = True
            while part := self._tls.read(1 << 16):
                plain += part
        except ssl.SSLWantReadError:  # no more for now: the rest of the record is still to come
            pass
        self._flush()
        return plain

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._tls.write(data)
        self._flush()

    def _flush(self) -> None:
        if self._outgoing.pending:
            self._send(self._outgoing.read())


# The login: digest with a nonce of the controller, or basic.


@dataclass(slots=True)
class LoginCheck:
    """Check of Authorization."""

    version: Version
    nonce: str = field(default_factory=lambda: os.urandom(16).hex())

    @property
    def challenge(self) -> str:
        """Value of WWW-Authenticate."""
        if self.version == "2.0":
            return f'Basic realm="{REALM}"'
        return f'Digest realm="{REALM}", domain="/", nonce="{self.nonce}", algorithm="MD5", qop="auth"'

    def passes(self, method: str, header: str) -> bool:
        """Whether a known user sent it."""
        if self.version == "2.0":
            try:
                user, _, password = base64.b64decode(header.removeprefix("Basic ")).decode().partition(":")
            except ValueError:
                return False
            return USERS.get(user) == password
        if not header.startswith("Digest "):
            return False
        pairs = (part.strip().partition("=")[::2] for part in header[7:].split(","))
        given = {name: value.strip('"') for name, value in pairs}
        user = given.get("username", "")
        if user not in USERS or given.get("nonce") != self.nonce:
            return False
        first = _md5(f"{user}:{REALM}:{USERS[user]}")
        middle = f"{self.nonce}:{given.get('nc')}:{given.get('cnonce')}:auth"
        return given.get("response") == _md5(f"{first}:{middle}:{_md5(method + ':' + given.get('uri', ''))}")


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


# One connection: HTTP, until it becomes a WebSocket.

_ACCEPT = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
PROTOCOLS: Mapping[Version, str] = {"1.0": "robapi2_subscription", "2.0": "rws_subscription"}


def text_frame(text: str) -> bytes:
    """Return a WebSocket frame of a server."""
    payload = text.encode()
    if len(payload) < 126:
        return struct.pack(">BB", 0x81, len(payload)) + payload
    if len(payload) < 1 << 16:
        return struct.pack(">BBH", 0x81, 126, len(payload)) + payload
    return struct.pack(">BBQ", 0x81, 127, len(payload)) + payload


class RwsPeer:
    """A connected client."""

    def __init__(
        self, service: RwsService, login: LoginCheck, send: Callable[[bytes], None], act: Callable[[], None]
    ) -> None:
        self._service = service
        self._login = login
        self._send = send
        self._act = act
        self._http = h11.Connection(h11.SERVER)
        self._session: RwsSession | None = None
        self._subscription: RwsSubscription | None = None
        self._request_under_way: h11.Request | None = None
        self._body = b""
        self._frames = b""
        self._calls = 0

    async def receive(self, data: bytes) -> bool:
        """Act on received bytes; False: the connection is over."""
        if self._subscription is not None:
            self._frames += data
            return self._websocket(self._subscription)
        self._http.receive_data(data)
        try:
            return await self._requests()
        except h11.RemoteProtocolError:
            return False

    def closed(self) -> None:
        """The connection is gone."""
        if self._subscription is not None:
            self._subscription.send = None
        if self._session is not None:
            self._session.connections -= 1
            if self._calls < MOST_CALLS:  # else the controller has closed it, and the session goes on by its cookies
                self._service.left(self._session)

    async def _requests(self) -> bool:
        while True:
            event = self._http.next_event()
            if event is h11.NEED_DATA or event is h11.PAUSED:
                return True
            if isinstance(event, h11.ConnectionClosed):
                return False
            if isinstance(event, h11.Request):
                self._request_under_way, self._body = event, b""
            elif isinstance(event, h11.Data):
                self._body += bytes(event.data)
            elif isinstance(event, h11.EndOfMessage):
                if self._request_under_way is None or not await self._request(self._request_under_way, self._body):
                    return self._subscription is not None
                self._http.start_next_cycle()

    async def _request(self, request: h11.Request, body: bytes) -> bool:
        """Answer a request; False: the connection becomes a WebSocket, or ends."""
        headers = {name.decode().lower(): value.decode("latin-1") for name, value in request.headers}
        method, target = request.method.decode(), request.target.decode("latin-1")
        self._calls += 1
        self._act()
        cookies = dict(part.strip().partition("=")[::2] for part in headers.get("cookie", "").split(";"))
        if target.startswith("/poll/"):
            return self._upgrade(target, headers, cookies.get("ABBCX", ""))
        if not self._login.passes(method, headers.get("authorization", "")):
            self._reply(RwsAnswer(401, headers=(("WWW-Authenticate", self._login.challenge),)))
            return True
        if self._session is None or self._session.cookie not in self._service.sessions:
            self._session = self._service.session(cookies.get("ABBCX", ""))
            if self._session is None:
                self._reply(RwsAnswer(503))
                return False
            self._session.connections += 1
        answer = await self._service.answer(request_of(method, target, headers, body, self._session))
        self._act()
        ends = self._calls >= MOST_CALLS
        cookie = self._session.cookie
        given = (("Set-Cookie", f"-http-session-={cookie}; path=/"), ("Set-Cookie", f"ABBCX={cookie}; path=/"))
        closes = (("Connection", "close"),) if ends else ()
        self._reply(answer, (*given, *closes))
        return not ends

    def _reply(self, answer: RwsAnswer, more: tuple[tuple[str, str], ...] = ()) -> None:
        headers = [("Content-Type", answer.kind), *answer.headers, *more]
        if answer.status != 204:
            headers.append(("Content-Length", str(len(answer.body))))
        parts = [self._http.send(h11.Response(status_code=answer.status, headers=headers))]
        if answer.body:
            parts.append(self._http.send(h11.Data(data=answer.body)))
        parts.append(self._http.send(h11.EndOfMessage()))
        self._send(b"".join(part or b"" for part in parts))

    def _upgrade(self, target: str, headers: Mapping[str, str], cookie: str) -> bool:
        number = target.removeprefix("/poll/")
        found = self._service.subscriptions.get(int(number)) if number.isdigit() else None
        protocols = [one.strip() for one in headers.get("sec-websocket-protocol", "").split(",")]
        known = PROTOCOLS[self._service.version]
        if found is None or found.session.cookie != cookie or known not in protocols:
            self._reply(RwsAnswer(404 if found is None else 400))
            return False
        key = headers.get("sec-websocket-key", "")
        accept = base64.b64encode(hashlib.sha1((key + _ACCEPT).encode(), usedforsecurity=False).digest()).decode()
        upgrade = [("Upgrade", "websocket"), ("Connection", "Upgrade"), ("Sec-WebSocket-Accept", accept)]
        response = h11.InformationalResponse(status_code=101, headers=[*upgrade, ("Sec-WebSocket-Protocol", known)])
        self._send(self._http.send(response) or b"")
        self._session, self._subscription = found.session, found
        self._session.connections += 1
        found.last.clear()
        found.send = lambda text: self._send(text_frame(text))
        self._frames = self._http.trailing_data[0]
        self._service.publish()
        return False

    def _websocket(self, subscription: RwsSubscription) -> bool:
        """Read a client's frames: a ping is answered, a close ends the connection."""
        while len(self._frames) >= 6:
            size, at = self._frames[1] & 0x7F, 2
            if size == 126:
                size, at = int.from_bytes(self._frames[2:4], "big"), 4
            if len(self._frames) < at + 4 + size:
                return True
            code, key = self._frames[0] & 0x0F, self._frames[at : at + 4]
            payload = bytes(b ^ key[k % 4] for k, b in enumerate(self._frames[at + 4 : at + 4 + size]))
            self._frames = self._frames[at + 4 + size :]
            if code == 8:
                self._send(struct.pack(">BB", 0x88, len(payload)) + payload)
                subscription.send = None
                return False
            if code == 9:
                self._send(struct.pack(">BB", 0x8A, len(payload)) + payload)
        return True


class AbbServer:
    """All state of the process."""

    def __init__(self, runtime: SimRuntime) -> None:
        start, robot = runtime.start, runtime.start.config.robot
        self._runtime = runtime
        self._body = SimRobotBody(runtime)
        self.controller = AbbController(robot, self._body.motion, self._body.event, time.monotonic(), start.seed)
        runtime.script.suffer = self.controller.override.suffer
        self._body.blocks_of = self.controller.blocks_of
        folder = start.state / HOME
        folder.mkdir(exist_ok=True)
        self._service = RwsService(self.controller, robot.rws, folder, runtime.boot_id)
        self._login = LoginCheck(robot.rws)
        self._tls = tls_context(start.state) if robot.rws == "2.0" else None
        self._was_active = False
        self._pace = 1.0
        watch = files("polishd.config").joinpath("controller_programs/polishd_watch.mod").read_bytes()
        for _ in self.controller.loading(WATCH_TASK, watch, replace=False):
            pass

    async def run(self) -> None:
        """Cycle until cancelled."""
        while True:
            self.advance()
            await asyncio.sleep(TICK_S)

    def advance(self) -> None:
        """Run up to the present, with events to clients and reports to the plant."""
        now = time.monotonic()
        controller = self.controller
        controller.tick(now)
        if controller.motion.pace != self._pace:
            self._pace = controller.motion.pace
            self._runtime.link.pace(self._pace, now)
        if controller.is_active and not self._was_active:
            self._body.event("motion_started")
        self._body.report()
        if self._was_active and not controller.is_active:
            self._body.event("motion_stopped")
        self._was_active = controller.is_active
        self._service.publish()

    def press(self, button: str) -> None:
        """Do an operator's action at the controller."""
        self.controller.press(button, time.monotonic())

    def connected(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client's bytes."""
        queue: asyncio.Queue[bytes] = asyncio.Queue()
        tls = None if self._tls is None else TlsLayer(self._tls, outlet.send)
        peer = RwsPeer(self._service, self._login, outlet.send if tls is None else tls.write, self.advance)
        task = self._runtime.group.create_task(self._serve(queue, peer, tls))

        def closed() -> None:
            task.cancel()
            peer.closed()

        outlet.on_closed = closed
        return queue.put_nowait

    async def _serve(self, queue: asyncio.Queue[bytes], peer: RwsPeer, tls: TlsLayer | None) -> None:
        while True:
            data = await queue.get()
            try:
                plain = data if tls is None else tls.feed(data)
            except ssl.SSLError as error:
                self._runtime.link.event("tls_error", text=str(error))
                return
            if plain and not await peer.receive(plain):
                return


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    server, robot = AbbServer(runtime), runtime.start.config.robot
    wire = SimWire(runtime, server.connected)
    address = await wire.open_tcp(robot.port)
    runtime.button(signal.SIGUSR1, lambda: server.press("emergency stop"), "estop")
    runtime.button(signal.SIGUSR2, lambda: server.press("manual"), "manual")
    wire.ready(f"tcp://{address}")
    await server.run()


SIM_DEVICES = [
    SimDevice(
        name="abb_rws",
        device="robot",
        section=SimRobotSection,
        links={"abb_rws": {"": "http"}},
        main=main,
        faults=(*MOTION, *PANEL),
    )
]
