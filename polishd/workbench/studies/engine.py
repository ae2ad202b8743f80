"""The engine of studies: cases go to an executor in tasks, and what comes of each is handed on as it comes."""

from __future__ import annotations

import math
import uuid
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import dataclass, replace
from pathlib import Path

from polishd.model.errors import ConfigError
from polishd.workbench.studies.case import Case, versions
from polishd.workbench.studies.children import CaseResult, Task
from polishd.workbench.studies.executors import LOST, Executor

TASK_S = 1.0
"""Work of a task, about: of less, the wire would be most of it."""
MOST_CASES = 500
TRIES = 2
WITHIN_S = 600.0
"""Wall time of a case, unless told."""
LOOK_S = 5.0
"""After so long without an answer it is asked whether anybody works."""


@dataclass(frozen=True, slots=True)
class FinishedCase:
    """A case, and what came of it at its last try."""

    case: Case
    answer: CaseResult
    tries: int


def _silent(words: str) -> None:
    """Nobody waits at a terminal."""


def work(
    study: Path,
    cases: Sequence[Case],
    executor: Executor,
    within_s: float = WITHIN_S,
    tell: Callable[[str], None] = _silent,
) -> Iterator[FinishedCase]:
    """Each as it ends, in any order. One that fails, hangs or kills its worker is tried once more, and by itself.

    Where nobody is there to work, ``tell`` is told once, and once more when somebody has come.
    ConfigError where a worker refuses them all: other versions, other files.
    """
    whole = Task(str(study), uuid.uuid4().hex, versions(), within_s, ())
    fresh, again = deque(cases), deque[Case]()
    running: dict[Future[list[CaseResult]], tuple[Case, ...]] = {}
    tried: dict[int, int] = {}
    pace, lack = _Pace(), _Lack(executor, tell)
    while fresh or again or running:
        while (fresh or again) and len(running) < max(executor.slots, 1):  # one more would wait behind a long one
            some = (again.popleft(),) if again else tuple(fresh.popleft() for _ in range(min(pace.cases, len(fresh))))
            running[executor.submit(replace(whole, cases=some))] = some
        ended = wait(running, timeout=LOOK_S, return_when=FIRST_COMPLETED).done
        lack.look(ended)
        for future in ended:
            for case, answer in zip(some := running.pop(future), _answers(future, some), strict=True):
                tried[case.number] = tried.get(case.number, 0) + 1
                if answer.error and tried[case.number] < TRIES:
                    again.append(case)
                    continue
                pace.add(answer)
                yield FinishedCase(case, answer, tried[case.number])


def _answers(future: Future[list[CaseResult]], cases: Sequence[Case]) -> list[CaseResult]:
    """Of each case; where the whole task was lost, why."""
    try:
        return future.result()
    except ConfigError:
        raise
    except CancelledError as error:
        raise ConfigError(LOST) from error
    except Exception as error:  # noqa: BLE001  a cluster loses tasks in ways of its own
        return [CaseResult(case.number, error=f"its task was lost: {type(error).__name__}: {error}") for case in cases]


class _Lack:
    """Says once that there is nobody to work, and once that there is again."""

    def __init__(self, executor: Executor, tell: Callable[[str], None]) -> None:
        self._executor, self._tell, self._told = executor, tell, False

    def look(self, ended: Collection[object]) -> None:
        """After each wait. Asked only when nothing has ended for a while, or that was told before."""
        lack = "" if ended else self._executor.lack
        if bool(lack) != self._told:
            self._told = not self._told
            self._tell(f"{lack}; it is waited for" if lack else "a worker is there; the study goes on")


class _Pace:
    """How many cases are a task's work, by those that have ended."""

    def __init__(self) -> None:
        self._spent_s, self._ended = 0.0, 0

    def add(self, answer: CaseResult) -> None:
        self._spent_s, self._ended = self._spent_s + answer.wall_s, self._ended + 1

    @property
    def cases(self) -> int:
        if not self._ended:
            return 1
        return min(math.ceil(TASK_S * self._ended / max(self._spent_s, 1e-6)), MOST_CASES)
