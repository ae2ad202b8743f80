"""Robot Web Services of an ABB controller: JSON over HTTP, without a number or a checksum."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Iterable, Sequence
from typing import Any

from polishd.drivers.abb_rws.services import Account, RwsServices, Symbol
from polishd.drivers.transport.address import Tcp
from tests.campaigns.codecs.faulty_peer import Talk
from tests.campaigns.codecs.lines import HOST

SYMBOLS = [Symbol("T_ROB1", "polishd_part", "polishd_seen"), Symbol("T_POLISHD", "polishd_watch", "polishd_state")]
VALUE = re.compile(rb'"value": *"([^"]*)"')


def http(status: bytes, content: object, length: int | None = None) -> bytes:
    """An answer with that content."""
    body = json.dumps(content).encode()
    size = len(body) if length is None else length
    return b"HTTP/1.1 %b\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n%b" % (status, size, body)


class RobotWebServices(Talk):
    """Two variables in turn: an answer names its own. Name and form can be checked, and what comes unasked."""

    name = "Robot Web Services"
    driver = "abb_rws"
    resyncs = False
    least = 0.3  # what no request asked for ends the connection, and opening needs an answer, too

    def __init__(self, address: Tcp = HOST, **how: Any) -> None:
        super().__init__(**how)
        self._account = Account(address, "1.0", "user", "password")
        self._services: RwsServices | None = None
        self._asked = ""
        """Name of the variable that was asked for last."""

    async def open(self) -> None:
        self._services = RwsServices(self._account, self.silence_s)
        await self._services.open()

    async def close(self) -> None:
        if self._services is not None:
            await self._services.close()

    async def ask(self) -> str:
        assert self._services is not None
        return await self._services.value(SYMBOLS[next(self.numbers) % len(SYMBOLS)])

    def replies(self, data: bytes) -> Iterable[bytes]:
        path = data.split()[1].partition(b"?")[0].decode()
        self._asked = path.rpartition("/")[2] if "/symbol/" in path else ""
        if not self._asked:
            yield http(b"200 OK", _state("sys-system", "system", name="simulated"))
            return
        self.truth = f"[{next(self.numbers)},0.5,7]"
        yield self._value(self._asked, self.truth)

    @staticmethod
    def _value(name: str, value: object) -> bytes:
        return http(b"200 OK", _state("rap-data", f"RAPID/T_ROB1/polishd_part/{name}", value=value))

    def refusal(self, reply: bytes) -> bytes:
        return http(b"400 Bad Request", {"_embedded": {"status": {"code": -1073442809, "msg": "not found"}}})

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        """Another value under the name that was asked for, or under none, could be the answer."""
        if not self._asked:
            return True
        others = any(value != self.truth.encode() for value in VALUE.findall(sent))
        names_another = b"_title" in sent and f'/{self._asked}"'.encode() not in sent
        return not others or names_another

    def damages(self, rng: random.Random, reply: bytes) -> Sequence[bytes]:
        """Sound answers to something else, and bodies that are none."""
        name = self._asked or "system"
        others = [symbol.name for symbol in SYMBOLS if symbol.name != name]
        answers = [self._value(other, f"[{rng.randrange(99)},0,7]") for other in others]
        answers += [http(b"200 OK", _state("rap-execution", "execution", ctrlexecstate="running"))]
        answers += [http(b"200 OK", rng.choice([None, [], 7, {"_embedded": {"_state": []}}, {"_embedded": 3}]))]
        answers += [http(b"200 OK", _state("rap-data", name)), http(b"200 OK", {}, rng.choice([1, 7, 1 << 30]))]
        answers += [
            b"HTTP/1.1 204 No Content\r\n\r\n",
            b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\n\r\n",
        ]
        return [*answers, b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n", b"\r\n" * rng.randrange(1, 9)]


def _state(kind: str, title: str, **values: object) -> dict[str, Any]:
    return {"_embedded": {"_state": [{"_type": kind, "_title": title, **values}]}}
