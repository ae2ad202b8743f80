"""The mutator: its faults, that each gives another program, and the rules of the verdict."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest

from tests.campaigns.mutation import covered, kept
from tests.campaigns.mutation.campaign import KILLED, SURVIVED, TIMEOUT, Trial
from tests.campaigns.mutation.kept import Kept, outdated, unexplained
from tests.campaigns.mutation.mutants import Module, Mutant
from tests.campaigns.mutation.scope import MODULES, ROOT
from tests.campaigns.mutation.trial import function_code


def mutants(source: str) -> list[Mutant]:
    return list(Module("x.py", source).mutants())


def changes(source: str) -> list[str]:
    return [mutant.change for mutant in mutants(source)]


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("a < b", ["a < b -> pass", "a < b -> a <= b"]),
        ("x = a < b <= c", ["a < b <= c -> a <= b <= c", "a < b <= c -> a < b < c"]),
        ("x = a in b", ["a in b -> a not in b"]),
        ("x = a and b", ["a and b -> a", "a and b -> b"]),
        ("x = not a", ["not a -> a"]),
        ("x = a - b", ["a - b -> a + b"]),
        ("x = a | b", ["a | b -> a", "a | b -> b"]),
        ("x = 2 * a", ["2 * a -> 2 / a", "2 * a -> 3 * a"]),
        ("x = True", ["True -> False"]),
        ("x = 'held'", ["'held' -> 'otherheld'"]),
        ("x = 'words for people'", []),
        ("x = 'SELECT a FROM b WHERE c IS NULL LIMIT 1'", 2),
        ("x = max(a)", ["max(a) -> min(a)"]),
        ("x = f(a, b=c)", ["f(a, b=c) -> f(a)"]),
        ("x = [a for a in b if c]", ["for a in b if c -> for a in b"]),
        ("self.x = y", ["self.x = y -> pass"]),
        ("x += y", ["x += y -> pass", "x += y -> x -= y"]),
        ("if a:\n    b()", ["a -> not a", "b() -> pass"]),
        ("while a:\n    break", ["a -> not a", "break -> pass"]),
        ("raise A(b)", ["raise A(b) -> pass", "raise A(b) -> raise Exception(b)"]),
        ("raise A(f'{b + 1}') from c", 2),
        ("try:\n    a()\nexcept (B, C):\n    raise", 4),
        ("with a, b as c:\n    d()", 2),
        ("def f():\n    return a", ["return a -> return None"]),
        ("def f():\n    yield a\n    return", []),
        ("def f(a: int | None = 1) -> int | None: ...", 1),
        ("log.info('%d', a + 1)", []),
        ("'''What it is.'''", []),
        ("@a(b=1)\ndef f(): ...", []),
        ("match a:\n    case B():\n        c()\n    case _:\n        d()", 3),
        ("async def f():\n    await a()", ["await a() -> pass"]),
    ],
)
def test_faults(source: str, found: list[str] | int) -> None:
    said = changes(source)
    assert (len(said) if isinstance(found, int) else said) == found


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", MODULES)
def test_every_fault_of_what_is_proved_is_another_program_and_has_a_name_of_its_own(name: str) -> None:
    module = Module(name, (ROOT / name).read_text())
    sound, found = ast.dump(module.tree), list(module.mutants())
    assert len({mutant.key for mutant in found}) == len(found) > 10
    for mutant in found[:: max(len(found) // 5, 1)]:
        old = mutant.edit.put(mutant.new)
        assert ast.dump(module.tree) != sound
        mutant.edit.put(old)
    assert ast.dump(module.tree) == sound


def test_a_fault_is_put_into_a_function_that_others_have_imported_and_wrapped() -> None:
    source = "import functools\n@functools.cache\ndef f(a):\n    g = lambda: a + 1\n    return g()\n"
    module = Module("x.py", source)
    found: dict[str, Any] = {}
    exec(compile(source, "x.py", "exec"), found)
    function: FunctionType = found["f"].__wrapped__
    assert found["f"](1) == 2
    (mutant,) = [one for one in module.mutants() if one.change == "a + 1 -> a - 1"]
    assert (mutant.where, mutant.unit_line, mutant.lines) == ("f", 2, (4,))
    function.__code__ = function_code(module.code(mutant), 2)
    assert found["f"](2) == 1


def test_a_default_is_of_the_module_and_not_of_its_function() -> None:
    (mutant,) = [one for one in mutants("class A:\n    def f(self, a=1):\n        return\n") if "a=1" in one.change]
    assert mutant.unit_line is None


ONE_AT_IMPORT = """
import sys
from tests.campaigns.mutation.__main__ import OPTIONS
from tests.campaigns.mutation.mutants import Module
from tests.campaigns.mutation.scope import ROOT
from tests.campaigns.mutation.trial import Reporter, in_import

path = ROOT / "polishd" / "model" / "states.py"
module = Module(str(path), path.read_text())
(mutant,) = [one for one in module.mutants() if one.change == "'idle' -> 'otheridle'"]
test = "tests/unit/daemon/test_state_machine.py::test_others_know_the_states_by_these_names"
in_import(module, mutant if sys.argv[1] == "fault" else module.sound(mutant), [test], OPTIONS)(Reporter(1))
"""


@pytest.mark.full
@pytest.mark.parametrize(("fault", "failed"), [("fault", True), ("none", False)])
def test_a_fault_is_in_what_is_imported(fault: str, failed: bool) -> None:
    command = [sys.executable, "-c", ONE_AT_IMPORT, fault]
    child = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert ("failed tests/unit/daemon/test_state_machine.py" in child.stdout) is failed, child.stdout + child.stderr
    assert "begun tests/unit/daemon/test_state_machine.py" in child.stdout


def test_what_a_child_says_is_how_its_mutant_ended() -> None:
    mutant = mutants("x = 1")[0]
    trial = Trial(mutant, print, {"t.py::a": 1.0})
    assert trial.receive("begun t.py::a\nbegu") == ""
    assert trial.receive("n t.py::b\n") == ""
    assert (trial.receive("failed t.py::b\n"), trial.test) == (KILLED, "t.py::b")
    assert Trial(mutant, print, {}).receive("ended \n") == SURVIVED
    assert Trial(mutant, print, {}).receive("") == KILLED, "it died"


def test_tests_of_subfolders_are_measured_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(covered, "known_lines", dict)
    assert {"tests/unit/daemon/contact/test_leaving.py", "tests/unit/util/test_files.py"} <= set(
        covered.changed_tests()
    )


def test_a_survivor_wants_an_explanation_and_an_explanation_a_survivor() -> None:
    ends = {"a": SURVIVED, "b": SURVIVED, "c": KILLED, "d": TIMEOUT}
    why = {"a": "the same", "b": "", "c": "no longer", "e": "gone"}
    assert unexplained(ends, why) == ["b"]
    assert outdated(ends, why, ["a", "b", "c", "d"]) == ["c", "e"]


def test_only_what_a_changed_test_may_say_otherwise_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashes = {"t.py": "1", "u.py": "1"}
    monkeypatch.setattr(kept, "content_of", lambda names: hashes.get(names[0], "") if names else "")
    mutant = next(Module(str(ROOT / MODULES[0]), "x = [1, 2, 3]").mutants())
    tests = ["t.py::a", "u.py::b"]
    results = Kept(tmp_path)
    results.begin_session(hashes)
    assert results.still_to_run(mutant, tests) == tests
    results.add(mutant, SURVIVED, "")
    assert results.still_to_run(mutant, tests) is None
    hashes["u.py"] = "2"
    results.begin_session(hashes)
    assert results.still_to_run(mutant, tests) == ["u.py::b"]
    results.add(mutant, KILLED, "u.py::b")
    results.save()
    again = Kept(tmp_path)
    again.begin_session(hashes)
    assert again.still_to_run(mutant, tests) is None
    hashes["u.py"] = "3"
    again.begin_session(hashes)
    assert again.still_to_run(mutant, tests) == tests
