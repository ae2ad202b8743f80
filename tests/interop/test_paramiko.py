"""paramiko's server takes the programs that we deliver by SFTP; it renames to no name that is taken."""

from __future__ import annotations

from pathlib import Path

from polishd.drivers.transport.file_delivery import RemoteFolder, Sftp
from tests.interop.delivery import PASSWORD, USER, refuses, takes_programs
from tests.interop.peers import Peer, program

PEER = Peer("paramiko", "SFTP", "server", "PyPI", "paramiko")
pytestmark = PEER.needed


async def test_it_takes_programs_and_refuses_strangers(tmp_path: Path) -> None:
    folder, known = tmp_path / "nc", tmp_path / "known_hosts"
    folder.mkdir()
    with program("sftp_server.py", tmp_path, USER, PASSWORD) as peer:
        port = peer.greeting["port"]
        known.write_text(f"[127.0.0.1]:{port} {peer.greeting['key']}\n")
        await takes_programs(Sftp(RemoteFolder("127.0.0.1", port, USER, PASSWORD, "nc"), known), folder)
        await refuses(Sftp(RemoteFolder("127.0.0.1", port, USER, "other", "nc"), known), folder, "cannot be delivered")
        await refuses(
            Sftp(RemoteFolder("127.0.0.1", port, USER, PASSWORD, "none"), known), folder, "cannot be delivered"
        )
        known.write_text("")
        await refuses(Sftp(RemoteFolder("127.0.0.1", port, USER, PASSWORD, "nc"), known), folder, "cannot be delivered")
