"""pyftpdlib's server on loopback: ``python ftp_server.py FOLDER USER PASSWORD``; the first line has its port."""

from __future__ import annotations

import json
import logging
import os
import sys
import threading

from pyftpdlib.authorizers import DummyAuthorizer
from pyftpdlib.handlers import FTPHandler
from pyftpdlib.servers import FTPServer


def main() -> None:
    """Run until standard input ends."""
    logging.basicConfig(level=logging.ERROR)
    folder, user, password = sys.argv[1:]
    authorizer = DummyAuthorizer()
    authorizer.add_user(user, password, folder, perm="elradfmwMT")
    FTPHandler.authorizer = authorizer
    server = FTPServer(("127.0.0.1", 0), FTPHandler)
    threading.Thread(target=ends_with_input, daemon=True).start()
    print(json.dumps({"ok": server.address[1]}), flush=True)
    server.serve_forever(handle_exit=False)


def ends_with_input() -> None:
    """End this process when standard input ends: the parent process has ended."""
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    main()
