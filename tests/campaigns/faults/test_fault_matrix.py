"""One of the faults of ``make faults``, and its page."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.campaigns.faults.judge import measure
from tests.campaigns.faults.links import LINKS
from tests.campaigns.faults.page import BEGIN, END, PAGE

pytestmark = pytest.mark.system

CASES = [(name, fault) for name, link in LINKS.items() for fault in link.faults]
BY_TIME = ("force off ", "noticed after ")
"""What a busy machine may be guilty of."""


@pytest.mark.full
@pytest.mark.timeout(200)
def test_a_device_that_hangs_in_contact_is_noticed_and_the_tool_taken_off(tmp_path: Path) -> None:
    finding = measure("actuator, Modbus RTU", "hangs", tmp_path / "cell")
    assert [one for one in finding.wrong if not one.startswith(BY_TIME)] == []
    assert "no answer within 1 s" in finding.noticed
    assert finding.outcome == "contact left, exit code 5"


def test_the_page_names_no_case_that_there_is_not() -> None:
    written = PAGE.read_text().partition(BEGIN)[2].partition(END)[0].partition("| link | losses |")[0]
    rows = [tuple(cell.strip() for cell in line.split("|")[1:3]) for line in written.splitlines() if line[:1] == "|"]
    assert set(rows[2:]) <= set(CASES)
