"""The worker process: takes one pickled call after another, answers with its result or its exception."""

from __future__ import annotations

import ctypes
import importlib
import os
import pickle
import signal
import struct
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from polishd.daemon.runtime.installed import installed_now
from polishd.daemon.runtime.process import compute_last
from polishd.model.errors import ComputeError, PolishdError

LENGTH = struct.Struct("<Q")
EARLY = ("polishd.hookspecs", "scipy.fft", "scipy.ndimage", "scipy.sparse", "scipy.spatial")
"""Imported before ready: no call's deadline pays for them."""
_PR_SET_PDEATHSIG = 1


def pack(value: object) -> list[bytes | memoryview]:
    """Pieces of one message: count, then length and bytes of the pickle and of each array in it (not copied)."""
    buffers: list[pickle.PickleBuffer] = []
    main = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    pieces: list[bytes | memoryview] = [main, *(buffer.raw() for buffer in buffers)]
    framed: list[bytes | memoryview] = [LENGTH.pack(len(pieces))]
    for piece in pieces:
        framed += [LENGTH.pack(len(piece)), piece]
    return framed


OOM_SCORE = 500
"""Of 1000: what the kernel ends first where memory is out."""


def unpack(pieces: list[bytes]) -> Any:
    """The value of a message's pieces; arrays are writable."""
    main, *buffers = pieces
    # Both ends are this program, on a pipe that nobody else has.
    return pickle.loads(main, buffers=[bytearray(buffer) for buffer in buffers])  # noqa: S301


def main() -> None:
    """Serve calls on stdin and stdout until stdin ends. What a call prints goes to stderr."""
    _die_with_parent()
    _die_before_parent()
    compute_last()
    for name in EARLY:
        importlib.import_module(name)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the daemon's to answer
    calls = sys.stdin.buffer
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        _write(answers, ("ready", installed_now()))
        while (pieces := _read(calls)) is not None:
            _write(answers, _answer(pieces))


def _answer(pieces: list[bytes]) -> tuple[str, object]:
    name = "a call"
    try:
        call: tuple[Callable[..., object], tuple[object, ...]] = unpack(pieces)
        function, arguments = call
        name = getattr(function, "__qualname__", repr(function))
        return "result", function(*arguments)
    except PolishdError as error:
        return "error", _portable(error)
    except Exception as error:  # noqa: BLE001 - whatever it is, the caller hears of it
        failure = ComputeError(f"{name} failed: {type(error).__name__}: {error}")
        failure.add_note(traceback.format_exc())
        return "error", failure


def _portable(error: PolishdError) -> PolishdError:
    """The error itself where it survives pickling, else a ComputeError with its text."""
    try:
        unpack([pickle.dumps(error, protocol=5)])
    except Exception:  # noqa: BLE001 - a plugin's exception class may do anything here
        return ComputeError(f"{type(error).__name__}: {error}")
    return error


def _write(answers: BinaryIO, answer: tuple[str, object]) -> None:
    try:
        pieces = pack(answer)
    except Exception as error:  # noqa: BLE001 - a result that cannot travel is the call's error
        pieces = pack(("error", ComputeError(f"the result cannot be sent back: {error}")))
    answers.writelines(pieces)
    answers.flush()


def _read(calls: BinaryIO) -> list[bytes] | None:
    head = calls.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    return [calls.read(LENGTH.unpack(calls.read(LENGTH.size))[0]) for _ in range(LENGTH.unpack(head)[0])]


def _die_before_parent() -> None:
    """Where memory is out the kernel ends this process, which is replaced, and not the daemon, which may press."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(OOM_SCORE))


def _die_with_parent() -> None:
    """A daemon killed by -9 leaves no solver behind (Linux; elsewhere the end of stdin does, between calls)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    main()
