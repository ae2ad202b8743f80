"""What each key of a dialect profile makes of a program."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polishd.api import Program, ProgramError
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import GcodeDialect, dialect
from polishd.plugins.rnc_robot.gcode import checks

HEAD = "G21 G90 G94\nG0 X0. Y0. Z0.\n"
Shop = Callable[..., GcodeDialect]


@pytest.fixture
def shop(tmp_path: Path) -> Shop:
    """``shop("[text]\\n...", "fanuc")``: a shipped profile with these keys."""

    def make(text: str, base: str = "rs274") -> GcodeDialect:
        (tmp_path / "shop.toml").write_text(f'extends = "{base}"\nname = "shop"\n{text}')
        return cast(GcodeDialect, dialect(tmp_path / "shop.toml"))

    return make


def read(profile: GcodeDialect, body: str, head: str = HEAD, end: str = "M2\n") -> Program:
    return formats.read(profile, (head + body + end).encode(), "t.nc")


def test_block_delete(shop: Shop) -> None:
    body = "G1 X1 F60\n/G1 X2\nX4\n"
    with pytest.raises(ProgramError, match="line 4: block delete"):
        read(shop(""), body)
    run = read(shop("[text]\nblock_delete = 'run'"), body)
    assert run.time_s.tolist() == [1, 1, 2]
    profile = shop("[text]\nblock_delete = 'skip'")
    skip = read(profile, body)
    assert skip.time_s.tolist() == [1, 3]
    assert skip.text == run.text
    new = formats.rewrite(profile, skip, np.array([2.0, 3.0]))
    assert new == skip.text.replace(b"X1 F60", b"X1 F30").replace(b"X4\n", b"X4 F60\n")
    # nothing is read behind a slash that is skipped
    assert read(profile, "G1 X1 F60\n / X#9 [\n/\n").n == 1


def test_whole_positions(shop: Shop) -> None:
    body = "G1 X1500 F60.\nX2.5\n"
    um = read(shop("[text]\nwhole_positions = 'um'", "fanuc"), body)
    np.testing.assert_allclose(um.end_mm[:, 0], [1.5, 2.5], rtol=1e-15)
    np.testing.assert_allclose(um.time_s, [1.5, 1.0], rtol=1e-15)
    mm = read(shop("[text]\nwhole_positions = 'mm'", "fanuc"), body)
    np.testing.assert_array_equal(mm.end_mm[:, 0], [1500, 2.5])
    with pytest.raises(ProgramError, match="line 3: positions without a decimal point"):
        read(cast(GcodeDialect, dialect("fanuc")), body)


def test_feeds_without_a_point(shop: Shop) -> None:
    body = "G1 X1. F60\n"
    assert read(shop("[feed]\nwhole = 'as_is'", "haas"), body).time_s.tolist() == [1]
    with pytest.raises(ProgramError, match="line 3: the unit of F"):
        read(cast(GcodeDialect, dialect("haas")), body)


def test_vector(shop: Shop) -> None:
    profile = shop("[axes]\nvector = ['I', 'J', 'K']")
    found = read(profile, "G1 X1 I0 J0 K2 F60\nX2 I3 K4\nX3\n")
    np.testing.assert_allclose(found.axis, np.array([[0, 0, 5], [3, 0, 4], [3, 0, 4]]) / 5, atol=1e-15)
    with pytest.raises(ProgramError, match="line 3: the tool vector is zero"):
        read(profile, "G1 X1 I0 J0 K0 F60\n")
    with pytest.raises(ProgramError, match="line 3: a point before I is stated"):
        read(profile, "G1 X1 F60\nX2 I0 J0 K1\n")
    with pytest.raises(ProgramError, match="line 3: an arc while I, J, K are a tool vector"):
        read(profile, "G2 X1 I0.5 F60\n")


def test_vectors_between_codes() -> None:
    """Fanuc's G43.5: I, J, K are the tool's from there to G49, and of arcs before and after."""
    fanuc = cast(GcodeDialect, dialect("fanuc"))
    found = read(fanuc, "G43.5 H1\nG1 X1. I0. J0. K1. F60.\nG4 X1.\nX2. I1. J0. K1.\nG4 X1.\nG49\n")
    np.testing.assert_allclose(found.axis, [[0, 0, 1], [0.5**0.5, 0, 0.5**0.5]], atol=1e-15)
    assert read(fanuc, "G1 X1. F60.\nG4 X1.\nG2 X2. I0.5\nG4 X1.\n").n == 2
    with pytest.raises(ProgramError, match="line 3: I, J, K or R without an arc"):
        read(fanuc, "G1 X1. I0. J0. K1. F60.\n")


HEADS = {
    "siemens": ("TRAORI\nG0 X0 Y0 Z0 A3=0 B3=0 C3=1\n", "A3={} B3={} C3={}", "G4 F1"),
    "fanuc": ("G43.5 H1\nG0 X0. Y0. Z0. I0. J0. K1.\n", "I{} J{} K{}", "G4 X1."),
}


@pytest.mark.parametrize("name", HEADS)
def test_a_component_that_a_block_leaves_out_of_a_tool_vector_is_zero(name: str) -> None:
    """Siemens' and Fanuc's manuals say so; a block without any component keeps the vector."""
    head, vector, dwell = HEADS[name]
    whole = vector.format("0.1", "0.2", "0.97")
    first, _, third = whole.split()
    points = [f"G1 X10. {whole} F600.", f"X20. {first} {third}", "X30.", f"X40. {third}"]
    body = "".join(f"{point}\n{dwell}\n" for point in points)
    wanted = np.array([[0.1, 0.2, 0.97], [0.1, 0, 0.97], [0.1, 0, 0.97], [0, 0, 1]])
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    language = cast(GcodeDialect, dialect(name))
    program = read(language, head + body, "G90 G94\n")
    np.testing.assert_allclose(program.axis, wanted, atol=1e-15)
    for encoding in (None, "feed"):
        again = formats.read(language, formats.rewrite(language, program, 2 * program.time_s, encoding), "t.nc")
        np.testing.assert_array_equal(again.axis, program.axis)


def test_a_rotary_axis_leaves_the_tool_vector_unknown() -> None:
    siemens = cast(GcodeDialect, dialect("siemens"))
    vectors = "TRAORI\nG1 X10 A3=0 B3=0 C3=1 F600\nG4 F1\n"
    head = "G71 G90 G94\nG0 X0 Y0 Z0 A0 C0\n"
    assert read(siemens, vectors, head).n == 1
    assert read(siemens, f"{vectors}G0 Z9 C90\nG1 X20 A3=0 B3=0.6 C3=0.8\nG4 F1\n", head).n == 2
    for block in ("G1 X20 A30 C90", "G0 C90\nG1 X20", "G53 G0 C0\nG1 X20"):
        with pytest.raises(ProgramError, match=r"a point before (A3|C) is stated"):
            read(siemens, f"{vectors}{block}\nG4 F1\n", head)


OFFSETS = [
    ("siemens", "D1", "D2", "G71 G90 G94 D1\nG0 X0 Y0 Z0\n"),
    ("fanuc", "G43 H1", "H2", "G21 G90 G94 G43 H1\nG0 X0. Y0. Z0.\n"),
    ("rs274", "G43 H1", "G43 H0", "G21 G90 G94 G43 H1\nG0 X0. Y0. Z0.\n"),
]


@pytest.mark.parametrize(("name", "one", "other", "head"), OFFSETS)
def test_a_tool_offset_that_changes_between_feed_moves(name: str, one: str, other: str, head: str) -> None:
    """It moves the path. One that is stated again, or changes behind the last feed move, does not."""
    language = cast(GcodeDialect, dialect(name))
    assert read(language, f"G1 X1. F60.\n{one}\nX2.\n{other}\nG0 Z9.\n", head).n == 2
    assert read(language, f"G1 X1. F60.\n{other}\nG0 Z9.\n{one}\nG1 X2.\n", head).n == 2
    with pytest.raises(ProgramError, match="line 5: the tool offset changes in mid-program"):
        read(language, f"G1 X1. F60.\n{other}\nX2.\n", head)


PAIRS = ("CA", "CB", "AB", "BA", "AC", "BC")
ANGLES = {"A": 23.0, "B": -41.5, "C": 107.25}


@pytest.mark.parametrize("pair", PAIRS)
def test_rotary_pairs(shop: Shop, pair: str) -> None:
    """Outermost rotation first, as scipy turns about the moving axes."""
    names = {"A": "X", "B": "Y", "C": "Z"}
    outer, inner = ANGLES[pair[0]], ANGLES[pair[1]]
    profile = shop(f"[axes]\nrotary = ['{pair}']")
    found = read(profile, f"G0 {pair[0]}0 {pair[1]}0\nG1 X1 {pair[0]}{outer} {pair[1]}{inner} F60\nX2\nX3 {pair[0]}0\n")
    turned = Rotation.from_euler(names[pair[0]] + names[pair[1]], [outer, inner], degrees=True)
    alone = Rotation.from_euler(names[pair[1]], inner, degrees=True)
    expected = np.stack([turned.as_matrix()[:, 2], turned.as_matrix()[:, 2], alone.as_matrix()[:, 2]])
    np.testing.assert_allclose(found.axis, expected, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(found.axis, axis=1), 1, atol=1e-15)


@pytest.mark.parametrize("pair", PAIRS)
def test_rotary_words_of_a_table_turn_the_part(shop: Shop, pair: str) -> None:
    """The spindle stands upright: seen from the part it leans as the table's rotation undone."""
    names = {"A": "X", "B": "Y", "C": "Z"}
    outer, inner = ANGLES[pair[0]], ANGLES[pair[1]]
    profile = shop(f"[axes]\nturns = 'table'\nrotary = ['{pair}']")
    found = read(profile, f"G0 {pair[0]}0 {pair[1]}0\nG1 X1 {pair[0]}{outer} {pair[1]}{inner} F60\n")
    table = Rotation.from_euler(names[pair[0]] + names[pair[1]], [outer, inner], degrees=True)
    np.testing.assert_allclose(found.axis, [table.inv().apply([0, 0, 1])], atol=1e-15)


@pytest.mark.parametrize("pair", PAIRS)
def test_many_angles(pair: str) -> None:
    rng = np.random.default_rng(4)
    angles = {letter: rng.uniform(-360, 360, 300) for letter in "ABC"}
    names = "".join({"A": "X", "B": "Y", "C": "Z"}[letter] for letter in pair)
    found = checks.tool_axis(pair, angles["A"], angles["B"], angles["C"])
    turned = Rotation.from_euler(names, np.stack([angles[letter] for letter in pair], axis=1), degrees=True)
    np.testing.assert_allclose(found, turned.apply([0, 0, 1]), atol=1e-14)


@pytest.mark.parametrize(
    ("rotary", "words", "fits"),
    [("['CA']", "A5 B5", False), ("['CA']", "B5", False), ("[]", "A5", False), ("['CA', 'AB']", "A5 B5", True)],
)
def test_axes_in_an_unspecified_order(shop: Shop, rotary: str, words: str, fits: bool) -> None:
    profile = shop(f"[axes]\nrotary = {rotary}")
    body = f"G0 {' '.join(word[0] + '0' for word in words.split())}\nG1 X1 {words} F60\n"
    if fits:
        assert read(profile, body).n == 1
        return
    with pytest.raises(ProgramError, match=r"t\.nc"):
        read(profile, body)


def test_the_order_matters(shop: Shop) -> None:
    """A dialect that says both orders of one pair has said none: the first holds."""
    body = "G0 A0 B0\nG1 X1 A30 B40 F60\n"
    ab, ba = (read(shop(f"[axes]\nrotary = ['{pair}']"), body).axis for pair in ("AB", "BA"))
    assert np.abs(ab - ba).max() > 0.1


def test_realtime_characters(shop: Shop) -> None:
    profile = shop("[text]\nrealtime = '!~?'")
    for character in ("!", "~", "?", "\xe4"):
        with pytest.raises(ProgramError, match=r"line 3: byte 0x\w\w: the controller acts on it at once"):
            formats.read(profile, (HEAD + f"G1 X1 F60 (a{character})\nM2\n").encode("latin-1"), "t.nc")
    assert read(shop(""), "G1 X1 F60 (!~?)\n").n == 1


def test_lines_and_ends(shop: Shop) -> None:
    short = shop("[text]\nlongest_line = 20")
    assert read(short, "G1 X1 F60 (34567890)\n", head="G0 X0 Y0 Z0\n").n == 1
    with pytest.raises(ProgramError, match="line 2: the line is longer"):
        read(short, "G1 X1 F60 (345678901)\n", head="G0 X0 Y0 Z0\n")
    assert "cut short" in read(shop("[text]\nend = 'optional'"), "G1 X1 F60\n", end="").warnings[-1]
    with pytest.raises(ProgramError, match="cut short"):
        read(shop(""), "G1 X1 F60\n", end="")


def test_dwells_of_ones_own(shop: Shop) -> None:
    """The unit may differ with and without a point, a word may be a name, and a dwell may have another code."""
    text = (
        "[dwell]\ncodes = [4, 104]\nwritten = 'G104 WAIT='\n[dwell.words]\n'WAIT=' = { whole = 'ms', decimal = 's' }\n"
    )
    profile = shop(text)
    found = read(profile, "G1 X1 F60\nG104 wait=250\nX2\nG4 WAIT=0.5\nX3\nG4 P2\n")
    assert found.time_s.tolist() == [0.25, 0.5, 2.0]
    new = formats.rewrite(profile, found, np.array([1.5, 1.5, 1.5]))
    assert b"G104 wait=1500\nX2\nG4 WAIT=1.5\nX3\nG4 P1.5\n" in new
    fed = read(profile, "G1 X1 F60\n")
    assert b"\nG104 WAIT=1.5\n" in formats.rewrite(profile, fed, np.array([1.5]), "dwell")


def test_bare_dwells_of_ones_own(shop: Shop) -> None:
    """TwinCAT's bare number, written as it is read."""
    profile = shop("[dwell]\nwritten = 'G04 '\n", "twincat-cnc")
    fed = read(profile, "G1 X1 F60\n", head="G71 G90\nG0 X0 Y0 Z0\n")
    new = formats.rewrite(profile, fed, np.array([1.5]), "dwell")
    assert formats.read(profile, new, "n").time_s.tolist() == [1.5]
