"""vsftpd, the server of many a machine tool's Linux, takes the programs that we deliver by FTP."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from polishd.drivers.transport.file_delivery import Ftp, RemoteFolder
from tests.interop.delivery import refuses, takes_programs
from tests.interop.devices import free_port
from tests.interop.peers import Peer
from tests.system.sim_rig import wait_for

PEER = Peer("vsftpd", "FTP", "server", "Debian", "vsftpd")
pytestmark = [PEER.needed, pytest.mark.skipif(os.geteuid() != 0, reason="vsftpd starts as root only")]

CONFIG = """
listen=YES
listen_address=127.0.0.1
listen_port={port}
background=NO
anonymous_enable=YES
anon_root={root}
no_anon_password=YES
write_enable=YES
anon_upload_enable=YES
anon_mkdir_write_enable=YES
anon_other_write_enable=YES
anon_umask=022
secure_chroot_dir={empty}
seccomp_sandbox=NO
xferlog_enable=NO
"""


@contextmanager
def server(folder: Path) -> Iterator[int]:
    """Run the server, which has no account for tests: all users may write into ``nc``."""
    (folder / "empty").mkdir()
    (folder / "root" / "nc").mkdir(parents=True)
    shutil.chown(folder / "root" / "nc", "ftp")
    port, config = free_port(), folder / "vsftpd.conf"
    config.write_text(CONFIG.format(port=port, root=folder / "root", empty=folder / "empty"))
    with subprocess.Popen([shutil.which("vsftpd") or "/usr/sbin/vsftpd", str(config)]) as process:
        try:
            wait_for(lambda: greets(port, b"220"), "vsftpd")
            yield port
        finally:
            process.terminate()


def greets(port: int, word: bytes) -> bool:
    """Return whether a server on that port greets with that word."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=10.0) as connection:
            return connection.recv(3) == word
    except OSError:
        return False


@pytest.fixture
def folder() -> Iterator[Path]:
    """Create a folder that other users can access, which pytest's folders do not permit."""
    with tempfile.TemporaryDirectory() as made:
        Path(made).chmod(0o755)
        yield Path(made)


async def test_it_takes_programs_and_refuses_a_folder_without_write_permission(folder: Path) -> None:
    with server(folder) as port:
        await takes_programs(Ftp(RemoteFolder("127.0.0.1", port, "ftp", "robot", "nc")), folder / "root" / "nc")
        await refuses(Ftp(RemoteFolder("127.0.0.1", port, "ftp", "robot", "")), folder / "root", "cannot be delivered")
        await refuses(
            Ftp(RemoteFolder("127.0.0.1", port, "root", "wrong", "nc")), folder / "root" / "nc", "cannot be delivered"
        )
