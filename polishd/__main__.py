"""Entry point of ``polishd`` and ``python -m polishd``: sets the handling of Ctrl-C before any import."""

from __future__ import annotations

import gc
import signal
import sys
from types import FrameType
from typing import NoReturn

IMPORTS = "<frozen importlib._bootstrap>"
"""File name in the frames of a running import."""
LATER_S = 0.01
NEW_OBJECTS = 10_000
"""New objects between two garbage collections: while a command starts, hundreds of them would find nothing."""
INTERRUPTED = 130
"""Exit code that shells give to a process ended by SIGINT."""


def main() -> None:
    """Run the command line. Ctrl-C always ends it with exit code 130 and without a traceback."""
    gc.set_threshold(NEW_OBJECTS)
    try:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # nohup ignores the signal
            signal.signal(signal.SIGALRM, _interrupt)
            signal.signal(signal.SIGINT, _interrupt)
            sys.unraisablehook = _unraisable
        from polishd.cli.app import main as command_line

        command_line()
    except KeyboardInterrupt:
        _leave(INTERRUPTED)
    except SystemExit as ended:
        _leave(ended.code)
    finally:
        if signal.getsignal(signal.SIGINT) in {_interrupt, signal.default_int_handler}:
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # no cleanup remains while Python ends
            signal.setitimer(signal.ITIMER_REAL, 0)
        if not gc.isenabled():  # a command without collections, which leaves nothing open
            gc.freeze()  # nor one of all objects while Python ends: a tenth of the time of polishd check


def _leave(code: object) -> NoReturn:
    """Exit without waiting for hanging threads."""
    if (threads := sys.modules.get("polishd.util.threads")) is not None:
        threads.exit_if_hung(code if isinstance(code, int) else int(code is not None))
    sys.exit(code)  # type: ignore[arg-type]


def _interrupt(_number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, but not inside an import: C modules print it and raise another exception.

    Imports take at most a second; then it is raised.
    """
    while frame is not None:
        if frame.f_code.co_filename == IMPORTS:
            signal.setitimer(signal.ITIMER_REAL, LATER_S)
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def _unraisable(ignored: sys.UnraisableHookArgs) -> None:
    """Repeat an interrupt that came where no exception can be raised, for example in a destructor."""
    if issubclass(ignored.exc_type, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, LATER_S)
    else:
        sys.__unraisablehook__(ignored)


if __name__ == "__main__":
    main()
