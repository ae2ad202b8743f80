"""``make mutate``: a test detects each small fault in the safety-relevant modules, or an explanation is given.

Goes on where an earlier session ended: a mutant is tried again where its module changed, the test that killed it, or,
of a survivor, any test of it.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import importlib
import itertools
import json
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from tests.campaigns.mutation import kept
from tests.campaigns.mutation.campaign import SURVIVED, Done, Trial, run
from tests.campaigns.mutation.covered import known_lines
from tests.campaigns.mutation.mutants import Module, Mutant
from tests.campaigns.mutation.scope import CHOSEN, KEPT, MODULES, ROOT, TESTS
from tests.campaigns.mutation.trial import Reporter, emptied, functions_of, in_function, in_import

HEAVY = ("numpy", "scipy.optimize", "scipy.sparse.linalg", "scipy.ndimage", "pydantic", "numba", "typer")
"""Modules that are imported once for all child processes."""
OPTIONS = ["-q", "-m", CHOSEN, "-p", "no:cacheprovider", "-p", "no:faulthandler"]
TMP = KEPT / "tmp"
ENDS = (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
"""Exit codes of pytest when it runs mutants instead of tests."""
SECONDS = 20.0
SOUND = 50
"""Number of tests that a module without a fault must pass first."""
Work = Callable[[Module, Mutant, Sequence[str]], Callable[[Reporter], None]]


class Tests:
    """Tests by the lines that they run."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.files = known_lines()
        self._of: dict[str, dict[int, list[str]]] = defaultdict(lambda: defaultdict(list))
        for one in self.files.values():
            for nodeid, test in one["tests"].items():
                self.seconds[nodeid] = test["seconds"]
                for module, lines in test["lines"].items():
                    for line in lines:
                        self._of[module][line].append(nodeid)

    def of(self, module: str, mutant: Mutant, within_s: float) -> list[str]:
        """Return the tests that run a line of the mutant within that time; for code at import, any line of the module.

        The tests of the module come first, by their file's name; quick tests precede slow ones.
        """
        lines, at_import = self._of[module], self.at_import(module, mutant)
        asked = lines if at_import else mutant.lines
        found = {nodeid for line in asked for nodeid in lines.get(line, ())}
        own = f"/test_{Path(module).stem.partition('_')[0]}"
        if at_import:
            found |= {
                nodeid for nodeid in self.seconds if own in nodeid
            }  # a test that reads a table runs no line of it
        order = sorted(found, key=lambda nodeid: (own not in nodeid, self.seconds[nodeid], nodeid))
        ends_s = itertools.accumulate(self.seconds[nodeid] for nodeid in order)
        return [nodeid for nodeid, end_s in zip(order, ends_s, strict=True) if end_s <= within_s]

    def at_import(self, module: str, mutant: Mutant) -> bool:
        """Return whether the mutant's code runs at import only: that of the module, or a function that no test runs."""
        return mutant.unit_line is None or not any(self._of[module].get(line) for line in mutant.lines)


class Campaign:
    """One session of the campaign."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.until_s = time.monotonic() + 60 * options.minutes
        self.tests = Tests()
        self.kept = kept.Kept()
        self.kept.begin_session(self.tests.files)
        self.modules = {name: Module(str(ROOT / name), (ROOT / name).read_text()) for name in self.names}
        self.tried = 0

    @property
    def names(self) -> Sequence[str]:
        """Names of the selected modules."""
        asked = self.options.modules
        return [name for name in MODULES if not asked or any(word in name for word in asked)]

    def to_try(self, *, at_import: bool) -> Iterator[tuple[Module, Mutant, Sequence[str]]]:
        """Yield the mutants whose end is unknown; those that no test runs have survived."""
        for name, module in self.modules.items():
            for mutant in module.mutants():
                if self.tests.at_import(name, mutant) is not at_import:
                    continue
                tests = self.kept.still_to_run(
                    mutant, self.tests.of(name, mutant, self.options.seconds), again=self.options.again
                )
                if tests:
                    yield module, mutant, tests
                elif tests is not None:
                    self.done(mutant, SURVIVED, "")

    def at_import(self) -> None:
        """Try mutants of code that runs at import, before this process imports polishd."""
        for name in HEAVY:
            importlib.import_module(name)
        self._run(functools.partial(in_import, options=OPTIONS), at_import=True)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Try all remaining mutants instead of the tests (hook of pytest)."""
        if session.testsfailed:
            raise session.Interrupted("not all tests could be collected: nothing can be said of any fault")
        functions = functions_of([module.path for module in self.modules.values()])
        self._run(functools.partial(in_function, session, functions), at_import=False)
        return True

    def done(self, mutant: Mutant, end: str, by: str) -> None:
        """Save the result and print survivors."""
        self.kept.add(mutant, end, by)
        self.tried += 1
        if end == SURVIVED:
            say(f"survived: {mutant.path}:{mutant.lines[-1]}: {mutant.key}")
        if self.tried % 20 == 0:
            self.kept.save()
            say(f"mutate: {self.tried} tried in this session")

    def _run(self, work: Work, *, at_import: bool) -> None:
        """Try all mutants whose end is unknown, after a check that a module without a fault survives.

        Their order is arbitrary and always the same: those that were tried before the time ended are a fair sample.
        """
        to_try = sorted(self.to_try(at_import=at_import), key=lambda trial: _arbitrary(trial[1]))
        self._run_trials(
            work, [(module, module.sound(mutant), tests[:SOUND]) for module, mutant, tests in to_try[:1]], self._held
        )
        self._run_trials(work, to_try, self.done)
        self.kept.save()

    def _run_trials(self, work: Work, to_try: Sequence[tuple[Module, Mutant, Sequence[str]]], done: Done) -> None:
        seconds = self.tests.seconds
        trials = (Trial(mutant, work(module, mutant, tests), seconds) for module, mutant, tests in to_try)
        run(trials, self.options.jobs, emptied(TMP), done, self.until_s)

    def _held(self, mutant: Mutant, end: str, by: str) -> None:
        """Check the result of a module without a fault. SystemExit where it did not survive."""
        if end != SURVIVED:
            raise SystemExit(f"mutate: {mutant.path} without a fault was {end} by {by}: nothing can be said of others")

    def verdict(self) -> Mapping[str, Sequence[str]]:
        """Return the failures by module; an incomplete module has only those that are known."""
        wrong: dict[str, Sequence[str]] = {}
        for name in self.modules:
            ends, why = self.kept.ends(name), kept.explained().get(name, {})
            keys = kept.keys_of(name)
            found = [f"not explained: {key}" for key in kept.unexplained(ends, why)]
            found += [f"explained for nothing: {key}" for key in kept.outdated(ends, why, keys)]
            if len(ends) < len(keys):
                say(f"mutate: {name}: {len(keys) - len(ends)} of {len(keys)} mutants are yet to be tried")
            if found:
                wrong[name] = found
        return wrong


def _arbitrary(mutant: Mutant) -> bytes:
    """Return a sort key that has nothing to do with module, line or kind of fault."""
    return hashlib.sha256(f"{mutant.path}: {mutant.key}".encode()).digest()


def say(*words: object) -> None:
    """Print progress."""
    os.write(2, (" ".join(map(str, words)) + "\n").encode())


def main() -> int:
    """Run the campaign and return the exit code: 1 where a surviving mutant has no explanation."""
    parse = argparse.ArgumentParser(prog="make mutate", description=__doc__)
    parse.add_argument("modules", nargs="*", help="those with such a name; default: all")
    parse.add_argument("--minutes", type=float, default=1e9, help="of this session; what was begun is ended")
    parse.add_argument("--jobs", type=int, default=2, help="mutants at a time")
    parse.add_argument("--seconds", type=float, default=SECONDS, help="of tests for each mutant, the quickest ones")
    parse.add_argument("--again", action="store_true", help="try survivors again, whatever is known of them")
    parse.add_argument("--known", action="store_true", help="do not measure again which tests run what")
    options = parse.parse_args()
    if not options.known:
        subprocess.run([sys.executable, "-m", "tests.campaigns.mutation.covered", "--changed"], check=True, cwd=ROOT)
    child = os.fork()  # where polishd is imported; here it never is
    if child == 0:
        os._exit(pytest.main([*OPTIONS, *TESTS], [Campaign(options)]) not in ENDS)
    if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
        return 2
    campaign = Campaign(options)
    campaign.at_import()
    kept.write_page(kept.table(campaign.kept))
    wrong = campaign.verdict()
    for name, found in wrong.items():
        say("\n  ".join([name, *found]))
    tried = sum(len(campaign.kept.ends(name)) for name in MODULES)
    print(json.dumps({"tried": tried, "wrong": sum(map(len, wrong.values()))}))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
