"""Differences between the terms of a job and the present values, value by value."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from polishd.config.cell import load_config
from polishd.daemon.job.resume_checks import file_terms, may_change, require_same, terms_of
from polishd.model.errors import ConfigError
from tests.unit.daemon.job.test_resume_checks import begin, cell, change  # noqa: F401 - a fixture

FILE, OTHER = {"file": "a.csv", "sha256": "aa" * 32}, {"file": "b.csv", "sha256": "bb" * 32}


class Begun:
    """A journal with terms only."""

    def __init__(self, terms: dict[str, Any] | None) -> None:
        self.terms = terms


def refusal(cell: Path, begun: dict[str, Any], now: dict[str, Any]) -> list[str]:  # noqa: F811
    """Message of each difference."""
    journal: Any = Begun(begun)
    try:
        require_same(load_config(cell), now, journal)
    except ConfigError as error:
        *lines, todo = str(error).splitlines()
        assert todo.startswith("the job has begun and cannot continue with these values. ")
        return [line.split(": ", 1)[1] for line in lines]
    return []


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        (1.0, 1.0, ""),
        (1.0, None, "is nothing, the job 'demo' began with 1.0"),
        (None, "x", "is 'x', the job 'demo' began with nothing"),
        ([1.0, 2.0], [1.0, 3.0], "is [1.0, 3.0], the job 'demo' began with [1.0, 2.0]"),
        (FILE, {**FILE, "file": "moved.csv"}, ""),
        (FILE, OTHER, "is b.csv (sha256 bbbbbbbbbbbb), the job 'demo' began with a.csv (sha256 aaaaaaaaaaaa)"),
        ([FILE, OTHER], [{**FILE, "file": "c"}, OTHER], ""),
        (
            [FILE],
            [OTHER],
            "is [b.csv (sha256 bbbbbbbbbbbb)], the job 'demo' began with [a.csv (sha256 aaaaaaaaaaaa)]",
        ),
        ([FILE], [FILE, OTHER], "is [a.csv (sha256 aaaaaaaaaaaa), b.csv (sha256 bbbbbbbbbbbb)], the job 'demo' began"),
    ],
)
def test_what_counts_of_a_value_and_what_is_said_of_it(cell: Path, was: Any, now: Any, said: str) -> None:  # noqa: F811
    found = refusal(cell, {"part.edge_mm": was}, {"part.edge_mm": now})
    assert len(found) == bool(said)
    assert "".join(found).startswith(f"part.edge_mm: {said}" if said else "")


def test_each_that_differs_is_reported_once_in_their_order_also_where_one_side_has_none(cell: Path) -> None:  # noqa: F811
    found = refusal(
        cell,
        {"process.rpm": 1.0, "part.a": 1, "dwell.cpu_limit_s": 1.0},
        {"part.edge_mm": 2.0, "part.a": 1, "dwell.cpu_limit_s": 2.0},
    )
    assert [line.split(":")[0] for line in found] == ["part.edge_mm", "process.rpm"]


def test_a_job_of_an_earlier_polishd_is_refused_at_its_name(cell: Path) -> None:  # noqa: F811
    config = load_config(cell)
    journal: Any = Begun(None)
    with pytest.raises(ConfigError, match=re.escape(f"Restore {config.state_dir / 'journal.v1.sqlite'} as journal.sq")):
        require_same(config, {}, journal)


@pytest.mark.parametrize(
    ("key", "may"),
    [
        ("machine.x_mm", True),
        ("machine.accel_mm_s2", False),
        ("job.max_cycles", True),
        ("job.id", False),
        ("loader", True),
        ("loader.type", True),
        ("touch_off", True),
        ("touch_off.force_n", True),
        ("part", False),
        ("roles.tool", False),
        ("include", True),
        ("plugins.load", True),
        ("ripple.amplitude_nm", True),
        ("notify.mail.to", True),
        ("shop.url", True),
        ("opcua.port", True),
        ("tools.wide.change_s", True),
        ("tools.wide.position_mm", True),
        ("tools.wide.force_max_n", True),
        ("tools.wide.radius_mm", False),
        ("estimates.use_previous", True),
        ("estimates.tool", False),
    ],
)
def test_the_first_rule_that_fits_holds(key: str, may: bool) -> None:
    assert may_change(key) is may


def test_files_are_named_with_what_they_hold_and_one_that_is_gone_is_reported(cell: Path) -> None:  # noqa: F811
    config = begin(cell)
    found = file_terms(config, {}, ["instrument.profile", "part.form", "no.such.key"])
    assert list(found) == ["instrument.profile"], "of those that name one"
    assert set(found["instrument.profile"]) == {"file", "sha256"}
    assert config.profile_path is not None
    config.profile_path.unlink()
    with pytest.raises(
        ConfigError, match=re.escape(f"{config.profile_path}: cannot be read: No such file or directory")
    ):
        file_terms(config, {}, ["instrument.profile"])


def test_only_a_program_counts_with_the_file_of_its_positions(cell: Path) -> None:  # noqa: F811
    config = begin(cell)
    beside = SimpleNamespace(data_file=SimpleNamespace(find=lambda _: b"positions"))
    formats: Any = {config.program.format: beside}
    keys = ["instrument.profile", "program.path"]
    alone, together = file_terms(config, {}, keys), file_terms(config, formats, keys)
    assert together["instrument.profile"] == alone["instrument.profile"]
    assert together["program.path"] != alone["program.path"]


def test_the_program_counts_as_it_was_read(cell: Path) -> None:  # noqa: F811
    config = load_config(cell)
    terms = terms_of(config, {}, "cc" * 32)
    assert terms["program.path"] == {"file": config.program.path, "sha256": "cc" * 32}
    change(cell, "part", {"edge_mm": 7.5})
    assert terms_of(load_config(cell), {}, "cc" * 32)["part.edge_mm"] == 7.5
