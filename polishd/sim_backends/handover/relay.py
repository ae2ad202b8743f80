"""A wire with its mischief before a library's own server: bytes both ways, those to the client late or damaged."""

from __future__ import annotations

import asyncio
import contextlib

from polishd.sim_backends.faults.outlet import FaultyLink
from polishd.sim_backends.runtime import LOOPBACK, SimRuntime
from polishd.sim_backends.wire import Feed


class Relay:
    """Passes each client's bytes to the server behind, on loopback."""

    def __init__(self, runtime: SimRuntime, port: int) -> None:
        self._runtime = runtime
        self._port = port

    def connected(self, outlet: FaultyLink) -> Feed:
        """What takes the bytes of a client."""
        queue: asyncio.Queue[bytes] = asyncio.Queue()
        task = self._runtime.group.create_task(self._serve(queue, outlet))

        def close() -> None:
            task.cancel()

        outlet.on_closed = close
        return queue.put_nowait

    async def _serve(self, queue: asyncio.Queue[bytes], outlet: FaultyLink) -> None:
        reader, writer = await asyncio.open_connection(LOOPBACK, self._port)
        async with asyncio.TaskGroup() as group:
            forward = group.create_task(self._forward(queue, writer))
            try:
                with contextlib.suppress(ConnectionError):  # the server hangs up on nonsense
                    while data := await reader.read(1 << 16):
                        outlet.send(data)
            finally:
                forward.cancel()
                writer.close()

    async def _forward(self, queue: asyncio.Queue[bytes], writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                writer.write(await queue.get())
                await writer.drain()
