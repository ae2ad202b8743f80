"""A case of a study: what is swept there, what decides it, and on which versions it was computed."""

from __future__ import annotations

import functools
import hashlib
import json
import platform
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from polishd import __version__
from polishd.config.cell import CellConfig, load_config, overlay
from polishd.config.simulator import SimConfig, load_plant
from polishd.config.study import LoopStudy, Scenario, Study
from polishd.config.sweep import Point, SweepStudy, require_all
from polishd.config.toml_loader import Location, validation_problems
from polishd.model.errors import ConfigError

LIBRARIES = ("numpy", "scipy", "numba")
"""Of which another version may give other last bits."""


@dataclass(frozen=True, slots=True)
class Case:
    """One of them. It is small: what a worker can compute of it is not in it."""

    number: int
    """In the study's order, from 0."""
    point: int
    """Of the sweep, from 0: cases of one point differ in scenario, loop and seed only."""
    at: Mapping[str, Any]
    """By dotted key of the study, what is swept."""
    scenario: str | None
    loop: str | None
    seed: int | None
    of: str
    """Hash of all that decides it, files and versions too: the same hash, the same figures to the last bit."""


@functools.cache
def versions() -> Mapping[str, str]:
    """What must be the same where a case is computed as where it was made."""
    return {
        "polishd": __version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: version(name) for name in LIBRARIES},
    }


def made_of(*parts: tuple[Mapping[str, Any], Path]) -> str:
    """Hash of parts of a study, the files that they name beside their folders, and the versions."""
    told = hashlib.sha256(json.dumps(versions()).encode())
    for part, folder in parts:
        told.update(json.dumps(part, sort_keys=True, default=str).encode())
        for name in _texts(part):
            path = folder / name
            if len(name) < 256 and path.is_file():
                told.update(hashlib.sha256(path.read_bytes()).digest())
    return told.hexdigest()[:16]


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _texts(one)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _texts(one)


# The cases of a study: every point of its sweep with each scenario, loop and seed, all of them checked.

UNHURRIED = {"dwell.cpu_limit_s": 3600.0, "dwell.cross_check": ""}
"""What loops of a study have otherwise than any cell: iterations end a solve, not the clock, or a busy machine would
give other figures; and no second opinion, unless a loop asks for one."""

OF_PEOPLE = {"web", "opcua", "shop", "notify", "certificate"}
"""Sections of a cell's file that say who watches it and who is told: no figure depends on them."""


class CaseFactory:
    """What cases of one study are made of: files are read once, cells' configurations kept."""

    def __init__(self, swept: SweepStudy) -> None:
        self.swept = swept
        self._kept: dict[str, Any] = {}

    def of(self, study: Study, scenario: str | None, loop: str | None, seed: int | None) -> str:
        """Hash of all that decides a case. ConfigError where the loop's cell or the plant cannot be."""
        if not isinstance(study, LoopStudy) or scenario is None or loop is None:
            return made_of((study.model_dump(mode="json", exclude={"title"}), study.base_dir))
        cell, sim = study.resolve(study.cell), study.resolve(study.plant)
        keys, witness, poses, learns = study.loop(loop)
        belief = self._once(
            f"belief {loop} {_said(keys)}",
            lambda: made_of((self.config(study, loop).model_dump(mode="json", exclude=OF_PEOPLE), cell.parent)),
        )
        plant = self._once(
            f"plant {scenario} {_said(study.plant_with)}", lambda: made_of((self.plant(study, scenario), sim.parent))
        )
        own = {"passes": study.passes, "raster": study.raster, "witness": witness, "poses": poses, "learns": learns}
        named = {"scenario": scenario, "loop": loop, "seed": seed, "belief": belief, "plant": plant}
        return made_of((own, cell.parent), (named, cell.parent))

    def config(self, study: LoopStudy, loop: str) -> CellConfig:
        """The cell's as that loop has it. ConfigError at the loop's or the sweep's key."""
        keys = study.loop(loop)[0]
        try:
            return load_config(study.file_of("cell"), {**UNHURRIED, **keys})
        except ConfigError as error:
            raise _of_loop(error, study, loop) from error

    def plant(self, study: LoopStudy, scenario: str) -> dict[str, Any]:
        """SIM.toml's sections, the study's laid over them, and the scenario's. ConfigError."""
        path = study.file_of("plant")
        sections, _ = self._once(f"sim {path}", lambda: load_plant(path))
        whole = deepcopy(dict(sections))
        overlay(whole, {name: dict(keys) for name, keys in study.plant_with.items()})
        return laid_over(whole, self.scenarios(study)[scenario])

    def scenarios(self, study: LoopStudy) -> Mapping[str, Scenario]:
        """By name, in order. ConfigError."""
        found: Mapping[str, Scenario] = self._once(f"scenarios {study.scenarios}", study.all_scenarios)
        return found

    def check_plant(self, study: LoopStudy, scenario: str) -> None:
        """ConfigError, with the place of the scenario's, the study's or the sweep's key, where no plant is so."""
        path, wrong = study.file_of("plant"), self.scenarios(study)[scenario]
        _, source = self._once(f"sim {path}", lambda: load_plant(path))
        stands: list[tuple[Location, Location]]
        stands = [((a, b), ("plant", a, b)) for a, keys in wrong.plant.items() for b in keys]
        swept = dict(study.source.stands_for)
        for a, keys in study.plant_with.items():
            stands += [((a, b), swept.get(("plant_with", a, b), ("plant_with", a, b))) for b in keys]
        included = (*source.included, study.source, wrong.source)
        places = replace(source, included=included, stands_for=(*stands, *source.stands_for))
        try:
            SimConfig.model_validate(self.plant(study, scenario))
        except ValidationError as error:
            raise ConfigError("\n".join(validation_problems(error, SimConfig, places))) from error

    def _once(self, key: str, make: Callable[[], Any]) -> Any:
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]


def laid_over(plant: Mapping[str, Any], scenario: Scenario) -> dict[str, Any]:
    """SIM.toml's sections with a scenario's laid over them; what a plant without wires has no use for is left out."""
    whole = deepcopy(dict(plant))
    whole.pop("fault", None)
    overlay(whole, {name: dict(keys) for name, keys in scenario.plant.items()})
    return whole


def cases_of(swept: SweepStudy) -> list[Case]:
    """All of them in order: points, of a point seeds, of a seed scenarios, of these loops.

    So whatever is compared stands side by side, on the same draws. ConfigError for all that cannot be, a line each.
    """
    making, cases = CaseFactory(swept), list[Case]()
    require_all(swept, lambda number, point: cases.extend(_at(making, swept.at(point), number, point, len(cases))))
    return cases


def _at(making: CaseFactory, study: Study, number: int, point: Point, first: int) -> Iterator[Case]:
    """Those of one point."""
    if not isinstance(study, LoopStudy):
        yield Case(first, number, point, None, None, None, making.of(study, None, None, None))
        return
    scenarios = making.scenarios(study)
    for scenario in scenarios:
        making.check_plant(study, scenario)
    for seed in range(study.first_seed, study.first_seed + study.seeds):
        for scenario in scenarios:
            for loop in study.controllers:
                yield Case(first, number, point, scenario, loop, seed, making.of(study, scenario, loop, seed))
                first += 1


def _of_loop(error: ConfigError, study: LoopStudy, loop: str) -> ConfigError:
    """What a cell's loader says of a key that is a loop's own, with the place of that key in the study."""
    lines = []
    for line in str(error).splitlines():
        _, found, rest = line.partition(" (override): ")
        key, _, problem = rest.partition(": ")
        root = ("controllers", loop) if key in study.controllers[loop] else ("cell_with",)
        own = found and (key in study.controllers[loop] or key in study.cell_with)
        lines.append(study.source.error((*root, key), problem) if own else line)
    return ConfigError("\n".join(lines))


def _said(value: Any) -> str:
    return json.dumps(value, sort_keys=True, default=str)
