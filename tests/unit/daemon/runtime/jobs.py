"""Functions for the compute worker, in a separate module because the worker imports them by name."""

from __future__ import annotations

import math
import os
import signal
import threading
import time

import numpy as np
from numpy.typing import NDArray

from polishd.model.errors import MapError, PolishdError


def double(values: NDArray[np.float64]) -> NDArray[np.float64]:
    values *= 2  # arguments are the worker's own: writable
    return values


def pid() -> int:
    return os.getpid()


def say(text: str) -> str:
    print(text)
    os.write(1, b"raw")
    return text


def variable(name: str) -> str | None:
    return os.environ.get(name)


def forever() -> None:
    while True:
        time.sleep(3600)


def burn(seconds: float) -> int:
    """Use this many seconds of CPU time, not of wall time."""
    until = time.process_time() + seconds
    while time.process_time() < until:
        pass
    return os.getpid()


def burn_on() -> None:
    burn(math.inf)


def threads_burn_on() -> None:
    """Keep all threads except the calling one busy."""
    for _ in range(2):
        threading.Thread(target=burn_on, daemon=True).start()
    forever()


def nice() -> int:
    return os.getpriority(os.PRIO_PROCESS, 0)


def ignore_everything() -> None:
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)
    burn_on()


def die(code: int) -> None:
    os._exit(code)


def be_killed() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def bad_map() -> None:
    error = MapError("a hole")
    error.add_note("at 3, 4")
    raise error


def divide(a: float, b: float) -> float:
    return a / b


class Stubborn(PolishdError):
    def __init__(self, one: str, two: str) -> None:
        super().__init__(f"{one} and {two}")


def stubborn() -> None:
    raise Stubborn("this", "that")


def unpicklable() -> object:
    return lambda: None
