"""Try one mutant: fork a child process, insert the fault there, and run its tests until one of them fails.

A fault in a function is put into the existing function (``__code__``), so that all modules that imported it use it.
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
"""Messages of a child; ``begun`` and ``failed`` come with the test's name."""
Functions = Mapping[tuple[str, int], Sequence[FunctionType]]
"""Functions by file and first line."""


class Reporter:
    """Plugin of pytest that reports which test runs, and ends the child with the first that fails."""

    def __init__(self, pipe: int) -> None:
        self._pipe = pipe

    def say(self, word: str, nodeid: str = "") -> None:
        """Write one line to the pipe."""
        os.write(self._pipe, f"{word} {nodeid}\n".encode())

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Report that a test begins."""
        self.say(BEGUN, nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Report a failed setup, call or teardown, and end the child."""
        if report.failed:
            self.say(FAILED, report.nodeid)
            os._exit(1)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Report a module that cannot be imported with the fault, and end the child."""
        if report.failed:
            self.say(FAILED, report.nodeid)
            os._exit(1)


class Chosen:
    """Plugin of pytest that selects these tests, in this order."""

    def __init__(self, order: Sequence[str]) -> None:
        self._order = {nodeid: k for k, nodeid in enumerate(order)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep the selected tests only."""
        items[:] = sorted((one for one in items if one.nodeid in self._order), key=lambda one: self._order[one.nodeid])


def forked(work: Callable[[Reporter], None], folder: Path) -> tuple[int, int]:
    """Fork a child for the work; return its process id and the file descriptor of its messages."""
    ours, its = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(ours)
        _alone(folder)
        _end(work, Reporter(its))
    os.close(its)
    return pid, ours


def _alone(folder: Path) -> None:
    """Give the child a session (so that its processes can be ended), no output, and a temporary folder."""
    os.setsid()
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    quiet = os.open(os.devnull, os.O_RDWR)
    for handle in (0, 1, 2):
        os.dup2(quiet, handle)
    os.environ["TMPDIR"] = tempfile.tempdir = tempfile.mkdtemp(dir=folder)


def _end(work: Callable[[Reporter], None], reporter: Reporter) -> NoReturn:
    try:
        work(reporter)
        reporter.say(ENDED)
    except BaseException as error:  # noqa: BLE001 - a fault may raise anything, anywhere
        reporter.say(FAILED, type(error).__name__)
    finally:
        os._exit(0)


def reap(pid: int) -> None:
    """Kill the child with all processes that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)


def functions_of(paths: Sequence[str]) -> Functions:
    """Return the existing functions of these files, also wrapped ones."""
    found: dict[tuple[str, int], list[FunctionType]] = {}
    gc.unfreeze()
    for one in gc.get_objects():
        if isinstance(one, FunctionType) and one.__code__.co_filename in paths:
            found.setdefault((one.__code__.co_filename, one.__code__.co_firstlineno), []).append(one)
    gc.freeze()
    return found


def in_function(
    session: pytest.Session, functions: Functions, module: Module, mutant: Mutant, order: Sequence[str]
) -> Callable[[Reporter], None]:
    """Return the work that runs these collected tests with the fault in a function."""

    def work(reporter: Reporter) -> None:
        assert mutant.unit_line is not None
        code = function_code(module.code(mutant), mutant.unit_line)
        for function in functions[mutant.path, mutant.unit_line]:
            function.__code__ = code
        plugins = session.config.pluginmanager
        terminal: Any = plugins.get_plugin("terminalreporter")
        terminal._tw._file = io.StringIO()
        plugins.register(reporter)
        by_name = {item.nodeid: item for item in session.items}
        items = [by_name[nodeid] for nodeid in order]
        for item, following in zip(items, [*items[1:], None], strict=True):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)

    return work


def in_import(
    module: Module, mutant: Mutant, order: Sequence[str], options: Sequence[str]
) -> Callable[[Reporter], None]:
    """Return the work that imports polishd with the fault and runs these tests."""

    def work(reporter: Reporter) -> None:
        code, plain = module.code(mutant), SourceFileLoader.get_code

        def get_code(loader: SourceFileLoader, name: str) -> Any:
            return code if loader.path == mutant.path else plain(loader, name)

        SourceFileLoader.get_code = get_code  # type: ignore[method-assign, assignment]
        files = sorted({nodeid.partition("::")[0] for nodeid in order})
        # pytest loads polishd with its assertion-rewriting loader: polishd has an entry point of pytest
        if pytest.main([*options, "--assert=plain", *files], [reporter, Chosen(order)]) != pytest.ExitCode.OK:
            reporter.say(FAILED, "pytest")
            os._exit(1)

    return work


def function_code(code: CodeType, line: int) -> CodeType:
    """Return the code of the function that begins in that line. LookupError where there is none."""
    for one in code.co_consts:
        if isinstance(one, CodeType):
            if one.co_firstlineno == line and not one.co_name.startswith("<") and one.co_flags & 0x2:
                return one
            if one.co_firstlineno <= line:
                with contextlib.suppress(LookupError):
                    return function_code(one, line)
    raise LookupError(line)


def emptied(folder: Path) -> Path:
    """Create an empty folder for the files of tests."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder
