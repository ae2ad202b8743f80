"""Claims on device addresses: each connection claims its address first, and releases it when it is closed."""

from __future__ import annotations

import asyncio
import contextlib
import socket

from polishd.drivers.transport.address import Address, SerialLine, SlcanAddress, Tcp
from polishd.util.address_claims import Claim, claim, serial_key, tcp_keys

RESOLVE_S = 1.0
"""Longest wait for a name server; without an answer the claim uses the host's name."""


async def claim_address(address: Address, *, part: str = "") -> Claim:
    """Claim a device address for this process; ``release`` the claim after the connection is closed.

    ``open_stream`` and ``open_bus`` claim what they open. A driver calls this where a library connects for it.

    Args:
        address: Address of the device.
        part: Part behind the address, if several programs may share it: a CAN node, an AMS port.

    Raises:
        DeviceClaimed: Another program on this computer has it. Nothing was connected.
    """
    name = str(address)
    if isinstance(address, SerialLine | SlcanAddress):
        return claim([serial_key(address.path)], name)
    resolved = await _resolved(address.host, address.port)
    if isinstance(address, Tcp):
        return claim(tcp_keys(address.host, resolved, address.port, part), name)
    return claim(tcp_keys(address.host, resolved, address.port, f"{address.channel}/{part}"), name)


async def _resolved(host: str, port: int) -> list[str]:
    with contextlib.suppress(OSError, UnicodeError, TimeoutError):
        async with asyncio.timeout(RESOLVE_S):
            found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
        return [str(where[0]) for *_, where in found]
    return []
