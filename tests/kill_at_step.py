"""Kill a process at each step of its work: a forked process gets SIGKILL at the n-th of its marked steps."""

from __future__ import annotations

import os
import signal
import traceback
from collections.abc import Callable
from typing import Any

FAULT = 70


class Steps:
    """Count the steps of one process and kill it at the step with that number."""

    def __init__(self, last: int) -> None:
        self._last, self._seen = last, 0

    def mark(self) -> None:
        """Count one step; kill this process if it is the last."""
        self._seen += 1
        if self._seen == self._last:
            os.kill(os.getpid(), signal.SIGKILL)

    def around(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function with a step before and a step after each call."""

        def marked(*values: Any, **named: Any) -> Any:
            self.mark()
            found = function(*values, **named)
            self.mark()
            return found

        return marked


def killed_at(number: int, work: Callable[[Steps], None]) -> bool:
    """Run the work in a forked process and return whether it was killed at that step; False: the work completed.

    With 0 the work always completes. AssertionError where it raised an error.
    """
    child = os.fork()
    if child == 0:
        try:
            work(Steps(number))
        except BaseException:  # noqa: BLE001 - the parent process must not run on in the child
            traceback.print_exc()
            os._exit(FAULT)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL
        return True
    assert os.WEXITSTATUS(status) == 0, "the work raised an error: see its traceback"
    return False
