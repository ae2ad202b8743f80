"""The check of the campaigns finds each contradiction between journal and plant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.journal.records import BlockRecord
from polishd.model.devices import ExecutedBlock
from tests.system.agreement import disagreements
from tests.unit.daemon.small_job import open_journal

RUN_S = 0.1


def kept(state_dir: Path, touched: list[bool | None], tail: tuple[int, int] = (0, 0)) -> Path:
    """A journal of ten blocks of contact, those recorded first."""
    with open_journal(state_dir) as journal:
        journal.begin_pass(0, "sha", "boot", 10)
        records = [
            BlockRecord(ExecutedBlock(seq, seq * RUN_S, (seq + 1) * RUN_S), known) for seq, known in enumerate(touched)
        ]
        journal.record_executed(0, records)
        journal.mark_uncertain(0, *tail)
    return state_dir / "journal.sqlite"


def book(*contact_s: float) -> list[dict[str, Any]]:
    return [{"sha256": "sha", "contact_s": [*contact_s, *[0.0] * (10 - len(contact_s))]}]


@pytest.mark.parametrize(
    ("touched", "tail", "contact_s"),
    [
        ([True, True], (2, 2), (0.1, 0.1)),
        ([True, None, None, False], (4, 4), (0.1, 0.1, 0.03)),
        ([True], (1, 4), (0.1, 0.1, 0.1, 0.05)),
    ],
)
def test_agreement(
    tmp_path: Path, touched: list[bool | None], tail: tuple[int, int], contact_s: tuple[float, ...]
) -> None:
    assert disagreements(kept(tmp_path, touched, tail), book(*contact_s)) == []


@pytest.mark.parametrize(
    ("touched", "tail", "contact_s", "says"),
    [
        ([True, True], (2, 2), (0.1, 0.05), "block 1: touched in 0.100 s; the plant saw 0.050 s"),
        ([True, True], (2, 2), (0.1, 0.2), "block 1: touched in 0.100 s; the plant saw 0.200 s"),
        ([True, False], (2, 2), (0.1, 0.03), "block 1: not touched in 0.100 s; the plant saw 0.030 s"),
        ([True, None], (2, 2), (0.1, 0.2), "block 1: executed in 0.100 s; the plant saw 0.200 s"),
        ([True], (1, 2), (0.1, 0.1, 0.1), "block 2: not touched in 0.000 s; the plant saw 0.100 s"),
    ],
)
def test_contradictions(
    tmp_path: Path, touched: list[bool | None], tail: tuple[int, int], contact_s: tuple[float, ...], says: str
) -> None:
    (found,) = disagreements(kept(tmp_path, touched, tail), book(*contact_s))
    assert found.endswith(says)


@pytest.mark.parametrize(
    ("known", "contact_s", "says"),
    [
        (True, (0.1, 0.1, 0.14, 0.06), []),  # shared out otherwise
        (True, (0.1, 0.1, 0.18, 0.02), ["block 2: touched in 0.100 s; the plant saw 0.180 s", "block 3: touched"]),
        (True, (0.1, 0.1, 0.14, 0.14), ["blocks 2 to 3: 0.200 s in all; the plant saw 0.280 s"]),
        (True, (0.1, 0.14, 0.1, 0.1), ["block 1: touched in 0.100 s; the plant saw 0.140 s"]),  # reported alone
        (None, (0.1, 0.1, 0.14, 0.0), []),
        (None, (0.1, 0.1, 0.18, 0.0), ["block 2: executed in 0.100 s; the plant saw 0.180 s"]),
    ],
)
def test_what_one_report_tells_of_is_shared_out_by_the_motion_model(
    tmp_path: Path, known: bool | None, contact_s: tuple[float, ...], says: list[str]
) -> None:
    with open_journal(tmp_path) as journal:
        journal.begin_pass(0, "sha", "boot", 10)
        told_s = (1.0, 2.0, 3.0, 3.0)
        journal.record_executed(
            0,
            [
                BlockRecord(
                    ExecutedBlock(seq, seq * RUN_S, (seq + 1) * RUN_S), touched=known if seq > 1 else True, told_s=at_s
                )
                for seq, at_s in enumerate(told_s)
            ],
        )
        journal.mark_uncertain(0, 4, 4)
    found = disagreements(tmp_path / "journal.sqlite", book(*contact_s), by_model=True)
    assert len(found) == len(says)
    for one, said in zip(found, says, strict=True):
        assert said in one


def test_a_touch_off_is_no_pass_and_touches_while_the_robot_stands(tmp_path: Path) -> None:
    journal = kept(tmp_path, [True, True], (2, 2))
    places = [{"sha256": f"place {place}", "contact_s": [0.0] * 4} for place in range(3)]
    assert disagreements(journal, [*places, *book(0.1, 0.1)]) == []
    places[1]["contact_s"] = [0.0, 0.0, 0.2, 0.0]
    (found,) = disagreements(journal, [*places, *book(0.1, 0.1)])
    assert found == "place 1 block 2: not touched in 0.000 s; the plant saw 0.200 s"
