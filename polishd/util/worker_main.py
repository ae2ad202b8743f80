"""The process behind ``WorkerProcess``: ``python -m polishd.util.worker_main MODULE:FUNCTION LIFELINE``.

FUNCTION returns what the worker states when it is ready, and the function that answers its requests. LIFELINE is the
read end of a pipe whose other end only the parent has.
"""

from __future__ import annotations

import fcntl
import importlib
import os
import resource
import select
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from numpy.typing import NDArray

from polishd.model.errors import FrameError, PolishdError
from polishd.util import array_stream
from polishd.util.array_stream import Message

AnswerFunction = Callable[[dict[str, Any], dict[str, NDArray[Any]]], Message]
OOM_SCORE = 500
"""Of 1000. Where memory is out, the kernel ends a worker, which is replaced, before its parent."""


def serve(answer: AnswerFunction, requests: BinaryIO, answers: BinaryIO) -> int:
    """Answer requests until their stream ends; return the exit code.

    A PolishdError is answered as ``error``, and the next request is read. After a frame whose end is unknown, the code
    is 1. Any other exception ends the process.
    """
    while True:
        try:
            request = array_stream.read(requests)
        except FrameError as error:
            array_stream.write(answers, {"error": str(error)})
            return 1
        if request is None:
            return 0
        try:
            pieces = array_stream.encode(*answer(*request))
        except PolishdError as error:
            pieces = array_stream.encode({"error": str(error)})
        answers.writelines(pieces)
        answers.flush()


def main() -> int:
    """Prepare the process, state that it is ready, and serve. What the target prints goes to stderr."""
    target, lifeline = sys.argv[1:]
    _end_with_parent(int(lifeline))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for number in (signal.SIGINT, signal.SIGTERM):  # a terminal and systemd send them to all; the parent decides
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(OOM_SCORE))
    # Copies that no child process inherits. They stay open until the process has ended: the parent takes the end of
    # the answers for the end of the process.
    requests = os.fdopen(os.dup(0), "rb", closefd=False)
    answers = os.fdopen(os.dup(1), "wb", closefd=False)
    with Path(os.devnull).open("rb") as empty:
        os.dup2(empty.fileno(), 0)
    os.dup2(2, 1)
    module, _, function = target.partition(":")
    ready, answer = getattr(importlib.import_module(module), function)()
    array_stream.write(answers, {"ready": ready})
    return serve(answer, requests, answers)


def _end_with_parent(lifeline: int) -> None:
    """Let the kernel kill this process when its parent ends, however that happens and whatever runs here.

    Not by PR_SET_PDEATHSIG: it also kills when only the parent's thread ends that started this process. Elsewhere than
    on Linux the process ends at the end of its requests.
    """
    os.set_inheritable(lifeline, False)
    if sys.platform == "linux":
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
        if select.select([lifeline], [], [], 0.0)[0]:
            sys.exit("the parent has ended")


if __name__ == "__main__":
    sys.exit(main())
