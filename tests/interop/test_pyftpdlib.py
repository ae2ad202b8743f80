"""pyftpdlib's server takes the programs that we deliver by FTP."""

from __future__ import annotations

from pathlib import Path

from polishd.drivers.transport.file_delivery import Ftp, RemoteFolder
from tests.interop.delivery import PASSWORD, USER, refuses, takes_programs
from tests.interop.peers import Peer, program

PEER = Peer("pyftpdlib", "FTP", "server", "PyPI", "pyftpdlib")
pytestmark = PEER.needed


async def test_it_takes_programs_and_refuses_strangers(tmp_path: Path) -> None:
    with program("ftp_server.py", tmp_path, USER, PASSWORD) as peer:
        await takes_programs(Ftp(RemoteFolder("127.0.0.1", peer.greeting, USER, PASSWORD, "")), tmp_path)
        (tmp_path / "nc").mkdir()
        await takes_programs(Ftp(RemoteFolder("127.0.0.1", peer.greeting, USER, PASSWORD, "nc")), tmp_path / "nc")
        await refuses(Ftp(RemoteFolder("127.0.0.1", peer.greeting, USER, "other", "")), tmp_path, "cannot be delivered")
        await refuses(
            Ftp(RemoteFolder("127.0.0.1", peer.greeting, USER, PASSWORD, "none")), tmp_path, "cannot be delivered"
        )
