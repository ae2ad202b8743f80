"""Profiles are data: the template notation, the shipped files, a user's own, and what is wrong with a bad one."""

from __future__ import annotations

import pickle
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import ConfigError, Program, ProgramError
from polishd.config.toml_loader import TomlSource, validated
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.languages import LanguageProfile, read, rewrite, split
from polishd.plugins.rnc_robot.languages.profile import Dwell, Writing, compiled
from tests.unit.plugins.rnc_robot.languages.robot_programs import LANGUAGES, PROGRAMS, around, profile

ROOT = Path(__file__).parents[5]
DOCS = ROOT / "docs" / "how-to" / "robot-languages.md"
LINE = Writing(False, False, [";"], frozenset({"x"}), {"rest": "[^;]*"})

FITS = [
    ("MOVE <x>", b"MOVE 1.5", True),
    ("MOVE <x>", b"MOVE   -.5 ; comment", True),
    ("MOVE <x>", b"MOVE +1.e3\r\n", True),
    ("MOVE <x>", b"MOVE1.5", False),
    ("MOVE <x>", b"MOVE 1.5 2", False),
    ("MOVE <x>", b"MOVE 1.5mm", False),
    ("MOVE <x>", b"MOVE one", False),
    ("MOVE <x>", b"MOVE .", False),
    ("MOVE <x>", b"move 1.5", False),
    ("MOVE <x>", b"MOVE\n1.5", False),
    ("MOVE(<x>)", b"MOVE ( 1.5 )", True),
    ("MOVE(<x>)", b"MOVE(1.5", False),
    ("MOVE <name>", b"MOVE a_1", True),
    ("MOVE <name>", b"MOVE 1a", False),
    ("MOVE <x><? FAST?>", b"MOVE 1", True),
    ("MOVE <x><? FAST?>", b"MOVE 1 FAST", True),
    ("MOVE <x><? FAST?>", b"MOVE 1FAST", False),
    ("MOVE <x><?,<name>?>", b"MOVE 1 , a", True),
    ("<MOVE|GO> <x>", b"GO 1", True),
    ("<MOVE|GO> <x>", b"STOP 1", False),
    ("<?FAST ?>MOVE <x>", b"FAST MOVE 1", True),
    ("<?FAST ?>MOVE <x>", b"FASTMOVE 1", False),
    ("$A.B[<x>]={C <rest>}", b"$A.B[ 1 ] = {C 1, 2}", True),
]


@pytest.mark.parametrize(("template", "text", "fits"), FITS)
def test_a_template_fits(template: str, text: bytes, fits: bool) -> None:
    assert (compiled(template, LINE).match(text) is not None) == fits


def test_a_template_of_statements_that_span_lines_and_ignore_case() -> None:
    writing = Writing(True, True, ["!"], frozenset({"x"}), {})
    found = compiled("Move <x>, <name>;", writing).match(b"MOVE\r\n 1.5 ,\n here ; rest")
    assert found
    assert (found["x"], found["name"], found.end()) == (b"1.5", b"here", 20)


@given(st.text("<>?|ax [(.;", max_size=12))
def test_a_template_is_compiled_or_refused_and_never_hangs(template: str) -> None:
    try:
        compiled(template, LINE).match(b"a x [ ( . ; a x")
    except re.error:
        return


@pytest.mark.parametrize("name", LANGUAGES)
def test_the_shipped_profiles(name: str) -> None:
    language = profile(name)
    assert language.name == name
    assert pickle.loads(pickle.dumps(language)) == language
    assert len(language.patterns) > 20
    source = (Path(read.__code__.co_filename).parents[1] / "dialects" / f"{name}.toml").read_text()
    assert "Sources:" in source


def test_the_quanta_of_the_shipped_profiles() -> None:
    rules = {name: profile(name).dwell for name in LANGUAGES}
    assert {name: rule.quantum_s for name, rule in rules.items()} == {
        "rapid": 0.001, "krl": 0.001, "fanuc-tp": 0.01, "urscript": 0.002, "inform": 0.01, "val3": 0.001,
        "heidenhain": 0.001, "melfa-basic": 0.01, "kawasaki-as": 0.01,
    }  # fmt: skip
    assert {name for name, rule in rules.items() if rule.decimals == 2} == {
        "fanuc-tp", "inform", "melfa-basic", "kawasaki-as",
    }  # fmt: skip
    assert rules["fanuc-tp"].max_s == 327.67


@pytest.mark.parametrize(
    ("unit_s", "quantum_s", "decimals", "steps"),
    [(1.0, 0.001, 3, 1), (1.0, 0.008, 3, 8), (1.0, 0.0125, 4, 125), (0.001, 0.008, 0, 8), (1.0, 1e-7, 7, 1)],
)
def test_a_quantum_may_be_any_decimal_number(unit_s: float, quantum_s: float, decimals: int, steps: int) -> None:
    dwell = Dwell(unit_s=unit_s, quantum_s=quantum_s)
    assert (dwell.decimals, dwell.steps) == (decimals, steps)


def test_a_variant_adds_templates_and_changes_keys(tmp_path: Path) -> None:
    own = tmp_path / "cell.toml"
    own.write_text(
        'extends = "rapid"\nname = "cell"\n[orientation]\ntool_z = "out_of_part"\n'
        "[added]\nneutral = ['SpindleOn <items>;']\ndwell = ['Rest <time>;']\n"
    )
    language = dialect(own)
    assert isinstance(language, LanguageProfile)
    body = b"SpindleOn 1200,tPad;\nMoveL p1,v10,fine,tool0;\nREST 2.5;\n"
    with pytest.raises(ProgramError, match="line 6"):
        read(profile("rapid"), around("rapid", body), "part.mod")
    program = read(language, around("rapid", body), "part.mod")
    assert program.dialect == "cell"
    assert program.time_s.tolist() == [0.5, 2.5]
    assert program.axis.tolist() == [[0, 0, -1], [0, 0, -1]]
    assert b"REST 3.5;" in rewrite(language, program, np.array([0.5, 3.5]))


def test_the_example_of_the_docs_is_a_language(tmp_path: Path) -> None:
    toml, program_text = re.findall(r"```\w*\n(.*?)```", DOCS.read_text(), re.DOTALL)[:2]
    own = tmp_path / "acme.toml"
    own.write_text(toml)
    language = dialect(own)
    assert isinstance(language, LanguageProfile)
    text = program_text.encode()
    program = read(language, text, "part.acme")
    assert program.time_s.tolist() == [0.5, 0.25]
    assert program.end_mm.tolist() == [[10, 0, 5], [10.5, 0, 5]]
    np.testing.assert_allclose(program.axis, [[0, 0, 1], [0, 0, 1]], atol=1e-12)
    assert program.feed_mm_min.tolist() == [1200, 1200]
    assert split(language, text) == [text]
    assert rewrite(language, program, program.time_s) == text


GOOD = {
    "name": "toy",
    "kind": "template",
    "comments": ["#"],
    "orientation": {"convention": "rotation_vector_rad", "fields": ["a", "b", "c"]},
    "dwell": {"quantum_s": 0.01},
    "statements": {"move": ["GO <x> <y> <z> <a> <b> <c>"], "dwell": ["REST <time>"]},
}


def changed(key: str, value: Any) -> dict[str, Any]:
    """The good document with one key (dotted) set, or taken out where the value is None."""
    document: dict[str, Any] = pickle.loads(pickle.dumps(GOOD))
    *path, last = key.split(".")
    table = document
    for part in path:
        table = table.setdefault(part, {})
    if value is None:
        del table[last]
    else:
        table[last] = value
    return document


def parse(document: dict[str, Any]) -> LanguageProfile:
    """The profile of a document of which no text is at hand: each key is on line 1."""
    return validated(LanguageProfile, document, TomlSource("toy.toml", ""))


def test_a_language_without_routines_needs_little() -> None:
    language = parse(GOOD)
    program = read(language, b"GO 1 2 3 0 0 0\nREST 0.5\nGO 1 2 4 0 0 0\nREST 1 # REST 9", "part.toy")
    assert program.time_s.tolist() == [0.5, 1]
    with pytest.raises(ProgramError, match="line 2"):
        read(language, b"GO 1 2 3 0 0 0\nREST\n", "part.toy")


def test_a_move_whose_target_may_be_missing_is_refused_where_it_is() -> None:
    language = parse(changed("statements.move", ["GO<? <target>?>"]))
    with pytest.raises(ProgramError, match="line 1: the position is not complete"):
        read(language, b"GO\nREST 1\n", "part.toy")


BAD = [
    ("name", None, "name: is missing"),
    ("colour", "red", "colour: unknown key"),
    ("kind", "nc", "kind: 'nc' is not allowed; must be 'template'"),
    ("unit_mm", 0.0, "unit_mm: 0.0 is out of range; must be at least"),
    ("unit_mm", "1", "unit_mm: must be a number"),
    ("ignore_case", 1, "ignore_case: must be true or false"),
    ("line_limit", -1, "line_limit: -1 is out of range; must be at least 0"),
    ("feed_units_mm_min", {"mm": -1.0}, r"feed_units_mm_min\.mm: -1\.0 is out of range; must be greater than 0"),
    ("dwell.quantum_s", None, r"dwell\.quantum_s: is missing"),
    ("dwell.quantum_s", 1 / 3, r"dwell.quantum_s: a number of unit_s with at most 9 decimals"),
    ("dwell.quantum_s", 1e-12, r"dwell\.quantum_s: 1e-12 is out of range; must be at least"),
    ("dwell.fly_by", "guess", r"dwell\.fly_by: 'guess' is not allowed; must be 'refuse' or 'warn'"),
    ("orientation.convention", "euler_deg", "orientation.axes: three of"),
    ("orientation.convention", "quaternion", "orientation: quaternion has 4 fields"),
    ("orientation.axes", "ZYX", "orientation.axes: three of"),
    ("orientation.tool_z", "up", r"orientation\.tool_z"),
    ("statements.move", [], "statements: a language needs a move and a dwell"),
    ("statements.dwell", [], "statements: a language needs a move and a dwell"),
    ("statements.dwell", ["REST <t>"], r"statements\.dwell: a template lacks <time>"),
    ("statements.move", ["GO <x> <y>"], r"statements\.move: a template lacks <a>, <b>, <c>, <z>"),
    ("statements.position", ["P <x> <y> <z> <a> <b> <c>"], r"statements\.position: a template lacks <target>"),
    ("statements.move", ["GO <x> <x> <y> <z> <a> <b> <c>"], r"statements\.move: 'GO <x> <x>.*redefinition"),
    ("statements.neutral", ["ON <?a"], r"statements\.neutral: 'ON <\?a'.*missing \)"),
    ("statements.neutral", ["ON <Name>"], r"statements\.neutral: 'ON <Name>'.*belongs to no field"),
    ("statements.neutral", ["<?ON?>"], r"statements\.neutral: a template fits where nothing is written"),
    ("statements.neutral", "ON", r"statements\.neutral: must be a list"),
    ("statements.neutral", [""], r"statements\.neutral: string should have at least 1 character"),
    ("statements.jump", ["JMP"], r"statements\.jump: unknown key"),
    ("fields", {"rest": "["}, r"fields\.rest: unterminated character set"),
    ("fields", {"rest": "a)|(b"}, r"fields\.rest: unbalanced parenthesis"),
    ("fields", {"time": "[0-9]+,[0-9]+"}, r"fields\.time: is a number"),
    ("fields", {"a": "[0-9]+"}, r"fields\.a: is a number"),
    ("refused", [{"templates": ["X"]}], r"refused\.reason: is missing"),
]


@pytest.mark.parametrize(("key", "value", "message"), BAD)
def test_a_bad_profile_is_refused_by_file_and_key(key: str, value: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=r"^toy\.toml:1: " + message):
        parse(changed(key, value))


def test_every_key_that_is_wrong_is_named() -> None:
    with pytest.raises(ConfigError) as refused:
        parse({**GOOD, "colour": 1, "unit_mm": -1.0})
    assert "toy.toml:1: unit_mm" in str(refused.value)
    assert "toy.toml:1: colour" in str(refused.value)


pieces = st.sampled_from([b"\n", b"\r", b";", b'"', b"0.5", b"(", b"!", b"WaitTime 9;", b"WAIT SEC 9"])


def outcome(language: LanguageProfile, text: bytes) -> tuple[Program | None, str]:
    """The program, or what it is refused with; any other error passes."""
    try:
        return read(language, text, "part.txt"), ""
    except ProgramError as refused:
        return None, str(refused)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", LANGUAGES)
@given(data=st.data())
def test_whatever_happens_to_a_program_it_is_read_or_refused_and_its_bytes_stay(name: str, data: st.DataObject) -> None:
    text = bytearray(PROGRAMS[name].text)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text) - 1))
        cut = data.draw(st.integers(0, 3))
        text[at : at + cut] = data.draw(
            st.one_of(st.binary(max_size=3), st.sampled_from([b"\n", b";", b'"', b"0.5", b"("]))
        )
    language = profile(name)
    program, message = outcome(language, bytes(text))
    if program is None:
        assert re.match(r"part\.txt[,:] .*To do: .+\.$", message)
        return
    assert rewrite(language, program, program.time_s) == bytes(text)
    assert np.isfinite(program.end_mm).all()
    assert (program.time_s >= 0).all()


def test_the_profiles_are_plain_toml() -> None:
    for name in LANGUAGES:
        path = Path(read.__code__.co_filename).parents[1] / "dialects" / f"{name}.toml"
        assert tomllib.loads(path.read_text())["name"] == name
