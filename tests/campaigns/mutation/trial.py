"""One mutant: a child is forked, the fault put in there, and its tests are run until one of them fails.

A fault in a function is put into the function that is there already (``__code__``): whoever has imported it has it.
What runs when a module is imported needs a child in which nothing of polishd is imported yet.
"""

from __future__ import annotations

import contextlib
import gc
import io
import os
import resource
import shutil
import signal
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, NoReturn

import pytest

from tests.campaigns.mutation.mutants import Module, Mutant

MEMORY_BYTES = 6 << 30
BEGUN, FAILED, ENDED = "begun", "failed", "ended"
"""Words of a child: ``begun`` and ``failed`` with the test's name."""
Functions = Mapping[tuple[str, int], Sequence[FunctionType]]
"""By file and first line."""


class Telling:
    """Of pytest: says which test runs, and ends the child with the first that fails."""

    def __init__(self, pipe: int) -> None:
        self._pipe = pipe

    def say(self, word: str, nodeid: str = "") -> None:
        """One line."""
        os.write(self._pipe, f"{word} {nodeid}\n".encode())

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """It begins."""
        self.say(BEGUN, nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """One of its parts is over."""
        if report.failed:
            self.say(FAILED, report.nodeid)
            os._exit(1)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A module that cannot be imported with the fault in it is seen, too."""
        if report.failed:
            self.say(FAILED, report.nodeid)
            os._exit(1)


class Chosen:
    """Of pytest: these tests only, the quick ones first."""

    def __init__(self, order: Sequence[str]) -> None:
        self._order = {nodeid: k for k, nodeid in enumerate(order)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """All others are left out."""
        items[:] = sorted((one for one in items if one.nodeid in self._order), key=lambda one: self._order[one.nodeid])


def forked(work: Callable[[Telling], None], folder: Path) -> tuple[int, int]:
    """A child in a session of its own which does that work: its id, and where it can be heard."""
    ours, its = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(ours)
        _alone(folder)
        _end(work, Telling(its))
    os.close(its)
    return pid, ours


def _alone(folder: Path) -> None:
    """In a session of its own, so that all that it starts can be ended, quiet, and with its own temporary files."""
    os.setsid()
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    quiet = os.open(os.devnull, os.O_RDWR)
    for handle in (0, 1, 2):
        os.dup2(quiet, handle)
    os.environ["TMPDIR"] = tempfile.tempdir = tempfile.mkdtemp(dir=folder)


def _end(work: Callable[[Telling], None], telling: Telling) -> NoReturn:
    try:
        work(telling)
        telling.say(ENDED)
    except BaseException as error:  # noqa: BLE001 - a fault may raise anything, anywhere
        telling.say(FAILED, type(error).__name__)
    finally:
        os._exit(0)


def reap(pid: int) -> None:
    """End the child with all that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)


def functions_of(paths: Sequence[str]) -> Functions:
    """Those that are there, of these files; wrapped ones, too."""
    found: dict[tuple[str, int], list[FunctionType]] = {}
    gc.unfreeze()
    for one in gc.get_objects():
        if isinstance(one, FunctionType) and one.__code__.co_filename in paths:
            found.setdefault((one.__code__.co_filename, one.__code__.co_firstlineno), []).append(one)
    gc.freeze()
    return found


def in_function(
    session: pytest.Session, functions: Functions, module: Module, mutant: Mutant, order: Sequence[str]
) -> Callable[[Telling], None]:
    """Run these tests, collected already, with the fault in a function."""

    def work(telling: Telling) -> None:
        assert mutant.unit_line is not None
        code = function_code(module.code(mutant), mutant.unit_line)
        for function in functions[mutant.path, mutant.unit_line]:
            function.__code__ = code
        plugins = session.config.pluginmanager
        terminal: Any = plugins.get_plugin("terminalreporter")
        terminal._tw._file = io.StringIO()
        plugins.register(telling)
        by_name = {item.nodeid: item for item in session.items}
        items = [by_name[nodeid] for nodeid in order]
        for item, following in zip(items, [*items[1:], None], strict=True):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)

    return work


def in_import(
    module: Module, mutant: Mutant, order: Sequence[str], options: Sequence[str]
) -> Callable[[Telling], None]:
    """Import polishd with the fault in it, and run these tests."""

    def work(telling: Telling) -> None:
        code, plain = module.code(mutant), SourceFileLoader.get_code

        def get_code(loader: SourceFileLoader, name: str) -> Any:
            return code if loader.path == mutant.path else plain(loader, name)

        SourceFileLoader.get_code = get_code  # type: ignore[method-assign, assignment]
        files = sorted({nodeid.partition("::")[0] for nodeid in order})
        # pytest loads polishd by a loader of its own, for its asserts: polishd has an entry point of pytest
        if pytest.main([*options, "--assert=plain", *files], [telling, Chosen(order)]) != pytest.ExitCode.OK:
            telling.say(FAILED, "pytest")
            os._exit(1)

    return work


def function_code(code: CodeType, line: int) -> CodeType:
    """That of the function that begins in that line."""
    for one in code.co_consts:
        if isinstance(one, CodeType):
            if one.co_firstlineno == line and not one.co_name.startswith("<") and one.co_flags & 0x2:
                return one
            if one.co_firstlineno <= line:
                with contextlib.suppress(LookupError):
                    return function_code(one, line)
    raise LookupError(line)


def emptied(folder: Path) -> Path:
    """A folder for what tests write."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder
