"""Dialect profiles: data that is checked when it is loaded, and what each key makes of a program."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from polishd.api import ConfigError, Program
from polishd.commissioning.rehearsal.simulated_cell import with_values
from polishd.config.cell import load_config
from polishd.model.errors import PluginError
from polishd.plugin_loader import load_plugins
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import DEFAULT, DIALECTS, FOLDER, LANGUAGES, GcodeDialect, dialect
from polishd.plugins.rnc_robot.gcode.dialect import tables

NC = tuple(name for name in DIALECTS if isinstance(dialect(name), GcodeDialect))
HEAD = "G21 G90 G94\nG0 X0. Y0. Z0.\n"
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """``write('extends = "rs274"', name="shop")``: a profile's path."""

    def make(text: str, name: str = "shop") -> Path:
        path = tmp_path / f"{name}.toml"
        path.write_text(text)
        return path

    return make


def shop(write: Write, text: str, base: str = "rs274") -> GcodeDialect:
    return cast(GcodeDialect, dialect(write(f'extends = "{base}"\nname = "shop"\n{text}')))


def read(profile: GcodeDialect, body: str, head: str = HEAD, end: str = "M2\n") -> Program:
    return formats.read(profile, (head + body + end).encode(), "t.nc")


# What is shipped.


def test_every_shipped_profile_is_named_and_there() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.toml")) == sorted(DIALECTS)
    assert DEFAULT in DIALECTS


def test_a_shipped_dialect_is_read_when_a_program_is_and_what_is_said_of_it_before_is_so() -> None:
    """The expressions of all of them took a tenth of a check."""
    formats_by_name = {one.name: one for one in formats.shipped_formats()}
    assert tuple(formats_by_name) == DIALECTS
    formats.shipped.cache_clear()
    formats_by_name["rs274"].read(HEAD.encode() + b"G1 X1. F60.\nG1 X2.\nM2\n", "p.rnc")
    assert formats.shipped.cache_info().currsize == 1
    for name in DIALECTS:
        known = formats.format_of(dialect(name))
        assert (known.name, known.make is None) == (name, formats_by_name[name].make is None)
    assert {name for name in DIALECTS if name not in NC} == LANGUAGES
    assert len(NC) == 10


@pytest.mark.parametrize("name", DIALECTS)
def test_shipped(name: str) -> None:
    profile = dialect(name)
    assert profile.name == name
    assert dialect(name) == profile
    assert dialect(str(FOLDER / f"{name}.toml")) == profile == dialect(FOLDER / f"{name}.toml")
    if isinstance(profile, GcodeDialect):
        found = tables(profile)
        assert found.longest_s == profile.dwell.longest_s
        assert found.g[40] != 0
        assert profile.dwell.decimals <= profile.dwell.most_decimals
        assert profile.title


@pytest.mark.parametrize("name", NC)
def test_new_dwells_can_be_read(name: str) -> None:
    """``written`` and its unit are one of the words that the dialect reads."""
    profile = cast(GcodeDialect, dialect(name))
    number = "1500" if profile.dwell.words.get("P", profile.dwell.words[next(iter(profile.dwell.words))]).decimal == (
        "refuse"
    ) and profile.dwell.written.endswith("P") else "1.5"  # fmt: skip
    program = formats.read(
        profile, f"G90\nG0 X0. Y0. Z0.\nG1 X1. F9.\n{profile.dwell.written}{number}\nM30\n".encode(), "t.nc"
    )
    assert program.time_s.tolist() == [1.5]


@pytest.mark.parametrize("name", [*NC, "rapid"])
def test_a_profile_cannot_be_changed(name: str) -> None:
    with pytest.raises(ValueError, match="frozen"):
        dialect(name).name = "other"  # type: ignore[misc]


# Names, and files that extend others.


@pytest.mark.parametrize(
    ("name", "near"),
    [("fanic", "fanuc"), ("rs-274", "rs274"), ("Siemens", "siemens"), ("twincat-ncl", "twincat-nci"), ("tp", "rs274,")],
)
def test_unknown_names(name: str, near: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"dialect {name!r} is not known: ")) as caught:
        dialect(name)
    assert near in str(caught.value)
    assert ("did you mean" in str(caught.value)) == ("," not in near)


def test_extends_merges_tables_and_replaces_lists(write: Write) -> None:
    base = cast(GcodeDialect, dialect("fanuc"))
    mine = shop(
        write,
        '[dwell.words]\nX = { whole = "ms", decimal = "s" }\n[words]\nneutral = ["S"]\n[g]\npath = [187]\n',
        "fanuc",
    )
    assert mine.dwell.words["X"].whole == "ms"
    assert mine.dwell.words["P"] == base.dwell.words["P"]
    assert mine.words.neutral == ["S"]
    assert (mine.title, mine.feed, mine.m, mine.text) == (base.title, base.feed, base.m, base.text)
    assert {**mine.g, "path": []} == base.g
    assert read(mine, "G1 X1. F60.\nG4 X500\n").time_s.tolist() == [0.5]
    assert cast(GcodeDialect, dialect("fanuc")) == base


def test_extends_a_file_beside_it(write: Write) -> None:
    write('extends = "grbl"\nname = "a"\n[text]\nblock_delete = "skip"\n', "a")
    top = cast(GcodeDialect, dialect(write('extends = "a.toml"\nname = "b"\n[dwell]\ndecimals = 1\n', "b")))
    assert (top.name, top.text.block_delete, top.dwell.decimals, top.axes.rotary) == ("b", "skip", 1, [])


def test_a_language_is_extended_likewise(write: Write) -> None:
    mine = dialect(write('extends = "krl"\nname = "mine"\n[dwell]\nmax_s = 5.0\n'))
    assert mine.kind == "template"
    assert mine.dwell.max_s == 5.0


BROKEN = [
    ("itself", '\nextends = "shop.toml"', r"shop\.toml:2: extends: .*circle"),
    ("not TOML", "[dwell\n", r"shop\.toml:1: this is not TOML"),
    ("twice", "name = 1\nname = 2\n", r"shop\.toml:\d: this is not TOML"),
    ("a number", "extends = 5", r"shop\.toml:1: extends: is no text"),
    ("missing", 'extends = "missing.toml"', r"missing\.toml: cannot be read"),
    ("missing, where", '\nextends = "missing.toml"', r"shop\.toml:2: extends: missing\.toml: cannot be read"),
    ("mistyped", '\nextends = "fanuk"', r"shop\.toml:2: extends: dialect 'fanuk' is not known: did you mean 'fanuc'\?"),
    ("unknown", 'extends = "qqq"', r"shop\.toml:1: extends: dialect 'qqq' is not known: known are rs274, "),
    ("empty", "", r"shop\.toml:1: kind: is missing; add it"),
    ("no kind", 'name = "a"\nkind = "iso"', r"shop\.toml:2: kind: 'iso' is not allowed"),
    ("no name", 'kind = "nc"', r"shop\.toml:1: name: is missing; add it"),
]


@pytest.mark.parametrize(("text", "why"), [case[1:] for case in BROKEN], ids=[case[0] for case in BROKEN])
def test_broken_files(write: Write, text: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        dialect(write(text))


def test_circles_of_several(write: Write) -> None:
    write('extends = "shop.toml"', "b")
    write('extends = "b.toml"', "a")
    with pytest.raises(ConfigError, match=r"b\.toml:1: extends: 'shop\.toml' .*circle"):
        dialect(write('extends = "a.toml"'))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: cannot be read"):
        dialect(tmp_path / "none.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(ConfigError, match=r"folder\.toml: cannot be read"):
        dialect(tmp_path / "folder.toml")
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe4"\n')
    with pytest.raises(ConfigError, match=r"latin\.toml: "):
        dialect(tmp_path / "latin.toml")


WRONG = [
    ('[dwell]\nword = "P"', "dwell.word"),
    ("[dewll]\ndecimals = 3", "dewll"),
    ("block_delete = 'skip'", "block_delete"),
    ("[text]\nblockdelete = 'skip'", "text.blockdelete"),
    ("[text]\nblock_delete = 'maybe'", "text.block_delete"),
    ("[text]\nwhole_positions = 'inch'", "text.whole_positions"),
    ("[text]\nlongest_line = 5", "text.longest_line"),
    ("[text]\nlongest_line = 'long'", "text.longest_line"),
    ("[text]\ncomments = ['#']", "text.comments"),
    ("[text]\nrealtime = ['!']", "text.realtime"),
    ("[text]\nrealtime = 'é'", "text.realtime"),
    ("[dwell]\ndecimals = -1", "dwell.decimals"),
    ("[dwell]\ndecimals = 2.5", "dwell.decimals"),
    ("[dwell]\ncodes = 4", "dwell.codes"),
    ("[dwell]\nlongest_s = 0", "dwell.longest_s"),
    ("[dwell]\nlongest_s = nan", "dwell.longest_s"),
    ("[dwell]\nown_block = 'perhaps'", "dwell.own_block"),
    ("[dwell.words]\nU = { whole = 's' }", "dwell.words.U.decimal"),
    ("[dwell.words]\nP = { whole = 'min', decimal = 's' }", "dwell.words.P.whole"),
    ("[dwell.words]\nP = 's'", "dwell.words.P"),
    ("[feed]\nunit = 'inch/min'", "feed.unit"),
    ("[feed]\ng93 = 's/min'", "feed.g93"),
    ("[axes]\nrotary = ['CX']", "axes.rotary"),
    ("[axes]\nvector = 'IJK'", "axes.vector"),
    ("[g]\nrapid = 0", "g.rapid"),
    ("[g]\nrapid = ['zero']", "g.rapid"),
    ("[refused_g]\n7 = 7", "refused_g.7"),
    # what no type says
    ("[axes]\nvector = ['I', 'J']", "axes.vector"),
    ("[axes]\nvector = ['I', 'J', 'K', 'L']", "axes.vector"),
    ("[g]\nrapid = [0, 1]", "g.rapid"),
    ("[g]\nneutral = [4]", "g.neutral"),
    ("[g]\nline = [1.05]", "g.line"),
    ("[g]\nline = [1000]", "g.line"),
    ("[g]\nrapidly = [7]", "g.rapidly"),
    ("[m]\nends = [2, 3]", "m.ends"),
    ("[m]\nstop = [50]", "m.stop"),
    ("[m]\nneutral = [1000]", "m.neutral"),
    ("[words]\nneutral = ['?']", "words.neutral"),
    ("[words]\nneutral = ['X']", "words.neutral"),
    ("[words]\nneutral = ['G']", "words.neutral"),
    ("[words]\nkeywords = ['F']", "words.keywords"),
    ("[dwell]\nwritten = 'G4 T'", "dwell.written"),
    ("[dwell]\nwritten = 'G4'", "dwell.written"),
    ("[dwell]\nwritten = ''", "dwell.written"),
]


@pytest.mark.parametrize(("text", "key"), WRONG, ids=[f"{key} {k}" for k, (_, key) in enumerate(WRONG)])
def test_keys_that_make_no_sense(write: Write, text: str, key: str) -> None:
    """Found when the profile is loaded, not when the first program is read; file, line and key are named."""
    line = 3 if key in {"dewll", "block_delete"} else 4
    with pytest.raises(ConfigError, match=rf"shop\.toml:{line}: {re.escape(key)}: "):
        shop(write, text)


def test_a_key_that_was_wrong_in_the_file_below_is_named_there(write: Write) -> None:
    write('extends = "rs274"\nname = "a"\n\n[dwell]\ncodes = 4\n', "a")
    with pytest.raises(ConfigError, match=r"a\.toml:5: dwell\.codes: must be a list"):
        dialect(write('extends = "a.toml"\nname = "b"\n[dwell]\ndecimals = 1\n', "b"))


def test_too_many_names(write: Write) -> None:
    names = (
        ", ".join(f"'WORD{chr(65 + k)}'" for k in range(26)) + ", " + ", ".join(f"'X{chr(65 + k)}'" for k in range(26))
    )
    with pytest.raises(ConfigError, match="names"):
        tables(shop(write, f"[words]\nkeywords = [{names}]"))


def test_the_manual_shows_a_profile_that_loads(write: Write) -> None:
    page = (Path(__file__).parents[4] / "docs" / "how-to" / "programs.md").read_text(encoding="utf-8")
    shown = re.search(r"```toml\n(extends = .*?)```", page, re.DOTALL)
    assert shown is not None
    profile = cast(GcodeDialect, dialect(write(shown[1])))
    assert profile.name == tomllib.loads(shown[1])["name"]
    assert tables(profile).names == 0


# Through the daemon's configuration.


def configured(folder: Path, example: str, **program: Any) -> Any:
    (folder / "cell.toml").write_text(with_values(example, {"program": program}))
    return load_config(folder / "cell.toml")


@pytest.fixture(scope="module")
def example() -> str:
    return (Path(__file__).parents[4] / "examples" / "cell.toml").read_text()


def test_a_cell_names_dialects_of_its_own(tmp_path: Path, example: str) -> None:
    (tmp_path / "dialects").mkdir()
    (tmp_path / "dialects" / "shop.toml").write_text(
        'extends = "fanuc"\nname = "shop"\n[dwell.words]\nX = { whole = "ms", decimal = "s" }\n'
    )
    config = configured(tmp_path, example, dialects=["dialects/shop.toml"], format="shop")
    assert config.dialect_paths == [tmp_path / "dialects" / "shop.toml"]
    found = load_plugins(config.plugins.load, config.dialect_paths)
    found.report.require()
    shipped = load_plugins(config.plugins.load)
    assert set(found.program_formats()) - set(shipped.program_formats()) == {"shop"}
    assert "shop" not in shipped.program_formats()
    ours = found.program_formats()[config.program.format]
    program = ours.read((HEAD + "G1 X1. F60.\nG4 X1500\nM30\n").encode(), "t.nc")
    assert (program.dialect, program.time_s.tolist()) == ("shop", [1.5])
    assert b"X2500\n" in ours.rewrite(program, np.array([2.5]))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (None, "cannot be read"),
        ('extends = "fanuc"\nnam = "shop"\n', "shop.toml:2: nam: unknown key; did you mean 'name'?"),
        ('extends = "fanuc"\nname = "shop"\n[g]\nline = [0, 1]\n', "shop.toml:4: g.line: 0 is in g.rapid too"),
        ('extends = "fanuc"\nname = "rs274"\n', "rs274"),
        ('extends = "fanuc"\n', "fanuc"),
    ],
)
def test_a_cell_with_a_wrong_dialect_does_not_start(tmp_path: Path, example: str, text: str | None, why: str) -> None:
    """Nor with one that takes the name of a shipped one: who would know which of them reads the program?"""
    if text is not None:
        (tmp_path / "shop.toml").write_text(text)
    config = configured(tmp_path, example, dialects=["shop.toml"])
    with pytest.raises(PluginError, match=re.escape(why)):
        load_plugins(config.plugins.load, config.dialect_paths).report.require()
