"""``polishd opcua``: read the daemon once a second and publish its values to OPC UA clients, read only."""

from __future__ import annotations

import asyncio
import logging
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.user_managers import UserManager

from polishd.config.server_sections import OpcUaSection
from polishd.daemon.socket import client
from polishd.model.errors import ConfigError, NoDaemon, PolishdError
from polishd.opcua.jobs import OpcUaJob, read_work
from polishd.opcua.machine import STATES, OpcUaMachine

LOOK_S = 1.0
"""Between two questions."""
ANSWER_S = 0.8
"""A daemon that has not answered for so long is called silent."""
ADDRESS = "127.0.0.1"
"""Beyond this computer OPC UA needs certificates on both sides, which polishd does not keep: docs/plant-systems.md."""


class OpcUaPolling(UserManager):
    """Access rights: all users may read, none may write."""

    def get_user(self, iserver: Any, username: str | None = None, password: str | None = None,
                 certificate: Any = None) -> User:  # fmt: skip
        """Of a client that opens a session."""
        del iserver, username, password, certificate
        return User(role=UserRole.User)


@asynccontextmanager
async def serving(name: str, state_dir: Path, section: OpcUaSection) -> AsyncIterator[str]:
    """Serve inside this block; the address. OSError where the port is taken."""
    logging.getLogger("asyncua").setLevel(logging.ERROR)  # it logs a warning at each start
    server = Server(user_manager=OpcUaPolling())
    await server.init()
    server.set_server_name(f"polishd {name}")
    await server.set_application_uri(f"urn:polishd:{name}:server")
    server.set_endpoint(f"opc.tcp://{ADDRESS}:{section.port}/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    server.set_identity_tokens([ua.AnonymousIdentityToken])
    machine = await OpcUaMachine.added(server, name, section)
    async with server, asyncio.TaskGroup() as group:  # a fault of who asks ends it: no last values stand there
        asking = group.create_task(_ask_on(machine, state_dir))
        try:
            port = section.port if server.bserver is None else server.bserver.port
            yield f"opc.tcp://{ADDRESS}:{port}/"
        finally:
            asking.cancel()


async def serve(name: str, state_dir: Path, section: OpcUaSection) -> None:
    """Until Ctrl-C or SIGTERM; it says where it listens. OSError where the port is taken."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    async with serving(name, state_dir, section) as address:
        print(address, flush=True)  # noqa: T201 - the starting process waits for this line
        await stop.wait()


async def _ask_on(machine: OpcUaMachine, state_dir: Path) -> None:
    while True:
        orders = await asyncio.to_thread(_orders, state_dir)
        try:
            live = await asyncio.to_thread(client.request, state_dir, "live", ANSWER_S)
        except NoDaemon:
            await machine.no_daemon(orders)
        except PolishdError:
            await machine.silent(orders)
        else:
            await (machine.update(live, orders) if live.get("state") in STATES else machine.silent(orders))
        await asyncio.sleep(LOOK_S)


def _orders(state_dir: Path) -> tuple[OpcUaJob, ...] | None:
    """Of the journal; None: it cannot be read."""
    try:
        return read_work(state_dir)
    except ConfigError:
        return None
