"""Try mutants in parallel, with a time limit for each test."""

from __future__ import annotations

import os
import selectors
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tests.campaigns.mutation.mutants import Mutant
from tests.campaigns.mutation.trial import BEGUN, FAILED, Reporter, emptied, forked, reap

LIMIT_S, LIMIT_TIMES = 6.0, 10.0
"""Time limit of a test: additional seconds, and multiple of its time without a fault."""
IMPORT_S = 120.0
"""Time limit until the first test begins."""
KILLED, SURVIVED, TIMEOUT = "killed", "survived", "timeout"

Done = Callable[[Mutant, str, str], None]
"""Callback with a mutant, its end, and the test that ended it."""


@dataclass(slots=True)
class Trial:
    """Mutant that waits or runs."""

    mutant: Mutant
    work: Callable[[Reporter], None]
    seconds: Mapping[str, float]
    """Time of each test without a fault."""
    pid: int = 0
    received: str = ""
    test: str = ""
    until_s: float = field(default_factory=lambda: time.monotonic() + IMPORT_S)

    def receive(self, text: str) -> str:
        """Process output of the child and return how the mutant ended, or ""; empty text is the end of the child."""
        if not text:
            return KILLED  # the child died without a message
        *lines, self.received = (self.received + text).split("\n")
        for line in lines:
            word, _, nodeid = line.partition(" ")
            if word != BEGUN:
                self.test = nodeid if "::" in nodeid else self.test or nodeid
                return KILLED if word == FAILED else SURVIVED
            self.test = nodeid
            self.until_s = time.monotonic() + LIMIT_S + LIMIT_TIMES * self.seconds.get(nodeid, 1.0)
        return ""


def run(trials: Iterable[Trial], jobs: int, folder: Path, done: Done, until_s: float) -> bool:
    """Try the mutants, ``jobs`` at a time, and return whether all were tried before ``until_s``."""
    waiting = iter(trials)
    with selectors.DefaultSelector() as pipes:
        while True:
            while len(pipes.get_map()) < jobs and time.monotonic() < until_s:
                trial = next(waiting, None)
                if trial is None:
                    break
                trial.pid, pipe = forked(trial.work, folder)
                trial.until_s = time.monotonic() + IMPORT_S
                pipes.register(pipe, selectors.EVENT_READ, trial)
            if not pipes.get_map():
                return next(waiting, None) is None
            _listen(pipes, done, folder)


def _listen(pipes: selectors.BaseSelector, done: Done, folder: Path) -> None:
    """Read the output of the children and end those that are done or hang."""
    ready = {key.fd for key, _ in pipes.select(timeout=0.5)}
    for key in list(pipes.get_map().values()):
        trial: Trial = key.data
        end = trial.receive(os.read(key.fd, 65536).decode()) if key.fd in ready else ""
        if not end and time.monotonic() > trial.until_s:
            end = TIMEOUT
        if end:
            pipes.unregister(key.fd)
            os.close(key.fd)
            reap(trial.pid)
            done(trial.mutant, end, trial.test)
    if not pipes.get_map():
        shutil.rmtree(emptied(folder), ignore_errors=True)
        folder.mkdir(exist_ok=True)
