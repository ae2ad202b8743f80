"""paramiko's SFTP server: ``python sftp_server.py FOLDER USER PASSWORD``; the first line has its port and its key.

How files are kept is what paramiko leaves to its user: here a folder, which knows no posix-rename.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
from pathlib import Path
from typing import Any

import paramiko


class Login(paramiko.ServerInterface):
    """Server with one account."""

    def check_auth_password(self, username: str, password: str) -> int:
        good = [username, password] == sys.argv[2:]
        return paramiko.AUTH_SUCCESSFUL if good else paramiko.AUTH_FAILED

    def get_allowed_auths(self, username: str) -> str:
        return "password"

    def check_channel_request(self, kind: str, chanid: int) -> int:
        return paramiko.OPEN_SUCCEEDED if kind == "session" else paramiko.OPEN_FAILED_ADMINISTRATIVELY_PROHIBITED


class Files(paramiko.SFTPServerInterface):
    """Files of the served folder."""

    def stat(self, path: str) -> Any:
        return self._tried(lambda: paramiko.SFTPAttributes.from_stat(self._local(path).stat()))

    lstat = stat

    def open(self, path: str, flags: int, attr: Any) -> Any:
        def opened() -> Any:
            handle = paramiko.SFTPHandle(flags)
            handle.writefile = os.fdopen(os.open(self._local(path), flags | os.O_CREAT, 0o644), "wb")
            return handle

        return self._tried(opened)

    def remove(self, path: str) -> Any:
        return self._tried(lambda: self._local(path).unlink() or paramiko.SFTP_OK)

    def rename(self, oldpath: str, newpath: str) -> Any:
        if self._local(newpath).exists():
            return paramiko.SFTP_FAILURE
        return self._tried(lambda: self._local(oldpath).rename(self._local(newpath)) and paramiko.SFTP_OK)

    def _local(self, path: str) -> Path:
        return Path(sys.argv[1]) / path.lstrip("/")

    def _tried(self, work: Any) -> Any:
        try:
            return work()
        except OSError as error:
            return paramiko.SFTPServer.convert_errno(error.errno)


def main() -> None:
    """Run until standard input ends."""
    key = paramiko.ECDSAKey.generate()
    listening = socket.create_server(("127.0.0.1", 0))
    threading.Thread(target=serve, args=(listening, key), daemon=True).start()
    answer = {"port": listening.getsockname()[1], "key": f"{key.get_name()} {key.get_base64()}"}
    print(json.dumps({"ok": answer}), flush=True)
    sys.stdin.read()
    os._exit(0)


def serve(listening: socket.socket, key: Any) -> None:
    """Each connection."""
    while True:
        connection, _ = listening.accept()
        transport = paramiko.Transport(connection)
        transport.add_server_key(key)
        transport.set_subsystem_handler("sftp", paramiko.SFTPServer, Files)
        transport.start_server(event=threading.Event(), server=Login())


if __name__ == "__main__":
    main()
