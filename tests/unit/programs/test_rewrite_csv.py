"""The table of dwells: read whole, of any length; every row that is no dwell is named."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from polishd.model.errors import ProgramError
from polishd.model.surface import FloatArray
from polishd.programs import rewrite
from polishd.programs.rewrite import DwellTable, dwell_rows


def read(path: Path, content: bytes) -> FloatArray:
    path.write_bytes(content)
    return np.concatenate(list(dwell_rows(path)))


@pytest.mark.parametrize(
    ("content", "values"),
    [
        (b"1\n2\n", [1.0, 2.0]),
        (b"1\n2", [1.0, 2.0]),
        (b"1\r\n2\r\n", [1.0, 2.0]),
        (b" 0.5 \n\t.25\n", [0.5, 0.25]),
        (b"1e-3\n+2.\n", [0.001, 2.0]),
        (b"0\n-0\n", [0.0, 0.0]),
        (b"\xef\xbb\xbf1\n", [1.0]),
    ],
)
def test_rows_are_read(tmp_path: Path, content: bytes, values: list[float]) -> None:
    found = read(tmp_path / "d.csv", content)
    assert found.tolist() == values
    assert not np.signbit(found).any()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"dwell_s\n1\n", 'row 1 is a header: "dwell_s"'),
        (b"1\nx\n", 'row 2 is not a number: "x"'),
        (b"1\nnan\n", 'row 2 is not finite: "nan"'),
        (b"NaN\n", 'row 1 is not finite: "NaN"'),
        (b"inf\n", "row 1 is not finite"),
        (b"1e999\n", "row 1 is not finite"),
        (b"1\n2\n-0.5\n", 'row 3 is below zero: "-0.5"'),
        (b"1\n1e9\n", "row 2 asks for more than 1000000 s (12 days) at one point"),
        (b"1\n\n2\n", "row 2 is empty"),
        (b"1\n\n", "row 2 is empty"),
        (b"\n", "row 1 is empty"),
        (b"0,5\n", "row 1 holds a comma"),
        (b"1;2\n", "row 1 holds a comma or semicolon"),
        (b"1 2\n", "row 1 is not a number"),
        (b"1_000\n", "row 1 is not a plain number"),
        (b"0x10\n", "row 1 is not a number"),
        (b"\xd9\xa1\n", "row 1 is not a number"),
        (b"1\n\x00\n", "row 2 is not a number"),
        (b"\xff\xfe1\x00", "row 1 is not a number"),
        (b"", "the table of dwells is empty"),
    ],
)
def test_what_is_no_dwell_is_refused_by_row(tmp_path: Path, content: bytes, says: str) -> None:
    with pytest.raises(ProgramError, match=re.escape(says)) as raised:
        read(tmp_path / "d.csv", content)
    assert str(raised.value).startswith(str(tmp_path / "d.csv"))
    assert "To do: " in str(raised.value)


@pytest.mark.parametrize("piece", [2, 1 << 20])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_the_table_of_a_plan_is_read_by_its_column(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str, piece: int
) -> None:
    monkeypatch.setattr(rewrite, "_PIECE", piece)
    rows = ["point,line,dwell_s,asked_s", "0,5,0.25,9", "1,6,0.5,9", "2,7,1e-3,9"]
    assert read(tmp_path / "d.csv", end.join(rows).encode()).tolist() == [0.25, 0.5, 0.001]
    rows[2] = "1,6"
    with pytest.raises(ProgramError, match="row 2 is empty"):
        read(tmp_path / "d.csv", end.join(rows).encode())
    with pytest.raises(ProgramError, match="the table of dwells is empty"):
        read(tmp_path / "d.csv", rows[0].encode())
    with pytest.raises(ProgramError, match="row 1 holds a comma"):
        read(tmp_path / "d.csv", b"point,line,time_s\n0,5,1\n")


@pytest.mark.parametrize("bad", [1, 7, 500, 999])
def test_a_long_table_comes_in_pieces_and_its_rows_keep_their_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bad: int
) -> None:
    monkeypatch.setattr(rewrite, "_PIECE", 64)
    rows = [f"{0.001 * row:.3f}" for row in range(1000)]
    path = tmp_path / "d.csv"
    path.write_text("\n".join(rows))
    pieces = list(dwell_rows(path))
    assert len(pieces) > 50
    assert np.concatenate(pieces).tolist() == [float(row) for row in rows]
    rows[bad - 1] = "oops"
    with pytest.raises(ProgramError, match=f"row {bad} is (not a number|a header)"):
        read(path, "\n".join(rows).encode())


def test_what_cannot_be_read_is_refused(tmp_path: Path) -> None:
    for path, reason in ((tmp_path, "Is a directory"), (tmp_path / "none.csv", "No such file")):
        with pytest.raises(ProgramError, match=reason):
            list(dwell_rows(path))


def test_rows_are_taken_in_any_portions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rewrite, "_PIECE", 64)
    path = tmp_path / "d.csv"
    path.write_text("".join(f"{row}\n" for row in range(1000)))
    for portions in ([1000], [1, 0, 7, 992], [100] * 10, [0, 999, 1]):
        table = DwellTable(path)
        found = [table.take(count) for count in portions]
        assert [len(rows) for rows in found] == portions
        assert np.concatenate(found).tolist() == list(range(1000))
        table.finish()
        assert table.total_s == 499500.0


@pytest.mark.parametrize("portions", [[4], [3, 1], [2, 2], [0, 4]])
def test_rows_that_are_missing_are_named(tmp_path: Path, portions: list[int]) -> None:
    (tmp_path / "d.csv").write_text("1\n2\n3")
    table = DwellTable(tmp_path / "d.csv")
    with pytest.raises(ProgramError, match="row 4 is missing: the program has more points"):
        list(map(table.take, portions))


@pytest.mark.parametrize("piece", [2, 64])
def test_rows_that_are_left_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int) -> None:
    monkeypatch.setattr(rewrite, "_PIECE", piece)
    (tmp_path / "d.csv").write_text("1\n2\n3")
    table = DwellTable(tmp_path / "d.csv")
    table.take(2)
    with pytest.raises(ProgramError, match="row 3 is one too many: the program has 2 points"):
        table.finish()
