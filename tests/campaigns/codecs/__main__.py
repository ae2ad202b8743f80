"""``python -m tests.campaigns.codecs [REPLIES]``: every driver's talk, and the table in docs/replies.md."""

from __future__ import annotations

import asyncio
import logging
import sys
from pathlib import Path

import pytest

from tests.campaigns.codecs.controllers import read_for_ever
from tests.campaigns.codecs.nasty import BAD, require_a_talk
from tests.campaigns.codecs.talks import TALKS, campaign
from tests.campaigns.codecs.test_variables import ads, opcua

PAGE = Path(__file__).resolve().parents[3] / "docs" / "replies.md"
BEGIN, END = "<!-- written by make replies -->\n", "<!-- end of what make replies writes -->"
HEADER = """\
| driver | broken | doubled | late | of them taken | refused or link lost | values taken | left out |
|---|---|---|---|---|---|---|---|
"""


def main(bad: int) -> None:
    """Talk, and write."""
    logging.disable()  # pymodbus tells of each broken reply
    rows = []
    with pytest.MonkeyPatch.context() as patch:
        for make in TALKS:
            nasty, outcomes = campaign(patch, make, bad)
            require_a_talk(nasty, outcomes)
            counts = [nasty.counts[kind] for kind in BAD]
            told = [
                *counts,
                0,
                outcomes["refused"] + outcomes["lost"],
                outcomes["value"],
                nasty.counts["not to be told"],
            ]
            rows.append(_row(make.name, told))
        for make_variables, name in ((opcua, "handover, OPC UA"), (ads, "handover, ADS")):
            server, variables = make_variables(patch)
            outcomes = asyncio.run(read_for_ever(variables, server, bad))
            rows.append(_row(name, [server.counts["broken"], "", "", 0, outcomes["refused"], outcomes["value"], 0]))
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(before + BEGIN + HEADER + "".join(rows) + END + rest.partition(END)[2])


def _row(name: str, told: list[int | str]) -> str:
    cells = [f"{one:,}" if isinstance(one, int) else one for one in told]
    print(name, *cells, sep=" | ", file=sys.stderr, flush=True)
    return f"| {name} | {' | '.join(cells)} |\n"


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 1_000_000)
