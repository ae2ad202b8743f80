"""Results of the mutation campaign: saved, compared with ``survivors.toml``, shown in docs/reference/results.md."""

from __future__ import annotations

import functools
import json
import platform
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tests.campaigns.mutation.campaign import KILLED, SURVIVED, TIMEOUT
from tests.campaigns.mutation.covered import content_of
from tests.campaigns.mutation.mutants import Module, Mutant
from tests.campaigns.mutation.scope import KEPT, MODULES, ROOT

EXPLAINED = Path(__file__).with_name("survivors.toml")
PAGE = ROOT / "docs" / "reference" / "results.md"
BEGIN, END = "<!-- written by make mutate -->\n", "<!-- end of what make mutate writes -->"
COLUMNS = (
    "module",
    "mutants",
    "killed",
    "ended by the limit of time",
    "survived, explained",
    "not explained",
    "not tried yet",
)
HELPERS = "what tests share"
SHARED = ("tests/fakes/*.py", "tests/unit/daemon/**/[!t]*.py", "tests/conftest.py", "tests/unit/*.py")


class Kept:
    """Content of ``results.json``: the hash of each module, and the end of each of its mutants."""

    def __init__(self, folder: Path = KEPT) -> None:
        self._path = folder / "results.json"
        kept = json.loads(self._path.read_text()) if self._path.exists() else {}
        self._modules: dict[str, Any] = kept.get("modules", {})
        self._sessions: list[dict[str, str]] = kept.get("sessions", [])
        """Hashes of all test files in each session."""
        for name in MODULES:
            if self._modules.get(name, {}).get("of") != content_of([name]):
                self._modules[name] = {"of": content_of([name]), "mutants": {}}

    def begin_session(self, files: Iterable[str]) -> None:
        """Begin a session with these test files."""
        now = {name: content_of([name]) for name in files}
        now[HELPERS] = content_of(sorted(str(path.relative_to(ROOT)) for one in SHARED for path in ROOT.glob(one)))
        if not self._sessions or self._sessions[-1] != now:
            self._sessions.append(now)

    def still_to_run(self, mutant: Mutant, tests: Sequence[str], *, again: bool = False) -> Sequence[str] | None:
        """Return the tests that may change the mutant's result; None where its end is known.

        ``again``: try survivors again.
        """
        known = self.of(mutant)
        now = self._sessions[-1]
        if known is None:
            return tests
        then = self._sessions[known["session"]]
        same = {name for name in now if then.get(name) == now[name]}
        if known["end"] != SURVIVED:
            return None if known["by"].partition("::")[0] in same or "::" not in known["by"] else tests
        if again or HELPERS not in same:
            return tests
        return [test for test in tests if test.partition("::")[0] not in same] or None

    def of(self, mutant: Mutant) -> Any:
        """Return the saved result of a mutant; None where there is none."""
        name = str(Path(mutant.path).relative_to(ROOT))
        return self._modules[name]["mutants"].get(mutant.key)

    def add(self, mutant: Mutant, end: str, by: str) -> None:
        """Add the end of a mutant and the test that ended it."""
        name = str(Path(mutant.path).relative_to(ROOT))
        self._modules[name]["mutants"][mutant.key] = {"end": end, "by": by, "session": len(self._sessions) - 1}

    def save(self) -> None:
        """Save the results for the next session."""
        kept = {"modules": self._modules, "sessions": self._sessions}
        temporary = self._path.with_suffix(".new")
        temporary.write_text(json.dumps(kept, indent=1))
        temporary.replace(self._path)

    def ends(self, module: str) -> dict[str, str]:
        """Return the end of each mutant that was tried."""
        known = self._modules[module]["mutants"]
        return {key: known[key]["end"] for key in keys_of(module) if key in known}


@functools.cache
def keys_of(module: str) -> tuple[str, ...]:
    """Return the keys of all mutants of a module."""
    return tuple(mutant.key for mutant in Module(module, (ROOT / module).read_text()).mutants())


def explained() -> dict[str, dict[str, str]]:
    """Return for each module why its surviving mutants are harmless."""
    found: dict[str, dict[str, str]] = tomllib.loads(EXPLAINED.read_text())
    return found


def unexplained(ends: Mapping[str, str], why: Mapping[str, str]) -> list[str]:
    """Return the survivors of a module without an explanation."""
    return [key for key, end in ends.items() if end == SURVIVED and not why.get(key)]


def outdated(ends: Mapping[str, str], why: Mapping[str, str], all_keys: Iterable[str]) -> list[str]:
    """Return the explanations of a module for mutants that are killed or no longer exist."""
    known = set(all_keys)
    return [key for key in why if key not in known or ends.get(key, SURVIVED) != SURVIVED]


def table(kept: Kept) -> str:
    """Return the table of the page: a row for each module, and their sum."""
    head = f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}\n"
    rows, total = [], Counter[str]()
    for name in MODULES:
        ends, why = kept.ends(name), explained().get(name, {})
        count = Counter(ends.values())
        count["bad"] = len(unexplained(ends, why))
        count["all"] = len(keys_of(name))
        total += count
        rows.append(_row(name.removeprefix("polishd/"), count))
    of = f"Python {platform.python_version()}, {datetime.now(UTC):%Y-%m-%d}."
    return f"{head}{''.join(rows)}{_row('**all**', total)}\n{of}\n"


def _row(name: str, count: Mapping[str, int]) -> str:
    left = count["all"] - sum(count[end] for end in (KILLED, TIMEOUT, SURVIVED))
    numbers = (count["all"], count[KILLED], count[TIMEOUT], count[SURVIVED] - count["bad"], count["bad"], left)
    return f"| {name} | {' | '.join(f'{number:,}' for number in numbers)} |\n"


def write_page(text: str) -> None:
    """Write the table to docs/reference/results.md."""
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(before + BEGIN + text + END + rest.partition(END)[2])
