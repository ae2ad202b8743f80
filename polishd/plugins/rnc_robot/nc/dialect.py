"""A dialect of ISO-like NC text as strict data: what a controller's words mean."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Unit = Literal["s", "ms", "refuse"]
Codes = dict[str, list[float]]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class DwellWord(_Strict):
    """The unit of a dwell's number, as it is written."""

    whole: Unit
    """Without a decimal point."""
    decimal: Unit
    """With one."""


class DwellRules(_Strict):
    """How a dwell is written."""

    codes: list[float]
    words: dict[str, DwellWord]
    """By letter, by name as it stands in the text (``TIME=``), or ``number`` for a bare one."""
    refused: dict[str, str]
    """Letters that mean something else beside the dwell code, and what."""
    decimals: Annotated[int, Field(ge=0, le=9)]
    """Of new numbers in seconds, where the program's own have fewer."""
    most_decimals: Annotated[int, Field(ge=0, le=12)]
    resolution_s: Annotated[float, Field(ge=0, le=1e3)] = 0.0
    """What the controller really resolves, where that is coarser than what can be written."""
    longest_s: Annotated[float, Field(ge=1e-6, le=1e12)]
    written: str
    """How a new dwell block begins; the number follows."""
    own_block: bool


class FeedRules(_Strict):
    """What F means."""

    unit: Literal["mm/min", "mm/s"]
    g93: Literal["1/min", "s", "refuse"]
    whole: Literal["as_is", "unsure"]
    """F without a decimal point: as it stands, or up to a machine parameter. In inches it always is."""
    most_decimals: Annotated[int, Field(ge=0, le=12)]


class TextRules(_Strict):
    """How text becomes words."""

    comments: list[Literal["()", ";"]]
    end_of_block: bool
    blanks_in_numbers: bool
    assign: bool
    block_delete: Literal["refuse", "run", "skip"]
    whole_positions: Literal["mm", "um", "unsure"]
    commands: list[str]
    """What comments begin with that the controller runs, before a comma."""
    realtime: str
    """Characters that the controller acts on wherever they stand; with any, bytes beyond ASCII are such, too."""
    longest_line: Annotated[int, Field(ge=20, le=4096)]
    tape: Literal["percent", "name"]
    program_number: bool
    end: Literal["required", "optional"]


class AxisRules(_Strict):
    """Which words turn the tool, or the part beneath it."""

    rotary: list[Literal["CA", "CB", "AB", "BA", "AC", "BC"]]
    """Pairs that a program may use, outermost rotation first: CA is Rz(C) Rx(A)."""
    turns: Literal["tool", "table"]
    """What they turn. The tool axis in the frame of a part on a table is the table's rotation undone."""
    vector: list[str]
    """Three words of a tool vector from the tip into the spindle; empty: none."""


class WordRules(_Strict):
    """Words that change neither time nor place."""

    neutral: list[str]
    keywords: list[str]


class GcodeDialect(_Strict):
    """A profile of ISO-like NC text (``kind = "nc"``)."""

    kind: Literal["nc"]
    name: str
    title: str
    dwell: DwellRules
    feed: FeedRules
    text: TextRules
    axes: AxisRules
    words: WordRules
    g: Codes
    """G codes by what they do; what stands nowhere is refused."""
    m: Codes
    refused_g: dict[str, str]
    """Why a G code is refused."""
    refused_words: dict[str, str]
