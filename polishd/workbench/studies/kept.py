"""Jobs of a study that were done before: a line each in ``runs.jsonl``, so that a study goes on where it was."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from polishd import __version__
from polishd.files import write_atomic
from polishd.model.errors import ConfigError
from polishd.workbench.studies.loop import ERROR, Run

RUNS = "runs.jsonl"
Case = tuple[str, str, int]
"""Scenario, loop and seed."""


class Kept:
    """The file, which only grows: of a case that was done more than once, the last line counts."""

    def __init__(self, folder: Path | None) -> None:
        """``folder`` None: nothing is kept. ConfigError for a line that is none of ours; a torn last one is dropped."""
        self._path = None if folder is None else folder / RUNS
        self._done: dict[Case, tuple[str, Run]] = {}
        if self._path is not None and self._path.exists():
            for case_of, run in _read(self._path):
                self._done[run.scenario, run.loop, run.seed] = case_of, run

    def find(self, case: Case, of: str) -> Run | None:
        """What that case came to, where it was made of the same; one that ended in an error is tried again."""
        made_of, run = self._done.get(case, ("", None))
        return run if run is not None and made_of == of and run.ended != ERROR else None

    def add(self, run: Run, of: str) -> None:
        """One more line, at once."""
        if self._path is None:
            return
        line = json.dumps({"of": of, **asdict(run)})
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
        except OSError as error:
            raise ConfigError(f"{self._path}: cannot be written to: {error.strerror}; make room, and go on") from error


def made_of(*parts: tuple[Mapping[str, Any], Path]) -> str:
    """Hash of what decides a case: polishd's version, the parts, and the files that they name beside their folders."""
    told = hashlib.sha256(__version__.encode())
    for part, folder in parts:
        told.update(json.dumps(part, sort_keys=True, default=str).encode())
        for name in _texts(part):
            path = folder / name
            if len(name) < 256 and path.is_file():
                told.update(hashlib.sha256(path.read_bytes()).digest())
    return told.hexdigest()[:16]


def _read(path: Path) -> Iterator[tuple[str, Run]]:
    lines = path.read_text(encoding="utf-8").split("\n")
    torn = lines.pop()
    if torn:  # killed while it wrote: the next line begins anew
        write_atomic(path, "".join(f"{line}\n" for line in lines).encode())
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
            of = str(row.pop("of"))
            run = Run(**{key: _frozen(value) for key, value in row.items()})
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise ConfigError(
                f"{path}:{number}: is no job of a study; take the line out, or name another folder with --out"
            ) from error
        yield of, run


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _texts(one)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _texts(one)
