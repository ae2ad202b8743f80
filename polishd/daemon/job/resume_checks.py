"""Check the config against the terms of the unfinished job, at a restart of the daemon.

A restarted daemon continues its job. Masks, heights, executed times and estimates depend on the values of the config
with which the job began, and are wrong with other values.
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
from polishd.hookspecs import DataFileFormat, ProgramFormat
from polishd.model.errors import ConfigError


@dataclass(frozen=True, slots=True)
class ResumeRule:
    """Dotted keys (``part.*``: a whole section), whether they may change within a job, and the reason."""

    keys: tuple[str, ...]
    may_change: bool
    why: str


RULES = (
    ResumeRule(("include",), True, "a way to write the same values"),
    ResumeRule(("cell.*",), True, "names and folders; the job keeps the run folder in which it began"),
    ResumeRule(("plugins.*",), True, "other keys name the use of a plugin in the job"),
    ResumeRule(
        ("robot.*", "actuator.*", "spindle.*", "metrology.*", "loader*", "force_sensor*", "monitor*", "signals*"),
        True,
        "addresses of devices, their time limits, and the monitored signals",
    ),
    ResumeRule(
        ("notify.*", "web.*", "certificate.*", "shop*", "opcua*"),
        True,
        "notifications, access, certificates and the origin of the part",
    ),
    ResumeRule(("roles.*",), False, "the estimates belong to this robot and tool"),
    ResumeRule(("dwell.*",), True, "choice of the next dwell; each dwell has its certificate"),
    ResumeRule(("ripple.*",), True, "forecasts of the next passes"),
    ResumeRule(("touch_off*", "part_handling.*"), True, "part handling removes nothing"),
    ResumeRule((*LIMITS_OF_PROCESS, "tools.*.force_max_n"), True, "limits that end contact from now on"),
    ResumeRule(("limits.*", "machine.x_mm", "machine.y_mm", "machine.z_mm"), True, "limits for the next plans"),
    ResumeRule(
        ("job.tolerance_nm", "tolerance", "job.accept_by", "job.max_cycles", "job.approve", "job.stream_ahead_s"),
        True,
        "end of the job, and streaming",
    ),
    ResumeRule(("job.id",), False, "another id is another job"),
    ResumeRule(
        ("part.*",), False, "masks and heights belong to this part, and the robot's compliance depends on its position"
    ),
    ResumeRule(
        ("program.*",), False, "executed times belong to the points of this program, at their positions on the part"
    ),
    ResumeRule(("tools.*.change_s", "tools.*.position_mm"), True, "time of a tool change, and its touch-off"),
    ResumeRule(("tools.*",), False, "estimates and passes belong to these tools in this order"),
    ResumeRule(("estimates.use_previous",), True, "initial estimates of the next job"),
    ResumeRule(("estimates.tool",), False, "the estimates belong to this tool"),
    ResumeRule(("process.*", "compliance.*", "kinematics.*"), False, "the estimated rate is relative to these models"),
    ResumeRule(("machine.*",), False, "the estimated overhead of a block depends on these"),
    ResumeRule(
        ("instrument.*",), False, "the removal is the difference of maps, which must be read with the same settings"
    ),
    ResumeRule(("job.tolerance_period_mm", "job.lsf_period_mm"), False, "all figures of a job count the same periods"),
)
"""The first rule that matches a key applies. A key without a rule may not change."""


def may_change(key: str) -> bool:
    """Return whether a dotted key may have another value when the daemon continues a job."""
    return next((rule.may_change for rule in RULES if any(fnmatchcase(key, one) for one in rule.keys)), False)


def terms_of(config: CellConfig, formats: Mapping[str, ProgramFormat], *program_sha256: str) -> dict[str, Any]:
    """Return all effective values by dotted key, JSON-ready.

    ``formats``: of the job's plugins, by name.
    A file is ``{"file", "sha256"}``; the hashes of the (first tool's) programs are those of the texts that were read.
    """
    terms = dict(_flat(config.effective())) | file_terms(config, formats, (*FILES, *tool_files(config.tools)))
    if config.turns[0].program.paths == config.program.paths:  # those of the first tool; a later one may have others
        named = terms["program.path"]
        for file, sha256 in zip(named if isinstance(named, list) else [named], program_sha256, strict=True):
            file["sha256"] = sha256
    return terms


def file_terms(config: CellConfig, formats: Mapping[str, ProgramFormat], keys: Iterable[str]) -> dict[str, Any]:
    """Return ``{"file", "sha256"}`` by key, for those keys that name a file. ConfigError where a file is missing.

    The hash of a program covers the file beside it that declares its positions (a .dat, a .dtx).
    """
    used = formats.get(config.program.format)
    programs = {"program.path", *(f"tools.{name}.program" for name in config.tools)}
    values = dict(_flat(config.effective()))
    named = {key: values[key] for key in keys if values.get(key)}
    return {
        key: [_file(config, key, one, data) for one in name]
        if isinstance(name, list)
        else _file(config, key, name, data)
        for key, name in named.items()
        for data in [used.data_file if used is not None and key in programs else None]
    }


def require_same(config: CellConfig, terms: Mapping[str, Any], journal: Journal) -> None:
    """ConfigError where the terms of the journal's job differ; it names each difference and the remedy."""
    begun = journal.terms
    name = config.job.id
    if begun is None:
        path = config.state_dir / JOURNAL_NAME
        raise config.error(
            "job.id",
            f"an earlier polishd began the job {name!r}, and did not record the values that this version needs. "
            f"Restore {old_copy(path, 1)} as {path.name} and finish the job with that polishd, or set a new job.id",
        )
    changed = [key for key in sorted({*begun, *terms}) if not may_change(key)]
    lines = [
        str(config.error(key, f"is {_shown(terms.get(key))}, the job {name!r} began with {_shown(begun.get(key))}"))
        for key in changed
        if _content(begun.get(key)) != _content(terms.get(key))
    ]
    if lines:
        todo = "the job has begun and cannot continue with these values. Restore them, or set a new job.id"
        raise ConfigError("\n".join([*lines, todo]))


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _file(config: CellConfig, key: str, name: str, data: DataFileFormat | None) -> dict[str, str]:
    path: Path = config.resolve(name)
    try:
        content = path.read_bytes() + (data.find(path) if data else b"")
        return {"file": name, "sha256": hashlib.sha256(content).hexdigest()}
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}. Set {key} to a file that exists") from error


def _content(value: Any) -> Any:
    """Return the part of a value that is compared: the hash of a file's content."""
    if isinstance(value, Mapping):
        return value["sha256"]
    return [_content(item) for item in value] if isinstance(value, list) else value


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{value['file']} (sha256 {value['sha256'][:12]})"
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    return "nothing" if value is None else repr(value)
