"""docs/reference: what the models give, no key without a meaning, no number without a unit."""

from __future__ import annotations

import pytest
from pydantic import BaseModel

from docs.reference import write

TABLES = [(f"{name} {header}", model) for name, tables in write.files().items() for header, model in tables]


@pytest.mark.full
@pytest.mark.parametrize(
    "name", ["cell.md", "study.md", "profile.md", "device.md", "simulator.md", "controller.md", "shop.md"]
)
def test_the_pages_are_what_the_models_give(name: str) -> None:
    assert (write.FOLDER / name).read_text() == write.pages()[name], "write them anew: make reference"


@pytest.mark.one_of_each
@pytest.mark.parametrize(("table", "model"), TABLES, ids=[table for table, _ in TABLES])
def test_every_key_says_what_it_means_and_in_which_unit(table: str, model: type[BaseModel]) -> None:
    for key in write.keys(model):
        assert len(key.meaning.split()) > 1, f"{table} {key.name}: write a docstring below it"
        assert key.unit or "number" not in key.type, f"{table} {key.name}: end its docstring with its unit: [mm], [1]"


def test_all_kinds_of_tables_are_found() -> None:
    headers = {table for table, _ in TABLES}
    assert headers >= {
        "cell ",
        "cell [part]",
        'cell [kinematics] type = "serial"',
        'cell [robot] type = "linuxcnc"',
        'study kind = "passes"',
        "study [spots.NAME]",
        "profile [[artefact.bumps]]",
        "device [registers.NAME]",
        "device [[states]]",
        "simulator [[fault]]",
    }


@pytest.mark.full
def test_a_row_has_all_that_the_model_says() -> None:
    rows = write.pages()["cell.md"].splitlines()
    assert "| `edge_mm` | number | mm | `3` | >= 0 | Width of the rim" in "\n".join(rows)
    (dh,) = (row for row in rows if row.startswith("| `dh` |"))
    assert dh.startswith("| `dh` | list of 6 lists of 4 numbers | mm, deg, mm, deg | required |  | Six Denavit")
    preston, _ = (row for row in rows if row.startswith("| `preston` |"))  # of [process]; of a tool
    assert '| text | as written | `"1.49e-09 cm2/N"` | > 0, < 0.001 cm2/N |' in preston
