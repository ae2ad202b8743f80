"""The entry point, as ``polishd`` and ``python -m polishd``: settles what Ctrl-C does before anything is imported."""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import NoReturn

IMPORTS = "<frozen importlib._bootstrap>"
"""The file of the frames of an import that is under way."""
LATER_S = 0.01
INTERRUPTED = 130
"""The exit code that shells give to what SIGINT ended."""


def main() -> None:
    """Run the command line. Ctrl-C is exit code 130, and no traceback, whenever it comes."""
    try:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # it is ignored behind nohup
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
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # nothing is left to tidy up while Python ends
            signal.setitimer(signal.ITIMER_REAL, 0)


def _leave(code: object) -> NoReturn:
    """Exit, whatever hangs."""
    if (threads := sys.modules.get("polishd.util.threads")) is not None:
        threads.exit_if_hung(code if isinstance(code, int) else int(code is not None))
    sys.exit(code)  # type: ignore[arg-type]


def _interrupt(_number: int, frame: FrameType | None) -> None:
    """KeyboardInterrupt, but not inside an import: modules in C print it, and raise something else.

    Imports take a second at most; then it is raised.
    """
    while frame is not None:
        if frame.f_code.co_filename == IMPORTS:
            signal.setitimer(signal.ITIMER_REAL, LATER_S)
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def _unraisable(ignored: sys.UnraisableHookArgs) -> None:
    """An interrupt that came where nothing can be raised, as in a destructor, comes again."""
    if issubclass(ignored.exc_type, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, LATER_S)
    else:
        sys.__unraisablehook__(ignored)


if __name__ == "__main__":
    main()
