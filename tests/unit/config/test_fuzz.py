"""Whatever stands in a config: it loads, or ConfigError names a place in that file. Nothing else ever happens."""

from __future__ import annotations

import re
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.config.cell import load_config
from polishd.config.toml_loader import Location, key_lines
from polishd.model.errors import ConfigError

EXAMPLE = (Path(__file__).resolve().parents[3] / "examples" / "cell.toml").read_text()
LINES = EXAMPLE.split("\n")
KEYED = [number for number, line in enumerate(LINES) if re.match(r"^\w+ *=", line)]
LITERALS = st.sampled_from(
    ["1", "-1", "0", "1e99", "nan", "inf", "true", '""', '"x"', "[]", "[1, 2]", "[[]]", "{}", "{ a = 1 }", "1979-05-27"]
)
NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)


def outcome(text: str, overrides: dict[str, Any] | None = None) -> str:
    """Nothing for a config that loads, else the error, with the file's own name taken away."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cell.toml"
        path.write_text(text)
        try:
            load_config(path, overrides)
        except ConfigError as error:
            return str(error).replace(str(path), "FILE")
    return ""


def placed(message: str, lines: int) -> None:
    """Each line of the message has a place that exists."""
    for line in message.split("\n"):
        match = re.match(r"FILE(?::(\d+)| \(override\)): \S", line)
        assert match is not None, line
        assert match[1] is None or 1 <= int(match[1]) <= lines, line


@pytest.mark.full
@given(st.sampled_from(KEYED), LITERALS)
def test_any_value_for_any_key(number: int, literal: str) -> None:
    key = LINES[number].partition("=")[0].strip()
    text = "\n".join([*LINES[:number], f"{key} = {literal}", *LINES[number + 1 :]])
    message = outcome(text)
    if message:
        placed(message, len(LINES))
        assert (
            f"FILE:{number + 1}: " in message
            or "[section" in message
            or key in message.partition(": ")[2]
            or key == "type"
        )


@given(st.sampled_from(KEYED))
def test_any_key_left_out(number: int) -> None:
    message = outcome("\n".join([*LINES[:number], "", *LINES[number + 1 :]]))
    if message:
        placed(message, len(LINES))
        assert "is missing; add it" in message


@pytest.mark.full
@given(st.sampled_from(KEYED), NAMES)
def test_any_stranger_is_named_with_its_line(number: int, name: str) -> None:
    section = next(line for line in reversed(LINES[:number]) if line.startswith("["))
    text = "\n".join([*LINES[:number], f"zz_{name} = 1", *LINES[number:]])
    message = outcome(text)
    if section.split("]")[0][1:] in {"robot", "actuator", "spindle", "metrology"}:
        assert message == ""  # judged by the device type's own model
    else:
        assert f"FILE:{number + 1}: " in message
        assert f".zz_{name}: unknown key" in message


@pytest.mark.full
@given(st.integers(0, len(EXAMPLE)), st.text(max_size=5))
def test_any_damage_to_the_text(place: int, junk: str) -> None:
    message = outcome(EXAMPLE[:place] + junk + EXAMPLE[place:])
    if message and "is not UTF-8" not in message:
        placed(message, EXAMPLE.count("\n") + junk.count("\n") + junk.count("\r") + 2)


@given(st.integers(0, len(EXAMPLE)))
def test_any_half_written_file(size: int) -> None:
    """Only the end of the last section, where all keys have defaults, may be missing without an error."""
    text = EXAMPLE[:size]
    message = outcome(text)
    if message:
        placed(message, text.count("\n") + 1)
    else:
        assert "[job]" in text


@pytest.mark.full
@given(st.dictionaries(st.lists(NAMES, min_size=1, max_size=3).map(".".join), st.integers() | st.text(), max_size=3))
def test_any_override(overrides: dict[str, Any]) -> None:
    message = outcome(EXAMPLE, overrides)
    if message:
        placed(message, len(LINES))


TABLES: st.SearchStrategy[dict[str, Any]] = st.dictionaries(
    NAMES, st.dictionaries(NAMES, LITERALS, max_size=4), min_size=1, max_size=4
)


@pytest.mark.full
@given(TABLES, st.integers(0, 3))
def test_scanner_finds_what_the_parser_finds(tables: dict[str, dict[str, str]], blank: int) -> None:
    lines = ["# [not] = a table"] * blank
    where: dict[Location, int] = {}
    for table, keys in tables.items():
        lines.append(f"[{table}]  # = [x]")
        where[(table,)] = len(lines)
        for key, literal in keys.items():
            lines.append(f'"{key}" = {literal}')
            where[(table, key)] = len(lines)
    text = "\n".join(lines)
    assert {name: set(table) for name, table in tomllib.loads(text).items()} == {t: set(k) for t, k in tables.items()}
    inside = {key: line for key, line in key_lines(text).items() if len(key) > 2}
    assert key_lines(text) == where | {key: where[key[:2]] for key in inside}
