"""HTTP/1.1 and WebSocket over one stream each: what Robot Web Services needs, with digest or basic authentication."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import os
import re
import ssl
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import urlencode

import h11

from polishd.api import DeviceRefused, LinkError, ProtocolError
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.streams import open_stream
from polishd.interfaces import ByteStream

MOST_BYTES = 4 << 20
"""Largest answer, and largest event."""
_PAIR = re.compile(r'(\w+)\s*=\s*(?:"([^"]*)"|([^\s,]+))')


@dataclass(frozen=True, slots=True)
class HttpAnswer:
    """An answer of the controller."""

    status: int
    headers: Mapping[str, str]
    body: bytes


@dataclass(slots=True)
class Login:
    """A user, and the controller's last challenge."""

    user: str
    password: str
    digest: bool
    _challenge: dict[str, str] = field(default_factory=dict)
    _count: int = 0

    def challenged(self, header: str) -> bool:
        """Take the challenge of a 401; False if there is none to answer."""
        if not self.digest or not header.lower().startswith("digest"):
            return False
        self._challenge = {name.lower(): quoted or bare for name, quoted, bare in _PAIR.findall(header[6:])}
        self._count = 0
        return "nonce" in self._challenge

    def header(self, method: str, path: str) -> str:
        """Return the value of Authorization; empty before the first challenge."""
        if not self.digest:
            return "Basic " + base64.b64encode(f"{self.user}:{self.password}".encode()).decode()
        if not self._challenge:
            return ""
        self._count += 1
        realm, nonce = self._challenge.get("realm", ""), self._challenge["nonce"]
        count, cnonce = f"{self._count:08x}", os.urandom(8).hex()
        first, second = _md5(f"{self.user}:{realm}:{self.password}"), _md5(f"{method}:{path}")
        fields = {"username": self.user, "realm": realm, "nonce": nonce, "uri": path}
        bare = {}
        if "auth" in self._challenge.get("qop", ""):
            response = _md5(f"{first}:{nonce}:{count}:{cnonce}:auth:{second}")
            bare, fields["cnonce"] = {"qop": "auth", "nc": count}, cnonce
        else:
            response = _md5(f"{first}:{nonce}:{second}")
        fields["response"] = response
        if "opaque" in self._challenge:
            fields["opaque"] = self._challenge["opaque"]
        parts = [*(f'{name}="{value}"' for name, value in fields.items()), *(f"{n}={v}" for n, v in bare.items())]
        return "Digest " + ", ".join(parts)


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


class HttpLink:
    """One connection that is kept; one request at a time. It keeps the session's cookies."""

    def __init__(self, address: Tcp, login: Login, silence_s: float, tls: ssl.SSLContext | None) -> None:
        self.address = address
        self.cookies: dict[str, str] = {}
        self.login = login
        self._silence_s = silence_s
        self._tls = tls
        self._stream: ByteStream | None = None
        self._http = h11.Connection(h11.CLIENT)
        self._is_over = False
        """The controller has announced that it closes the connection."""

    async def open(self) -> None:
        """Connect."""
        self._stream = await open_stream(self.address, self._silence_s, self._tls)
        self._http, self._is_over = h11.Connection(h11.CLIENT), False

    async def close(self) -> None:
        """Disconnect; idempotent."""
        stream, self._stream = self._stream, None
        if stream is not None:
            await stream.close()

    async def request(
        self, method: str, path: str, headers: Mapping[str, str], body: bytes = b"", within_s: float = 0.0
    ) -> HttpAnswer:
        """Send a request and return its answer; a challenge is answered once. LinkError without an answer in time."""
        answer = await self._once(method, path, headers, body, within_s or self._silence_s)
        if answer.status == 401 and self.login.challenged(answer.headers.get("www-authenticate", "")):
            answer = await self._once(method, path, headers, body, within_s or self._silence_s)
        if answer.status == 401:
            raise DeviceRefused(
                f"{self.address}: the controller refuses user {self.login.user!r}. Correct user and password."
            )
        return answer

    async def _once(
        self, method: str, path: str, headers: Mapping[str, str], body: bytes, within_s: float
    ) -> HttpAnswer:
        if self._is_over:  # the controller ends a connection after some hundred requests
            await self.close()
            await self.open()
        if self._stream is None:
            raise LinkError(f"{self.address}: is not open")
        early = self._http.trailing_data[0]
        with contextlib.suppress(LinkError):  # nothing came, as it should be; a dead link fails at the write
            early += await self._stream.read(1 << 16, 0.0)
        if early:  # the next answer would be taken for another request's
            raise ProtocolError(f"{self.address}: {len(early)} bytes came without a request")
        sent = {"Host": f"{self.address.host}:{self.address.port}", **headers, "Content-Length": str(len(body))}
        if self.cookies:
            sent["Cookie"] = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        if authorization := self.login.header(method, path):
            sent["Authorization"] = authorization
        try:
            request = h11.Request(method=method, target=path, headers=list(sent.items()))
            data = b"".join(
                part or b"" for part in map(self._http.send, (request, h11.Data(data=body), h11.EndOfMessage()))
            )
            await self._stream.write(data)
            return await self._answer(self._stream, time.monotonic() + within_s)
        except h11.ProtocolError as error:
            raise ProtocolError(f"{self.address}: the answer to {method} {path} is not HTTP: {error}") from error

    async def _answer(self, stream: ByteStream, deadline: float) -> HttpAnswer:
        status, headers, body = 0, dict[str, str](), bytearray()
        while True:
            event = self._http.next_event()
            if event is h11.NEED_DATA:
                self._http.receive_data(await stream.read(1 << 16, max(deadline - time.monotonic(), 0.0)))
            elif isinstance(event, h11.Response):
                status = event.status_code
                headers = {name.decode().lower(): value.decode("latin-1") for name, value in event.headers}
                self._keep_cookies([value.decode("latin-1") for name, value in event.headers if name == b"set-cookie"])
            elif isinstance(event, h11.Data):
                body += event.data
                if len(body) > MOST_BYTES:
                    raise ProtocolError(f"{self.address}: an answer of more than {MOST_BYTES} bytes")
            elif isinstance(event, h11.EndOfMessage):
                self._is_over = headers.get("connection", "").lower() == "close"
                if not self._is_over:
                    self._http.start_next_cycle()
                return HttpAnswer(status, headers, bytes(body))
            else:
                raise LinkError(f"{self.address}: the controller closed the connection")

    def _keep_cookies(self, given: list[str]) -> None:
        for one in given:
            name, _, value = one.partition(";")[0].partition("=")
            self.cookies[name.strip()] = value.strip()


def form(values: Mapping[str, object]) -> bytes:
    """Return the body of a form."""
    return urlencode({name: str(value) for name, value in values.items()}, safe="$/;").encode()


# The events of a subscription: a WebSocket (RFC 6455) on which the controller sends.

_ACCEPT = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
_CONTINUES, _TEXT, _BINARY, _CLOSE, _PING, _PONG = 0, 1, 2, 8, 9, 10
_VALUE = re.compile(r'<li\s+class="([\w-]+)"[^>]*>(.*?)</li>', re.DOTALL)
_HREF = re.compile(r'href="([^"]*)"')
_SPAN = re.compile(r'<span\s+class="([\w-]+)"[^>]*>([^<]*)</span>')


class EventStream(Background):
    """The WebSocket of a subscription: the last value of each resource, and how many events came."""

    def __init__(self, link: HttpLink, path: str, protocol: str, tls: ssl.SSLContext | None) -> None:
        super().__init__(str(link.address))
        self._link = link
        self._path = path
        self._protocol = protocol
        self._tls = tls
        self.events: list[tuple[str, str]] = []
        """(resource, value) of events that were not taken yet, oldest first."""

    def take(self) -> list[tuple[str, str]]:
        """Return the events since the last call."""
        taken, self.events = self.events, []
        return taken

    async def run(self, ready: Ready) -> None:
        """Read events until cancelled; LinkError at the end of the connection."""
        stream = await open_stream(self._link.address, 1.0, self._tls)
        try:
            reader = _FrameReader(stream, await self._upgrade(stream))
            ready()
            text = bytearray()
            while True:
                final, code, payload = await reader.next()
                if code == _PING:
                    await stream.write(_masked(_PONG, payload))
                elif code == _CLOSE:
                    raise LinkError(f"{self.name}: the controller ended the subscription")
                elif code in (_CONTINUES, _TEXT, _BINARY):
                    text += payload
                    if len(text) > MOST_BYTES:
                        raise ProtocolError(f"{self.name}: an event of more than {MOST_BYTES} bytes")
                    if final:
                        self.events += events_of(text.decode("utf-8", "replace"))
                        text.clear()
                        self.fire()
        finally:
            await stream.close()

    async def _upgrade(self, stream: ByteStream) -> bytes:
        """Change the connection to a WebSocket; return bytes that came behind the answer."""
        key = base64.b64encode(os.urandom(16)).decode()
        headers = {
            "Host": f"{self._link.address.host}:{self._link.address.port}",
            "Upgrade": "websocket",
            "Connection": "Upgrade",
            "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": key,
            "Sec-WebSocket-Protocol": self._protocol,
            "Cookie": "; ".join(f"{name}={value}" for name, value in self._link.cookies.items()),
            "Authorization": self._link.login.header("GET", self._path),
        }
        http = h11.Connection(h11.CLIENT)
        request = h11.Request(method="GET", target=self._path, headers=list(headers.items()))
        await stream.write((http.send(request) or b"") + (http.send(h11.EndOfMessage()) or b""))
        try:
            while (event := http.next_event()) is h11.NEED_DATA:
                http.receive_data(await stream.read(1 << 16, 1.0))
        except h11.ProtocolError as error:
            raise ProtocolError(f"{self.name}: the subscription's answer is not HTTP: {error}") from error
        given = dict(event.headers) if isinstance(event, h11.InformationalResponse) else {}
        want = base64.b64encode(hashlib.sha1((key + _ACCEPT).encode(), usedforsecurity=False).digest())
        if given.get(b"sec-websocket-accept") != want:
            raise LinkError(f"{self.name}: the controller does not open the subscription's WebSocket")
        return http.trailing_data[0]


class _FrameReader:
    def __init__(self, stream: ByteStream, rest: bytes) -> None:
        self._stream = stream
        self._bytes = bytearray(rest)

    async def next(self) -> tuple[bool, int, bytes]:
        """Return (final, opcode, payload) of the next frame; waits for it without a limit."""
        head = await self._take(2)
        size = head[1] & 0x7F
        if size >= 126:
            size = int.from_bytes(await self._take(2 if size == 126 else 8), "big")
        if size > MOST_BYTES:
            raise ProtocolError(f"a WebSocket frame of {size} bytes")
        key = await self._take(4) if head[1] & 0x80 else b""
        payload = await self._take(size)
        return bool(head[0] & 0x80), head[0] & 0x0F, _mask(payload, key) if key else payload

    async def _take(self, count: int) -> bytes:
        while len(self._bytes) < count:
            self._bytes += await self._stream.read(1 << 16, 1e9)
        taken = bytes(self._bytes[:count])
        del self._bytes[:count]
        return taken


def _mask(payload: bytes, key: bytes) -> bytes:
    return bytes(byte ^ key[at % 4] for at, byte in enumerate(payload))


def _masked(code: int, payload: bytes) -> bytes:
    """Return a frame of a client, whose payload is masked."""
    key = os.urandom(4)
    return struct.pack(">BB", 0x80 | code, 0x80 | len(payload)) + key + _mask(payload, key)


def events_of(text: str) -> list[tuple[str, str]]:
    """Return (resource, value) of an event's XML. The value is empty where the event names only its resource."""
    found = []
    for _, inner in _VALUE.findall(text):
        href, spans = _HREF.search(inner), _SPAN.findall(inner)
        if href is not None:
            found.append((href[1], spans[0][1] if spans else ""))
    return found
