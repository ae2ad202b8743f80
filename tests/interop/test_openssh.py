"""OpenSSH's sshd with its sftp-server takes the programs that we deliver by SFTP, with a key of the user's."""

from __future__ import annotations

import getpass
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from polishd.drivers.transport.file_delivery import RemoteFolder, Sftp
from tests.interop.delivery import refuses, takes_programs
from tests.interop.devices import free_port
from tests.interop.peers import Peer
from tests.interop.test_vsftpd import greets
from tests.system.sim_rig import wait_for

PEER = Peer("OpenSSH", "SFTP", "server", "Debian", "openssh-server")
pytestmark = PEER.needed

SEPARATED = Path("/run/sshd")
"""Which its service makes; as root it needs that."""
CONFIG = """
ListenAddress 127.0.0.1
Port {port}
HostKey {folder}/host_key
PidFile none
UsePAM no
StrictModes no
PermitRootLogin yes
PasswordAuthentication no
KbdInteractiveAuthentication no
AuthorizedKeysFile {folder}/home/.ssh/id_ed25519.pub
Subsystem sftp /usr/lib/openssh/sftp-server
"""


def key(path: Path) -> str:
    """A new one; its public half."""
    path.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(path)], check=True)
    return path.with_suffix(".pub").read_text()


@contextmanager
def server(folder: Path) -> Iterator[int]:
    """Run sshd; its port. Its key is in ``known_hosts``, the user's key in ``home``."""
    port, config, known = free_port(), folder / "sshd_config", folder / "known_hosts"
    known.write_text(f"[127.0.0.1]:{port} {key(folder / 'host_key')}")
    key(folder / "home" / ".ssh" / "id_ed25519")
    config.write_text(CONFIG.format(port=port, folder=folder))
    if os.geteuid() == 0:
        SEPARATED.mkdir(mode=0o755, exist_ok=True)
    command = ["/usr/sbin/sshd", "-D", "-f", str(config), "-E", str(folder / "sshd.log")]
    with subprocess.Popen(command) as process:
        try:
            wait_for(lambda: process.poll() is not None or greets(port, b"SSH"), "sshd")
            yield port
        finally:
            process.terminate()


async def test_it_takes_programs_and_refuses_strangers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, known = tmp_path / "nc", tmp_path / "known_hosts"
    folder.mkdir()
    with server(tmp_path) as port:
        monkeypatch.setenv("HOME", str(tmp_path / "home"))
        place = RemoteFolder("127.0.0.1", port, getpass.getuser(), "", str(folder))
        await takes_programs(Sftp(place, known), folder)
        nowhere = RemoteFolder("127.0.0.1", port, getpass.getuser(), "", str(folder / "none"))
        await refuses(Sftp(nowhere, known), folder, "No such file")
        key(tmp_path / "other")
        known.write_text(f"[127.0.0.1]:{port} {(tmp_path / 'other.pub').read_text()}")
        await refuses(Sftp(place, known), folder, "not trusted|Host key")
        monkeypatch.setenv("HOME", str(tmp_path))
        known.write_text(f"[127.0.0.1]:{port} {(tmp_path / 'host_key.pub').read_text()}")
        await refuses(Sftp(place, known), folder, "Permission denied")
