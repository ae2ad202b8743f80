"""`make soak` detects each failure that it looks for; a short soak (full), and some minutes of one (slow)."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from collections import Counter
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polishd.daemon.journal.store import SCHEMA, connect
from tests.campaigns.soak.cell import Row
from tests.campaigns.soak.figures import BEGIN, END, HEAD, LIFE_BEGIN, LIFE_END, PAGE, Figures, Sums, table
from tests.campaigns.soak.growth import BOUNDS, WARM, slope
from tests.campaigns.soak.judge import DEEPER_NM, STANDS_S, truth_of, untouched
from tests.campaigns.soak.parts import drawn
from tests.campaigns.soak.records import LATE_S, Record
from tests.campaigns.soak.scripts import ACCEPTED, BY_A_PERSON, CALM, SCRIPTS
from tests.campaigns.soak.session import GROUP, grouped
from tests.campaigns.soak.usage import Meter, children, held

# what is drawn


def test_a_part_depends_on_its_number_only_and_no_two_in_a_row_need_a_person() -> None:
    parts = [drawn(1, number) for number in range(3000)]
    assert parts == [drawn(1, number) for number in range(3000)]
    assert parts != [drawn(2, number) for number in range(3000)]
    assert not any(a.script.needs_person and b.script.needs_person for a, b in pairwise(parts))
    found, total = Counter(part.script.name for part in parts), sum(script.share for script in SCRIPTS)
    assert len({script.name for script in SCRIPTS}) == len(SCRIPTS) == len(found)
    assert all(found[script.name] > 0.4 * len(parts) * script.share / total for script in SCRIPTS)


def test_parts_in_peace_are_added_together_and_all_others_alone() -> None:
    parts = [drawn(1, number) for number in range(200)]
    groups = list(grouped(parts))
    assert [part for group in groups for part in group] == parts
    assert max(map(len, groups)) == GROUP
    assert all(part.script is CALM for group in groups if len(group) > 1 for part in group)


def test_a_script_names_its_part_in_the_simulators_file() -> None:
    jams = next(script for script in SCRIPTS if script.name == "loader jams")
    assert jams.sections("P") == {"loader.faults": {"jammed": ["P"]}}
    assert jams.needs_person
    assert not CALM.needs_person


# what is used


def test_a_process_that_has_ended_keeps_what_it_used() -> None:
    busy = "import sys; sum(k * k for k in range(1_500_000)); print(flush=True); sys.stdin.read()"
    meter = Meter()
    with subprocess.Popen([sys.executable, "-c", busy], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        assert process.pid in children(os.getpid())
        found = held(process.pid)
        assert found is not None
        assert found.rss_mb > 1.0
        assert (found.descriptors >= 3, found.threads) == (True, 1)
        meter.look({"worker": [process.pid]})
    meter.look({"worker": [process.pid]})
    assert held(process.pid) is None
    assert meter.total_s()["worker"] >= 0.02
    meter.add("commands", 1.0)
    assert meter.total_s()["commands"] == 1.0


def life(per_part: float, parts: int, noise: float, seed: int) -> list[tuple[float, float]]:
    """Return (part, MB) of one daemon's memory; modules are loaded during the first parts."""
    luck = random.Random(seed)
    return [(k, 100.0 + per_part * k - (50.0 if k < WARM else 0.0) + luck.gauss(0.0, noise)) for k in range(parts)]


def test_a_leak_is_distinguished_from_noise() -> None:
    bound = BOUNDS["daemon_rss_mb"]
    flat = slope([life(0.0, WARM + 25, 0.5, seed) for seed in range(5)])
    assert flat.flat(bound)
    assert not flat.grows(bound)
    leaks = slope([life(0.3, WARM + 25, 0.5, seed) for seed in range(5)])
    assert leaks.grows(bound)
    assert leaks.per_part == pytest.approx(0.3, abs=0.05)
    few = slope([life(0.0, 5, 5.0, 1)])
    assert not few.lives
    assert not few.grows(bound)
    assert not few.flat(bound), "too few say nothing"


# what is judged


class Shop:
    """Files of one part that was polished in one pass of three blocks, with the plant's record."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files: Any = SimpleNamespace(sim_dir=folder, state_dir=folder)
        (folder / "cycle-00").mkdir()
        x = np.arange(-4, 5)
        self.planned_nm = 60.0 + x[:, None] + 0.0 * x[None, :]
        self.contact_s = [0.5, 0.25, 0.25]
        self.stands: list[dict[str, float]] = []
        self.loads = 1
        self.height_nm = -self.planned_nm * 0.9

    def judged(self) -> list[str]:
        """Return the failures found."""
        np.savez(self.folder / "cycle-00/plan.npz", predicted_removal_nm=self.planned_nm)
        (self.folder / "summary.json").write_text(json.dumps({"cycles": [{"how": "done"}, {"how": None}]}))
        with connect(self.folder / "journal.sqlite") as journal:
            journal.executescript(SCHEMA)
            journal.execute("INSERT INTO job (name, part_id, terms, started) VALUES ('j', 'p', '', 0)")
            journal.execute(
                "INSERT INTO pass VALUES (1, 0, 'ab', '', 3, 0, 3, '', 0, 1, 'done', '', '', 1, NULL, NULL)"
            )
            rows = [(1, 0, seq, seq, seq + s, 1, 0) for seq, s in enumerate((0.5, 0.25, 0.25))]
            insert = "INSERT INTO segment (job, cycle, seq, start_s, end_s, touched, recovered) VALUES (?,?,?,?,?,?,?)"
            journal.executemany(insert, rows)
        books = [{"sha256": "ab", "blocks": 3, "loads": self.loads, "contact_s": self.contact_s}]
        (self.folder / "dwell_account.json").write_text(json.dumps({"programs": books, "stands": self.stands}))
        flat, clear = np.zeros((13, 13)), np.ones((9, 9), dtype=bool)
        flat[2:-2, 2:-2] = self.height_nm
        surface = {"height_nm": flat, "start_nm": np.zeros((13, 13)), "clear": clear, "pad": 2}
        np.savez(self.folder / "truth.npz", **surface)  # type: ignore[arg-type]
        cell: Any = SimpleNamespace(files=self.files)
        return truth_of(
            cell, Row("accepted", "", "", str(self.folder), 1.0), self.folder / "truth.npz", 0.0, 10.0
        ).wrong


def test_a_part_that_was_polished_as_planned_is_not_damaged(tmp_path: Path) -> None:
    shop = Shop(tmp_path)
    shop.stands = [{"x_mm": 0.0, "y_mm": 0.0, "from_s": 11.0, "seconds": 9.0}]  # on the next part
    assert shop.judged() == []
    assert not untouched(tmp_path / "truth.npz")


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        ({"contact_s": [0.5, 0.25, 0.5]}, "block 2: touched in 0.250 s; the plant saw 0.500 s"),
        ({"loads": 2}, "was loaded 2 times"),
        ({"stands": [{"x_mm": 1.0, "y_mm": 1.0, "from_s": 5.0, "seconds": 2 * STANDS_S}]}, "stood on the part"),
    ],
)
def test_what_the_plant_saw_otherwise_is_damage(tmp_path: Path, harm: dict[str, Any], said: str) -> None:
    shop = Shop(tmp_path)
    vars(shop).update(harm)
    (wrong,) = shop.judged()
    assert wrong.startswith("damage: ")
    assert said in wrong


def test_a_place_that_is_deeper_than_planned_is_damage(tmp_path: Path) -> None:
    shop = Shop(tmp_path)
    shop.height_nm[4, 4] = -1.15 * shop.planned_nm[4, 4] - DEEPER_NM - 1.0
    (wrong,) = shop.judged()
    assert "deeper than planned" in wrong


def record(number: int, **values: Any) -> dict[str, Any]:
    """Return the record of a part that was accepted correctly."""
    held_then = {"daemon_rss_mb": 100.0, "descriptors": 20.0, "written_mb": 0.1}
    cpu_s = {"daemon": 1.0, "simulators": 2.0, "commands": 30.0}
    measured = {"limit_nm": 2.0, "uncertainty_nm": 0.3, "rms_nm": 1.9}
    made = Record(number, f"P{number}", CALM.name, "s", "s/1", age=number, verdict=ACCEPTED, cpu_s=cpu_s,
                  held=held_then, measured=measured, true_rms_nm=1.8)  # fmt: skip
    facts = asdict(made) | values
    return {**facts, "too_slow": Record(**facts).too_slow}


@pytest.mark.parametrize(
    ("some", "said"),
    [
        ({}, []),
        ({"true_rms_nm": 2.2}, []),
        ({"verdict": "rejected", "wrong": ["end: rejected"]}, []),
        ({"verdict": "rejected", "wrong": ["end: rejected"], "number": [7, 8]}, ["2 of 50 parts were not accepted"]),
        ({"true_rms_nm": 2.2, "number": [7, 8]}, ["2 accepted parts are out of tolerance"]),
        ({"true_rms_nm": 2.4}, ["1 of them by more than the stated uncertainty"]),
        ({"wrong": ["damage: it is scratched"]}, ["1 parts are damaged"]),
        ({"script": BY_A_PERSON[0].name, "wrong": ["end: accepted"]}, ["1 faults that need a person"]),
        ({"script": BY_A_PERSON[0].name, "wrong": ["held: LinkError: "], "unexpected": ["LinkError: "],
          "late_s": 2 * LATE_S}, []),
        ({"cpu_s": {"daemon": 21.0}, "number": list(range(50))}, ["a part takes 21.0 CPU seconds"]),
    ],
)  # fmt: skip
def test_each_failure_is_reported(some: dict[str, Any], said: list[str]) -> None:
    numbers = some.pop("number", [7])
    sums = Sums([record(number, **(some if number in numbers else {})) for number in range(50)])
    found = sums.wrong()
    assert len(found) == len(said), found
    assert all(a.startswith(b) for a, b in zip(found, said, strict=True))


def test_figures_are_kept_as_they_come_and_a_line_that_was_cut_off_is_none(tmp_path: Path) -> None:
    figures = Figures(tmp_path, 1, 60.0)
    made = {name: value for name, value in record(3).items() if name != "too_slow"}
    figures.add(Record(**made))
    (path,) = tmp_path.glob("*.jsonl")
    with path.open("a") as file:
        file.write('{"number": 4, "par')
    assert Figures(tmp_path, 1, 60.0).done == {3}
    assert Figures(tmp_path, 2, 60.0).done == set()
    Figures(tmp_path, 1, 60.0).add(Record(**(made | {"number": 4})))
    assert Figures(tmp_path, 1, 60.0).done == {3, 4}
    text = table(figures.sums(), figures.conditions())
    assert "| parts through the queue | 1 |" in text
    assert all(f"| {script.name} |" in text for script in SCRIPTS)


def test_the_page_has_what_the_campaign_wrote_and_nothing_that_may_not_be() -> None:
    written = PAGE.read_text().partition(BEGIN)[2].partition(END)[0]
    rows = dict(line.strip("| ").split(" | ", 1) for line in written.partition(HEAD)[0].splitlines()[2:] if line)
    assert int(rows["parts through the queue"].replace(",", "")) > 20
    assert {rows[name] for name in rows if "uncertainty" in name or "damaged" in name} == {"**0**"}
    missing = {script.name for script in SCRIPTS if f"| {script.name} |" not in written}
    assert not missing, "scripts that were changed after the campaign of the page"


def test_nothing_grows_over_the_long_life_on_the_page() -> None:
    written = PAGE.read_text().partition(LIFE_BEGIN)[2].partition(LIFE_END)[0]
    growth = [line for line in written.splitlines() if line.startswith("| growth a part: ")]
    assert len(growth) == len(BOUNDS)
    assert not [line for line in growth if "**grows**" in line or "not known" in line]
    assert all(": flat" in line for line in growth if "memory" in line or "written" in line)


# the campaign itself


def soak(folder: Path, *arguments: str) -> dict[str, Any]:
    """Run the campaign and return its last line."""
    command = [sys.executable, "-m", "tests.campaigns.soak", "--folder", str(folder), "--json", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return dict(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.full
@pytest.mark.system
@pytest.mark.timeout(600)
def test_a_few_parts_of_it_and_they_are_not_done_again(tmp_path: Path) -> None:
    """One part without a fault and one of each kind that needs an operator; slowly, for a busy machine."""
    some = ("--only", "nothing", "map flipped", "loader jams", "--speed", "20", "--parts")
    found = soak(tmp_path, *some, "2")
    assert (found["parts"], found["accepted"], found["visits"], found["damaged"]) == (2, 1, 1, 0)
    again = soak(tmp_path, *some, "3")
    assert (again["parts"], again["accepted"], again["visits"]) == (3, 2, 2)
    assert not list((tmp_path / "cells").iterdir())


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.timeout(1200)
def test_some_minutes_of_make_soak(tmp_path: Path) -> None:
    found = soak(tmp_path, "--minutes", "4", "--speed", "30", "--seed", "3")
    assert found["parts"] - found["not_counted"] >= 10
