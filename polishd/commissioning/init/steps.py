"""Steps to set up a cell, in order, by the files on disk: profiles, fragments, plans, runs."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from polishd.commissioning.init.draft import ASSUMED_MARK
from polishd.config.cell import CellConfig, load_config
from polishd.config.instrument_profile import load_profile
from polishd.model.errors import ConfigError, PolishdError
from polishd.model.states import EXIT_CODES
from polishd.plugin_loader import load_cell
from polishd.rendering.terminal import emit, stderr
from polishd.util.files import toml_text

CHECK = "check"
PLANNED = "planned"
MAP = "MAP"
NO_SPOT = "removal is computed, not measured: polish a spot on a witness part, and measure it before and after"
FAILED = "failed"
"""Outcome of a run that ended with an error, which does not show that the devices work."""


@dataclass(frozen=True, slots=True)
class SetupStep:
    """One step to set up a cell."""

    what: str
    done: bool | None
    """None: the step leaves no file on disk."""
    found: str
    """Present or missing files."""
    command: str
    """Command of the step."""


def steps(cell: Path) -> list[SetupStep]:
    """Return all steps in order; only the first if the cell's file is missing or cannot be read."""
    if not cell.exists():
        found = f"{_quoted(cell)}: is missing"
        return [SetupStep("write the cell", False, found, f"polishd init {_quoted(cell.parent)}")]
    try:
        config = load_config(cell)
    except ConfigError as error:
        return [SetupStep("write the cell", False, str(error), f"$EDITOR {_quoted(cell)}")]
    return list(_steps(config, cell))


def lines(found: Sequence[SetupStep]) -> list[str]:
    """Return two unwrapped lines for each step, so that commands can be copied; one line if it is done."""
    marks = {True: "[x]", False: "[ ]", None: "[?]"}
    text = []
    for step in found:
        text.append(f"{marks[step.done]} {step.what}: {step.found}")
        text += [] if step.done else [f"    {step.command}"]
    return text


def _steps(config: CellConfig, file: Path) -> Iterator[SetupStep]:
    cell = _quoted(file)
    runs = _summaries(config.state_dir / "runs", *([config.run_dir] if config.run_dir else []))
    look = [at for at, line in enumerate(toml_text(config.path).split("\n"), 1) if line.startswith(ASSUMED_MARK)]
    lines = ", ".join(map(str, look))
    found = f"{len(look)} values, below the lines {lines}" if look else "nothing is marked as assumed"
    yield SetupStep("check the assumed values", not look, found, f"$EDITOR {cell}")
    missing = [name for name in config.program.paths if not config.resolve(name).is_file()]
    path = _quoted(file.parent / (missing or config.program.paths)[0])
    # a program after the first one runs between its lines
    phase = " --phase 0.5" if missing and missing[0] != config.program.paths[0] else ""
    command = f"polishd program make raster --out {path} --cell {cell}{phase}"
    have = ", ".join(_quoted(file.parent / name) for name in config.program.paths)
    yield SetupStep("have a program", not missing, f"{path}: is missing" if missing else have, command)
    yield SetupStep(CHECK, None, "leaves no file; repeat it after each change", f"polishd check {cell}")
    ran = any(of["outcome"] != FAILED for of in runs.values())
    answered = "a run used the devices" if ran else "leaves no file; probe the devices"
    yield SetupStep("probe", True if ran else None, answered, f"polishd probe {cell}")
    yield _commission(config, file.parent)
    yield from _calibrate(config, cell)
    plans = [at.parent for at, of in _summaries(*_beside(config)).items() if _is_plan(of, config.job.id)]
    out = _quoted(file.parent / "plan")
    planned = ", ".join(map(_quoted, plans)) or "no plan of this job is beside the cell's file"
    yield SetupStep("plan", bool(plans), planned, f"polishd plan {cell} {MAP} --out {out}")
    rehearsal = config.state_dir.parent / f"{config.path.stem}-rehearsal"
    rehearsed = _summaries(rehearsal / "run", rehearsal / "state" / "runs")
    outcome = _outcomes(rehearsed) or ("made, and not run" if rehearsal.is_dir() else "not made")
    again = f"polishd run {_quoted(rehearsal / f'{config.path.stem}-rehearsal.toml')}"
    simulate = f"polishd sim {_quoted(rehearsal / 'sim.toml')}" if rehearsal.is_dir() else f"polishd rehearse {cell}"
    yield SetupStep("rehearse", _succeeded(rehearsed), outcome, f"{simulate}, and in another terminal: {again}")
    yield SetupStep("run", _succeeded(runs), _outcomes(runs) or "no run has ended", f"polishd run {cell}")


def _commission(config: CellConfig, folder: Path) -> SetupStep:
    if config.profile_path is None or config.instrument.profile is None:
        return SetupStep("commission", False, "the cell names no instrument's profile", "docs/how-to/instruments.md")
    command = f"polishd map commission {_quoted(folder / config.instrument.profile)} {MAP}"
    try:
        profile = load_profile(config.profile_path)
    except PolishdError as error:
        return SetupStep("commission", False, str(error), command)
    found = profile.unproved or f"{profile.instrument.name}: proved"
    if profile.unproved and not profile.bumps:
        found = f"{config.instrument.profile}: describe the artefact's bumps, [artefact], and measure it"
    return SetupStep("commission", not profile.unproved, found, command)


def _calibrate(config: CellConfig, cell: str) -> Iterator[SetupStep]:
    """Removal and stiffness, each by its measurements."""
    spot = config.process.tif is not None or "process.preston" in config.included
    tif = config.process.tif or config.included.get("process.preston", "")
    command = f"polishd calibrate tif BEFORE AFTER --seconds S --cell {cell} --out tif.toml"
    yield SetupStep("calibrate tif", spot, tif if spot else NO_SPOT, command)
    stiff = {file for key, file in config.included.items() if key.startswith("kinematics.")}
    stiff |= {str(getattr(config.kinematics, "table", ""))} - {""}
    command = f"polishd calibrate stiffness TESTS.csv --cell {cell} --out stiffness.toml"
    yield SetupStep("calibrate stiffness", bool(stiff), ", ".join(sorted(stiff)) or "stiffness is assumed", command)


def _beside(config: CellConfig) -> list[Path]:
    return [path for path in config.base_dir.iterdir() if path.is_dir()]


def _is_plan(summary: Mapping[str, Any], job: str) -> bool:
    return summary["outcome"] == PLANNED and summary.get("job") == job


def _summaries(*folders: Path) -> dict[Path, Mapping[str, Any]]:
    """The summaries of run folders and of folders of them; one that is broken is none."""
    found: dict[Path, Mapping[str, Any]] = {}
    for path in (path for folder in folders for depth in ("", "*/") for path in folder.glob(f"{depth}summary.json")):
        try:
            summary = json.loads(path.read_bytes())
        except (OSError, ValueError):
            continue
        if isinstance(summary, dict) and isinstance(summary.get("outcome"), str):
            found[path] = summary
    return found


def _succeeded(found: Mapping[Path, Mapping[str, Any]]) -> bool:
    """Return whether the latest of these runs ended as it should, with exit code 0."""
    if not found:
        return False
    latest = found[max(found, key=lambda path: (path.stat().st_mtime_ns, path))]["outcome"]
    return latest in {outcome.value for outcome, code in EXIT_CODES.items() if code == 0}


def _outcomes(found: Mapping[Path, Mapping[str, Any]]) -> str:
    return ", ".join(f"{path.parent.name}: {found[path]['outcome']}" for path in sorted(found))


def _quoted(path: Path) -> str:
    return shlex.quote(str(path))


# ``polishd init --status``: steps to a cell's first pass. It opens no device and needs no daemon.


def setup_verb(cell: Path, *, as_json: bool) -> None:
    """Check the cell, and show each step with its files and its command."""
    with stderr.status("checking the cell"):
        found = [_checked(cell, step) if step.what == CHECK else step for step in steps(cell)]
    done = sum(step.done is True for step in found)
    answer = {"cell": str(cell), "done": done, "steps": [asdict(step) for step in found]}
    emit(answer, as_json=as_json, lines=[f"{cell}: {done} of {len(found)} steps are done", *lines(found)])


def _checked(cell: Path, step: SetupStep) -> SetupStep:
    """Return the check step with the result of `polishd check`."""
    from polishd.daemon.checks import check_cell

    try:
        facts = check_cell(*load_cell(cell))
    except PolishdError as error:
        return replace(step, done=False, found=str(error))
    return replace(step, done=True, found=f"passes: reach {facts['reach']}, gamma {facts['gamma']}")
