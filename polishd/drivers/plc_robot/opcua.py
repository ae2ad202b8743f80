"""Variables over OPC UA. The only file that imports asyncua, and only when needed: that takes a second."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import logging
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from polishd.api import DeviceIdentity, LinkError, ProtocolError
from polishd.config.controller_profile import Kind, Value, VariablesTable
from polishd.drivers.plc_robot.variables import VariableSnapshot, of_kind, watched, written
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.claims import claim_address
from polishd.util.address_claims import Claim

if TYPE_CHECKING:
    from asyncua import Client, ua


OPC_UA_PORT = 4840
CLOSE_S = 0.5
"""Longest time to close the session with a server that does not answer."""
SERVER_START, VENDOR, PRODUCT, VERSION = "i=2257", "i=2263", "i=2261", "i=2264"
"""Standard nodes of every server."""
APPLICATION = "urn:polishd"
"""Application URI in our certificate."""
_TYPES: dict[Kind, str] = {
    "bool": "Boolean",
    "int16": "Int16",
    "uint16": "UInt16",
    "int32": "Int32",
    "uint32": "UInt32",
    "float": "Float",
    "double": "Double",
    "string": "String",
}


@dataclass(frozen=True, slots=True)
class OpcUaCertificates:
    """Certificates in PEM or DER: ours with its key, and the expected one of the server."""

    certificate: Path
    private_key: Path
    server_certificate: Path

    async def show(self, client: Client) -> None:
        """Set the client to sign and encrypt with them."""
        from asyncua import ua
        from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
        from asyncua.crypto.uacrypto import CertProperties

        def paper(path: Path) -> CertProperties:
            """Detect the format by the content: the library goes by the file name."""
            content = path.read_bytes()
            return CertProperties(content, "PEM" if b"-----BEGIN " in content else "DER")

        client.application_uri = APPLICATION
        await client.set_security(
            SecurityPolicyBasic256Sha256,
            paper(self.certificate),
            paper(self.private_key),
            server_certificate=paper(self.server_certificate),
            mode=ua.MessageSecurityMode.SignAndEncrypt,
        )


class OpcUa:
    """Variables over ``opc.tcp://host:port``. This computer times a reading half-way between request and answer."""

    def __init__(
        self,
        url: str,
        table: VariablesTable,
        silence_s: float,
        user: str = "",
        password: str = "",
        *,
        papers: OpcUaCertificates | None = None,
    ) -> None:
        """With ``papers`` all is signed and encrypted (Basic256Sha256), and any other server is refused."""
        self._url = url
        self._papers = papers
        self._watched = watched(table)
        self._written = written(table)
        self._silence_s = silence_s
        self._account = (user, password)
        self._client: Client | None = None
        self._nodes: dict[str, ua.NodeId] = {}
        self._claimed = Claim()

    async def open(self) -> None:
        """See Variables."""
        await self.close()
        library = await asyncio.to_thread(importlib.import_module, "asyncua")
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # errors are raised here once
        where = urlsplit(self._url)
        self._claimed = await claim_address(Tcp(where.hostname or "", where.port or OPC_UA_PORT))
        client = library.Client(self._url, timeout=self._silence_s)
        if self._account[0]:
            client.set_user(self._account[0])
            client.set_password(self._account[1])
        self._client = client
        try:
            secured = "" if self._papers is None else " with these certificates (check trust on both sides)"
            async with self._link(f"cannot be opened{secured}"):
                if self._papers is not None:
                    await self._papers.show(client)
                await client.connect()
                await self._find(client)
            await self.read()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Variables."""
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(LinkError):
                async with self._link("does not close"), asyncio.timeout(CLOSE_S):
                    await client.disconnect()
            client.disconnect_socket()
        self._claimed.release()

    async def identify(self) -> DeviceIdentity:
        """See Variables. The server's start time identifies the controller's start."""
        vendor, product, version, start = await self._values([VENDOR, PRODUCT, VERSION, SERVER_START])
        return DeviceIdentity(str(vendor), str(product), self._url, str(version), str(start))

    async def read(self) -> VariableSnapshot:
        """See Variables."""
        from asyncua import ua

        names = list(self._watched)
        asked_s = time.monotonic()
        async with self._link("does not answer"):
            found = await self._session.uaclient.read_attributes(
                [self._nodes[name] for name in names], ua.AttributeIds.Value
            )
        now_s = (asked_s + time.monotonic()) / 2
        values, changed_s = {}, {}
        for name, answer in zip(names, found, strict=True):
            values[name] = of_kind(self._watched[name].type, _value(answer, name), name)
            if answer.SourceTimestamp is not None and answer.ServerTimestamp is not None:
                changed_s[name] = now_s - (answer.ServerTimestamp - answer.SourceTimestamp).total_seconds()
        return VariableSnapshot(now_s, values, changed_s)

    async def write(self, values: Mapping[str, Value]) -> None:
        """See Variables."""
        from asyncua import ua

        typed = []
        for name, value in values.items():
            kind = self._written[name].type
            typed.append(ua.DataValue(ua.Variant(of_kind(kind, value, name), ua.VariantType[_TYPES[kind]])))
        async with self._link("does not answer"):
            answers = await self._session.uaclient.write_attributes([self._nodes[name] for name in values], typed)
        for name, answer in zip(values, answers, strict=True):
            if not answer.is_good():
                raise ProtocolError(f"{self._url}: variable {name} cannot be written: {answer.name}")

    @property
    def _session(self) -> Client:
        if self._client is None:
            raise LinkError(f"{self._url}: is not open")
        return self._client

    async def _find(self, client: Client) -> None:
        from asyncua import ua

        namespaces = await client.get_namespace_array()
        for name, point in {**self._watched, **self._written}.items():
            text = point.address
            if text.startswith("nsu="):
                uri, _, rest = text.removeprefix("nsu=").partition(";")
                if uri not in namespaces:
                    raise ProtocolError(f"{self._url}: has no namespace {uri!r} of variable {name}")
                text = f"ns={namespaces.index(uri)};{rest}"
            try:
                self._nodes[name] = ua.NodeId.from_string(text)
            except ua.UaError as error:
                raise ProtocolError(f"variable {name}: {point.address!r} is not a node: {error}") from error

    async def _values(self, nodes: list[str]) -> list[object]:
        from asyncua import ua

        async with self._link("does not answer"):
            found = await self._session.uaclient.read_attributes(
                [ua.NodeId.from_string(node) for node in nodes], ua.AttributeIds.Value
            )
        return [answer.Value.Value if answer.Value is not None else "" for answer in found]

    @asynccontextmanager
    async def _link(self, what: str) -> AsyncIterator[None]:
        """Raise the client's errors as LinkError."""
        from asyncua import ua

        try:
            yield
        except (ua.UaError, OSError, TimeoutError, ValueError, asyncio.IncompleteReadError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise LinkError(f"{self._url}: {what}: {reason}") from error


def _value(answer: ua.DataValue, name: str) -> object:
    if answer.StatusCode is not None and not answer.StatusCode.is_good():
        raise ProtocolError(f"variable {name} cannot be read: {answer.StatusCode.name}")
    return answer.Value.Value if answer.Value is not None else None
