"""Targets for the tests of worker processes, which behave as a request names."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polishd.model.errors import MapError
from polishd.util.array_stream import Message
from polishd.util.worker_main import AnswerFunction

Arrays = dict[str, NDArray[Any]]


def start() -> tuple[dict[str, Any], AnswerFunction]:
    return {"pid": os.getpid()}, answer


def start_slowly() -> tuple[dict[str, Any], AnswerFunction]:
    while time.process_time() < 1.1:
        pass
    return start()


def fail() -> tuple[dict[str, Any], AnswerFunction]:
    raise ModuleNotFoundError("no module named so")


def start_in_vain() -> tuple[dict[str, Any], AnswerFunction]:
    raise OSError("out of luck")


def hang() -> tuple[dict[str, Any], AnswerFunction]:
    hang_in_c()
    raise AssertionError


def hang_in_c() -> None:
    """Hang without releasing the interpreter lock."""
    ctypes.PyDLL(None).usleep(600_000_000)


def burn() -> None:
    while True:
        pass


def burn_in_threads() -> None:
    for _ in range(2):
        threading.Thread(target=burn, daemon=True).start()
    signal.pause()


def answer(message: dict[str, Any], arrays: Arrays) -> Message:  # noqa: C901
    match message["do"]:
        case "echo":
            return {"echo": message.get("what")}, arrays
        case "environment":
            return {"names": dict(os.environ), "path": sys.path}, {}
        case "refuse":
            raise MapError("torn")
        case "raise":
            raise ZeroDivisionError("of a target")
        case "large head":
            return {"text": "x" * (1 << 22)}, {}
        case "exit":
            sys.stderr.write("first\nout of luck\n")
            sys.exit(7)
        case "crash":
            ctypes.string_at(0)
        case "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        case "burn":
            burn()
        case "burn in threads":
            burn_in_threads()
        case "hang":
            hang_in_c()
        case "hang while printing":
            sys.stderr.write("about to hang\n")
            sys.stderr.flush()
            hang_in_c()
        case "print":
            for _ in range(4000):
                sys.stderr.write("x" * 99 + "\n")
                print("and on stdout")
            os.write(1, b"last of all\n")
        case "allocate":
            try:
                np.ones(message["bytes"], np.uint8)
            except MemoryError:
                return {"refused": True}, {}
            return {"refused": False}, {}
        case "allocate and die":
            np.ones(message["bytes"], np.uint8)
        case "child":
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
            return {"pid": child.pid}, {}
        case "child reads":
            return {"read": subprocess.run(["cat"], capture_output=True, check=True).stdout.decode()}, {}
        case "send":
            left = message["what"].encode() * message.get("times", 1)
            while left:
                left = left[os.write(answers_pipe(), left) :]
            if message.get("then") == "exit":
                os._exit(3)
            time.sleep(600)
        case _:
            raise AssertionError(json.dumps(message))
    return {}, {}


def answers_pipe() -> int:
    """Return the pipe of the answers, as hostile code in the worker could find it."""
    for number in range(3, 64):
        try:
            is_pipe = Path(f"/proc/self/fd/{number}").readlink().name.startswith("pipe:")
            flags = Path(f"/proc/self/fdinfo/{number}").read_text().split("flags:")[1].split()[0]
        except OSError:
            continue
        if is_pipe and int(flags, 8) & os.O_ACCMODE == os.O_WRONLY:
            return number
    raise AssertionError("no pipe to write to")
