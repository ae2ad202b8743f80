"""Atomic delivery of a file to the controller: written under another name, then renamed."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Protocol

from polishd.drivers.transport.background import cancellable
from polishd.model.errors import DeviceRefused
from polishd.util.files import write_atomic

if TYPE_CHECKING:
    import aioftp


class Delivery(Protocol):
    """A folder that the controller reads files from."""

    async def put(self, name: str, text: bytes) -> None:
        """Deliver the whole file, or leave the folder unchanged. DeviceRefused if the file cannot be delivered."""
        ...


class Folder:
    """A folder that the controller can read: its share, or one that it mounts."""

    def __init__(self, path: Path) -> None:
        self._path = path

    async def put(self, name: str, text: bytes) -> None:
        """See Delivery."""
        path = self._path / name
        try:
            await asyncio.to_thread(write_atomic, path, text)  # readable by all: the controller is another user
        except OSError as error:
            raise DeviceRefused(f"{path}: {error.strerror or error}. Check [robot] delivery.") from error


# Delivery over FTP and SFTP: temporary name, size check, rename. Libraries are imported when needed.

PUT_S = 120.0
"""Longest time of a delivery."""
ANSWER_S = 10.0
TEMPORARY = ".part"


@dataclass(frozen=True, slots=True)
class RemoteFolder:
    """A folder on a server."""

    host: str
    port: int
    user: str
    password: str
    folder: str

    def __str__(self) -> str:
        return f"{self.user}@{self.host}:{self.port}/{self.folder}"


class Ftp:
    """A Delivery by FTP, unencrypted: for a controller on a separate network.

    Without ``renames`` the file goes to its final name: for a controller whose folder takes only whole programs.
    """

    def __init__(self, place: RemoteFolder, *, renames: bool = True) -> None:
        self._place = place
        self._renames = renames

    async def put(self, name: str, text: bytes) -> None:
        """See Delivery."""
        library = await asyncio.to_thread(importlib.import_module, "aioftp")
        try:
            async with asyncio.timeout(PUT_S):
                await cancellable(self._put(library, name, text))
        except (library.AIOFTPException, OSError, TimeoutError) as error:
            raise _refused("ftp", self._place, name, error) from error

    async def _put(self, library: Any, name: str, text: bytes) -> None:
        final = PurePosixPath(name)
        beside = PurePosixPath(name + TEMPORARY) if self._renames else final
        async with _session(library, self._place) as client:
            async with client.upload_stream(beside) as stream:
                await stream.write(text)
            if not self._renames:
                await client.quit()  # the server has confirmed it; the controller may write the file in its own way
                return
            size = await _size(library, client, beside)
            if size != len(text):
                raise OSError(f"{size} of {len(text)} bytes arrived")
            try:
                await client.rename(beside, final)
            except library.StatusCodeError:  # some servers refuse to rename to an existing name
                await client.remove_file(final)
                await client.rename(beside, final)
            await client.quit()


@asynccontextmanager
async def _session(library: Any, place: RemoteFolder) -> AsyncIterator[aioftp.Client]:
    """Log in and change to the folder. Closes all data connections: the client leaks those that are refused."""
    client: aioftp.Client = library.Client(socket_timeout=ANSWER_S, connection_timeout=ANSWER_S)
    opened: list[asyncio.StreamWriter] = []
    connect = client.get_passive_connection

    async def kept(*arguments: Any, **named: Any) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await connect(*arguments, **named)
        opened.append(writer)
        return reader, writer

    client.get_passive_connection = kept  # type: ignore[method-assign]
    try:
        await client.connect(place.host, place.port)
        await client.login(place.user, place.password)
        if place.folder:
            await client.change_directory(place.folder)
        yield client
    finally:
        for writer in opened:
            writer.close()
        client.close()


async def _size(library: Any, client: aioftp.Client, path: PurePosixPath) -> int:
    """Return the size of a file, bytes. Old servers support SIZE but not MLST, and their listings vary."""
    try:
        _, said = await client.command(f"SIZE {path}", "213")
    except library.StatusCodeError as error:
        if not error.received_codes[-1].matches("50x"):
            raise
        return int((await client.stat(path))["size"])
    return int(said[-1])


class Sftp:
    """A Delivery by SFTP. A host whose key is not in ``known_hosts`` is refused."""

    def __init__(self, place: RemoteFolder, known_hosts: Path) -> None:
        self._place = place
        self._known_hosts = known_hosts

    async def put(self, name: str, text: bytes) -> None:
        """See Delivery."""
        library = await asyncio.to_thread(importlib.import_module, "asyncssh")
        try:
            async with asyncio.timeout(PUT_S):
                await cancellable(self._put(library, name, text))
        except (library.Error, OSError, TimeoutError) as error:
            raise _refused("sftp", self._place, name, error) from error

    async def _put(self, library: Any, name: str, text: bytes) -> None:
        place = self._place
        final = PurePosixPath(place.folder) / name
        beside = final.with_name(name + TEMPORARY)
        async with (
            library.connect(
                place.host,
                place.port,
                username=place.user,
                password=place.password or None,
                known_hosts=str(self._known_hosts),
                connect_timeout=ANSWER_S,
            ) as connection,
            connection.start_sftp_client() as client,
        ):
            async with client.open(beside, "wb") as file:
                await file.write(text)
            size = (await client.stat(beside)).size
            if size != len(text):
                raise OSError(f"{size} of {len(text)} bytes arrived")
            try:
                await client.posix_rename(beside, final)
            except library.SFTPOpUnsupported:
                with contextlib.suppress(library.SFTPNoSuchFile):
                    await client.remove(final)
                await client.rename(beside, final)


def _refused(kind: str, place: RemoteFolder, name: str, error: BaseException) -> DeviceRefused:
    reason = " ".join(str(error).split()) or type(error).__name__
    return DeviceRefused(f"{kind}://{place}: {name} cannot be delivered: {reason}. Check [robot] delivery.")
