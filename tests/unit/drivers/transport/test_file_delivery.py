"""Files on their way to a controller, over real FTP and SFTP servers on loopback: whole, or not there."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from polishd.api import DeviceRefused
from polishd.drivers.transport.file_delivery import Folder, Ftp, RemoteFolder, Sftp

TEXT = b"G1 X1\n" * 20_000
USER, PASSWORD = "robot", "s3cret"


@asynccontextmanager
async def ftp_server(root: Path, *, renames_over: bool = True) -> AsyncIterator[int]:
    import aioftp

    class Server(aioftp.Server):
        @aioftp.ConnectionConditions(aioftp.ConnectionConditions.login_required)
        async def rnto(self, connection: Any, rest: str) -> Any:
            if not renames_over and (root / Path(rest).name).exists():
                connection.response("550", "it is there already")
                return True
            return await super().rnto(connection, rest)

    # its own methods are bound in its initializer
    server = Server([aioftp.User(USER, PASSWORD, base_path=root)], path_io_factory=aioftp.PathIO)
    await server.start("127.0.0.1", 0)
    try:
        yield server.server_port
        while server.connections:  # noqa: ASYNC110 -- it logs those that it has to cut
            await asyncio.sleep(0.005)
    finally:
        await server.close()


@asynccontextmanager
async def sftp_server(root: Path, known_hosts: Path) -> AsyncIterator[int]:
    import asyncssh

    class Server(asyncssh.SSHServer):
        def password_auth_supported(self) -> bool:
            return True

        def validate_password(self, username: str, password: str) -> bool:
            return (username, password) == (USER, PASSWORD)

    key = asyncssh.generate_private_key("ssh-ed25519")
    server = await asyncssh.create_server(
        Server,
        "127.0.0.1",
        0,
        server_host_keys=[key],
        sftp_factory=lambda channel: asyncssh.SFTPServer(channel, chroot=str(root)),
    )
    port = server.get_port()
    write(known_hosts, b"[127.0.0.1]:%d %s" % (port, key.export_public_key()))
    try:
        yield port
    finally:
        server.close()
        await server.wait_closed()


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "controller"
    folder.mkdir()
    return folder


def write(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def found(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def place(port: int, password: str = PASSWORD, folder: str = "") -> RemoteFolder:
    return RemoteFolder("127.0.0.1", port, USER, password, folder)


async def test_a_folder_gets_it_whole(root: Path) -> None:
    await Folder(root).put("a.nc", TEXT)
    assert found(root) == {"a.nc": TEXT}
    with pytest.raises(DeviceRefused, match=r"a\.nc: No such file"):
        await Folder(root / "none").put("a.nc", TEXT)


@pytest.mark.parametrize("renames_over", [True, False])
async def test_ftp_takes_the_place_of_the_file_before(root: Path, renames_over: bool) -> None:
    async with ftp_server(root, renames_over=renames_over) as port:
        for text in (b"old", TEXT):
            await Ftp(place(port)).put("a.nc", text)
        assert found(root) == {"a.nc": TEXT}


async def test_ftp_to_a_controller_that_takes_whole_programs_only_uses_no_other_name(root: Path) -> None:
    """Its server would refuse a name that is no program's, and says no size."""
    import aioftp

    names: list[str] = []

    class Jobs(aioftp.PathIO):
        async def _open(self, path: Path, *arguments: Any, **named: Any) -> Any:
            names.append(path.name)
            return await super()._open(path, *arguments, **named)

        async def rename(self, *_: Any) -> None:
            raise OSError("it renames nothing")

    server = aioftp.Server([aioftp.User(USER, PASSWORD, base_path=root)], path_io_factory=Jobs)
    await server.start("127.0.0.1", 0)
    try:
        await Ftp(place(server.server_port), renames=False).put("POLISH.JBI", TEXT)
    finally:
        await server.close()
    assert found(root) == {"POLISH.JBI": TEXT}
    assert set(names) == {"POLISH.JBI"}


async def test_ftp_says_who_refuses_and_what(root: Path) -> None:
    async with ftp_server(root) as port:
        with pytest.raises(DeviceRefused, match=r"ftp://robot@127\.0\.0\.1.*a\.nc cannot be delivered") as refused:
            await Ftp(place(port, "0ther-one")).put("a.nc", TEXT)
        assert "0ther-one" not in str(refused.value)
        with pytest.raises(DeviceRefused, match="cannot be delivered"):
            await Ftp(place(port, folder="none")).put("a.nc", TEXT)
    with pytest.raises(DeviceRefused, match="cannot be delivered"):
        await Ftp(place(port)).put("a.nc", TEXT)
    assert found(root) == {}


@pytest.mark.full
async def test_sftp_takes_the_place_of_the_file_before(root: Path, tmp_path: Path) -> None:
    hosts = tmp_path / "known_hosts"
    async with sftp_server(root, hosts) as port:
        for text in (b"old", TEXT):
            await Sftp(place(port), hosts).put("a.nc", text)
        assert found(root) == {"a.nc": TEXT}
        with pytest.raises(DeviceRefused, match="sftp://robot@"):
            await Sftp(place(port, "0ther-one"), hosts).put("a.nc", TEXT)


@pytest.mark.full
async def test_sftp_refuses_an_unknown_host(root: Path, tmp_path: Path) -> None:
    hosts, others = tmp_path / "known_hosts", tmp_path / "others"
    others.touch()
    async with sftp_server(root, hosts) as port:
        with pytest.raises(DeviceRefused, match=r"[Hh]ost key"):
            await Sftp(place(port), others).put("a.nc", TEXT)
    assert found(root) == {}


@pytest.mark.full
async def test_what_breaks_on_its_way_leaves_the_file_before(root: Path) -> None:
    async with ftp_server(root) as port:
        await Ftp(place(port)).put("a.nc", b"old")
        sending = asyncio.create_task(Ftp(place(port)).put("a.nc", TEXT * 50))
        while not (root / "a.nc.part").exists():  # noqa: ASYNC110 -- the server sends no event
            await asyncio.sleep(0.001)
        sending.cancel()
        await asyncio.wait({sending})
        assert (root / "a.nc").read_bytes() == b"old"
