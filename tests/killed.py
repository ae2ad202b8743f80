"""``kill -9`` at each step of what a process does: it is forked, and ends at the n-th of the steps that were marked."""

from __future__ import annotations

import os
import signal
import traceback
from collections.abc import Callable
from typing import Any

FAULT = 70


class Steps:
    """Those of one process, as they come; at the one of that number the kernel ends it."""

    def __init__(self, last: int) -> None:
        self._last, self._seen = last, 0

    def mark(self) -> None:
        """One more."""
        self._seen += 1
        if self._seen == self._last:
            os.kill(os.getpid(), signal.SIGKILL)

    def around(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same, with a step before it and one after it."""

        def marked(*values: Any, **named: Any) -> Any:
            self.mark()
            found = function(*values, **named)
            self.mark()
            return found

        return marked


def killed_at(number: int, work: Callable[[Steps], None]) -> bool:
    """Whether the kernel ended that work at that step of it, in a process of its own; False: it came to its end.

    0 is no step: then it always does. AssertionError where it failed.
    """
    child = os.fork()
    if child == 0:
        try:
            work(Steps(number))
        except BaseException:  # noqa: BLE001 - what forked this process goes on in the other one
            traceback.print_exc()
            os._exit(FAULT)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL
        return True
    assert os.WEXITSTATUS(status) == 0, "it failed: see what it printed"
    return False
