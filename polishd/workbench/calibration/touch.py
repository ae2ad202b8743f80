"""``polishd calibrate cell``: a first touch on a witness part, planned to teach the most in the least contact time."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from polishd.config.cell import CellConfig
from polishd.files import require_new, unwritable, write_atomic
from polishd.hooks.cell import load_cell
from polishd.model.errors import ComputeError, ConfigError
from polishd.process.identification.confounding import confounding_of
from polishd.process.identification.identify import in_the_middle
from polishd.process.identification.parameters import ABERRATIONS, usual_parameters
from polishd.process.identification.touch import FIELD_WANTED, WANTED
from polishd.recipe import foresight
from polishd.recipe.making import make_recipe
from polishd.recipe.recipe import Recipe
from polishd.show.tables import emit, record_table, stderr
from polishd.workbench.calibration.touch_plan import NAME, SPOTS, FirstTouchPlan, as_touched, plan_touch
from polishd.workbench.programs.pictures import program_picture

NOT_IN_MINUTES = {"wear": "a tool wears in hours: passes tell", "exponent": "it is not told from rate and compliance"}
JOB, FRAGMENT, PICTURE, FIGURES = "job.toml", "fragment.toml", "touch.png", "touch.json"
JOB_TEXT = """\
# A first touch, made by polishd calibrate cell: {use}.
[job]
id = "first-touch-{part}"
max_cycles = 1

[part]
id = "{part}"                        # what the maps of the witness part must name

[program]
path = "{program}"
covers = "zone"

[dwell]
choose = "as_programmed"
cross_check = ""
"""


@dataclass(frozen=True, slots=True)
class TouchOptions:
    """What is asked of it."""

    part: str
    within_min: float
    wanted: Mapping[str, float]


def touch_verb(cell: Path, out: Path, options: TouchOptions, *, as_json: bool) -> None:
    """Plan it, and write program, job, picture and figures into ``out``. ConfigError, ComputeError, ProgramError."""
    config, hooks = load_cell(cell)
    require_new(out)
    recipe = _recipe(config, make_recipe(config, hooks))
    wanted = _wanted(options.wanted)
    with stderr.status("choosing tracks"):
        touch = plan_touch(config, recipe, wanted, options.within_min * 60)
    if refused := foresight.precheck_plan(recipe, touch.program, hooks.check_plan):
        raise ComputeError("plan or run would refuse the touch:\n" + "\n".join(f"  {line}" for line in refused))
    rows = _rows(touch, wanted)
    complete = all(row["wanted"] is None or row["after"] <= row["wanted"] for row in rows)
    answer = {
        "part": options.part,
        "contact_min": touch.seconds / 60,
        "tracks": touch.tracks,
        "complete": complete,
        "parameters": rows,
        "out": str(out),
    }
    _write(config, out, touch, answer, options.part)
    emit(answer, as_json=as_json, table=lambda: _table(touch, rows), lines=_lines(config, out, complete=complete))


def _recipe(config: CellConfig, recipe: Recipe) -> Recipe:
    """As the touch is run; ConfigError where what it teaches cannot be learned."""
    if config.process.removal_model not in SPOTS:
        known = " or ".join(SPOTS)
        raise config.error("process.removal_model", f"a touch is planned for {known}; set one of them")
    if config.process.learns != "machine":
        raise config.error("process.learns", 'is not "machine": a touch would teach the rate alone; set it')
    return as_touched(recipe)


def _wanted(own: Mapping[str, float]) -> dict[str, float]:
    names = {p.name for p in usual_parameters() if p.name not in {*ABERRATIONS, *NOT_IN_MINUTES}}
    for name, sigma in own.items():
        if name in NOT_IN_MINUTES:
            raise ConfigError(f"--want {name}: no touch tells that: {NOT_IN_MINUTES[name]}; leave it out")
        if name not in names:
            raise ConfigError(f"--want {name}: no such parameter; there are {', '.join(sorted(names))}")
        if not sigma > 0:
            raise ConfigError(f"--want {name}={sigma:g}: must be above 0")
    return {**WANTED, **own}


def _rows(touch: FirstTouchPlan, wanted: Mapping[str, float]) -> list[dict[str, Any]]:
    parameters = touch.before.parameters
    prior, learned = (in_the_middle(known, touch.seconds / 7200) for known in (touch.before, touch.after))
    said = confounding_of(parameters, prior, learned)
    errors = zip(parameters, np.sqrt(np.diag(prior)), np.sqrt(np.diag(learned)), strict=True)
    return [
        {
            "name": p.name,
            "unit": p.unit,
            "before": float(before),
            "after": float(after),
            "wanted": wanted.get(p.name, FIELD_WANTED if p.name.startswith("field_") else None),
            "confounded_with": list(said[p.name].confounded_with),
        }
        for p, before, after in errors
        if p.name not in ABERRATIONS
    ]


def _table(touch: FirstTouchPlan, rows: Sequence[Mapping[str, Any]]) -> Table:
    title = f"first touch: {touch.tracks} tracks, {touch.seconds / 60:.1f} min in contact"
    cells = [
        (
            str(row["name"]),
            f"{row['before']:.2g}",
            f"{row['after']:.2g}",
            "" if row["wanted"] is None else f"{row['wanted']:.2g}",
            str(row["unit"]),
            ", ".join(row["confounded_with"]),
        )
        for row in rows
    ]
    columns = ("parameter", "error before", "expected after", "wanted", "unit", "not told from")
    return record_table(title, columns, cells)


def _lines(config: CellConfig, out: Path, *, complete: bool) -> list[str]:
    short = "not all that is wanted will be known: no more contact was worth its time, or allowed (--minutes)"
    place = "put a witness part of the same shape, glass and slurry in"
    queue = f"polishd job add {config.path} {out / JOB} in a cell with a queue"
    include = f'include = ["{config.relative(out / FRAGMENT)}"]'
    single = f"{include} in the first line of a copy of {config.path.name}, and polishd run of that"
    return [
        *([] if complete else [short]),
        f"written to {out}: {NAME}, {JOB}, {FRAGMENT}, {PICTURE}, {FIGURES}",
        f"next: {place}; {queue}, or {single}; what it teaches is remembered, and the next job begins with it",
    ]


def _write(config: CellConfig, out: Path, touch: FirstTouchPlan, answer: Mapping[str, Any], part: str) -> None:
    single = JOB_TEXT.format(use="a fragment that a cell includes", part=part, program=config.relative(out / NAME))
    made = {
        NAME: touch.text,
        JOB: JOB_TEXT.format(use="a job for polishd job add", part=part, program=NAME).encode(),
        FRAGMENT: single.encode(),
        PICTURE: program_picture(touch.program),
        FIGURES: (json.dumps(answer, indent=1) + "\n").encode(),
    }
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, content in made.items():
            write_atomic(out / name, content)
    except OSError as error:
        raise unwritable(out, error) from error
