"""What a job is begun with, and what of that may be changed while it is under way.

A daemon that is started again goes on with its job. Masks, heights, executed times and what was learned were made with
the values of before; under others they would be taken for what they are not.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from polishd.config.cell import FILES, CellConfig, tool_files
from polishd.config.process_sections import LIMITS_OF_PROCESS
from polishd.daemon.journal.journal import JOURNAL_NAME, Journal
from polishd.daemon.journal.store import old_copy
from polishd.model.errors import ConfigError


@dataclass(frozen=True, slots=True)
class ResumeRule:
    """Dotted keys (``part.*`` is all of a section), whether they may change within a job, and why."""

    keys: tuple[str, ...]
    may_change: bool
    why: str


RULES = (
    ResumeRule(("include",), True, "a way to write the same values"),
    ResumeRule(("cell.*",), True, "names and places; the job stays in the run folder in which it began"),
    ResumeRule(("plugins.*",), True, "what a plugin does for the job is named by other keys"),
    ResumeRule(
        ("robot.*", "actuator.*", "spindle.*", "metrology.*", "loader*", "force_sensor*", "monitor*", "signals*"),
        True,
        "how a device is reached, its time limits, and what it watches",
    ),
    ResumeRule(
        ("notify.*", "web.*", "certificate.*", "shop*", "opcua*"),
        True,
        "who hears of it, watches and orders, who certifies it, and where it came from",
    ),
    ResumeRule(("roles.*",), False, "another robot or tool removes otherwise, and what was learned is of this one"),
    ResumeRule(("dwell.*",), True, "how the next dwell is chosen; each has a certificate of its own"),
    ResumeRule(("touch_off*", "part_handling.*"), True, "what is done beside polishing removes nothing"),
    ResumeRule((*LIMITS_OF_PROCESS, "tools.*.force_max_n"), True, "what ends contact from now on"),
    ResumeRule(("limits.*", "machine.x_mm", "machine.y_mm", "machine.z_mm"), True, "what is refused from now on"),
    ResumeRule(
        ("job.tolerance_nm", "tolerance", "job.accept_by", "job.max_cycles", "job.approve", "job.stream_ahead_s"),
        True,
        "when the job ends, and how it is streamed",
    ),
    ResumeRule(("job.id",), False, "another id is another job"),
    ResumeRule(
        ("part.*",), False, "masks and heights are of this part, and its place says what the robot's compliance does"
    ),
    ResumeRule(
        ("program.*",), False, "executed times belong to this program's points, and to where they lie on the part"
    ),
    ResumeRule(("tools.*.change_s", "tools.*.position_mm"), True, "what a change takes, and how a tool is proved"),
    ResumeRule(("tools.*",), False, "what was learned is of these tools, and passes were theirs in this order"),
    ResumeRule(("estimates.use_previous",), True, "how the next job begins"),
    ResumeRule(("estimates.tool",), False, "what was learned is of this tool"),
    ResumeRule(
        ("process.*", "compliance.*", "kinematics.*"), False, "the rate learned is relative to what these predict"
    ),
    ResumeRule(("machine.*",), False, "the time that a block takes by itself is learned beside these"),
    ResumeRule(
        ("instrument.*",), False, "maps are read alike before and after a pass, or their difference is no removal"
    ),
    ResumeRule(
        ("job.tolerance_period_mm", "job.lsf_period_mm"), False, "figures of all measurements count the same periods"
    ),
)
"""The first rule that fits a key holds for it; one that none fits may not change."""


def may_change(key: str) -> bool:
    """Whether a dotted key may have another value when a job goes on."""
    return next((rule.may_change for rule in RULES if any(fnmatchcase(key, one) for one in rule.keys)), False)


def terms_of(config: CellConfig, program_sha256: str) -> dict[str, Any]:
    """All values in force by dotted key, JSON-ready; a file as ``{"file", "sha256"}``, the program's as it was read."""
    terms = dict(_flat(config.effective())) | file_terms(config, (*FILES, *tool_files(config.tools)))
    terms["program.path"]["sha256"] = program_sha256
    return terms


def file_terms(config: CellConfig, keys: Iterable[str]) -> dict[str, Any]:
    """Of those keys, the files that they name: ``{"file", "sha256"}`` each, by key. ConfigError where one is gone."""
    values = dict(_flat(config.effective()))
    named = {key: values[key] for key in keys if values.get(key)}
    return {
        key: [_file(config, one) for one in name] if isinstance(name, list) else _file(config, name)
        for key, name in named.items()
    }


def require_same(config: CellConfig, terms: Mapping[str, Any], journal: Journal) -> None:
    """ConfigError where the journal's job was begun with other terms, with each that differs and what to do."""
    begun = journal.terms
    name = config.job.id
    if begun is None:
        path = config.state_dir / JOURNAL_NAME
        raise config.error(
            "job.id",
            f"the job {name!r} was begun by an earlier polishd, which did not write down what a later run needs: put "
            f"{old_copy(path, 1)} back as {path.name} and finish it with that polishd, or give job.id a new name",
        )
    changed = [key for key in sorted({*begun, *terms}) if not may_change(key)]
    lines = [
        str(config.error(key, f"is {_shown(terms.get(key))}, the job {name!r} was begun with {_shown(begun.get(key))}"))
        for key in changed
        if _content(begun.get(key)) != _content(terms.get(key))
    ]
    if lines:
        todo = "the job is under way and cannot go on like this: restore what differs, or give job.id a new name"
        raise ConfigError("\n".join([*lines, todo]))


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _file(config: CellConfig, name: str) -> dict[str, str]:
    path: Path = config.resolve(name)
    try:
        return {"file": name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; name a file") from error


def _content(value: Any) -> Any:
    """What counts of a value: of a file its content."""
    if isinstance(value, Mapping):
        return value["sha256"]
    return [_content(item) for item in value] if isinstance(value, list) else value


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{value['file']} (sha256 {value['sha256'][:12]})"
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    return "nothing" if value is None else repr(value)
