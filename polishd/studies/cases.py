"""A case of a study: its swept values, the inputs that decide it, and the versions that computed it."""

from __future__ import annotations

import functools
import hashlib
import json
import platform
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
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
"""Packages whose version may change the last bits of a result."""


@dataclass(frozen=True, slots=True)
class Case:
    """One case. It is small: it contains nothing that a worker can compute from it."""

    number: int
    """In the study's order, from 0."""
    point: int
    """Number of the point of the sweep, from 0: cases of one point differ in scenario, loop and seed only."""
    at: Mapping[str, Any]
    """Swept values by dotted key of the study."""
    scenario: str | None
    loop: str | None
    seed: int | None
    of: str
    """Hash of all inputs, files and versions too: equal hashes give figures equal to the last bit."""


@functools.cache
def versions() -> Mapping[str, str]:
    """Versions that must agree between the computer that made a case and the one that computes it."""
    return {
        "polishd": __version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: _installed(name) for name in LIBRARIES},
    }


def _installed(name: str) -> str:
    """Return the version of a library; empty where it is not installed: numba is of an extra."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def made_of(*parts: tuple[Mapping[str, Any], Path]) -> str:
    """Hash parts of a study, the files that they name relative to their folders, and the versions."""
    digest = hashlib.sha256(json.dumps(versions()).encode())
    for part, folder in parts:
        digest.update(json.dumps(part, sort_keys=True, default=str).encode())
        for name in _texts(part):
            path = folder / name
            if len(name) < 256 and path.is_file():
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


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
"""Differences between loops of a study and a cell: iterations end a solve, not the clock, since a busy machine would
give other figures; and there is no cross-check unless a loop sets one.
"""

OF_PEOPLE = {"web", "opcua", "shop", "notify", "certificate"}
"""Sections of a cell's file about observers and notifications: no figure depends on them."""


class CaseFactory:
    """Makes the cases of one study: files are read once, and cells' configurations are kept."""

    def __init__(self, swept: SweepStudy) -> None:
        self.swept = swept
        self._kept: dict[str, Any] = {}

    def of(self, study: Study, scenario: str | None, loop: str | None, seed: int | None) -> str:
        """Return the hash of all inputs of a case. ConfigError where the loop's cell or the plant is invalid."""
        if not isinstance(study, LoopStudy) or scenario is None or loop is None:
            return made_of((study.model_dump(mode="json", exclude={"title"}), study.base_dir))
        cell, sim = study.resolve(study.cell), study.resolve(study.plant)
        keys, witness, poses, learns = study.loop(loop)
        belief = self._once(
            f"belief {loop} {_key_text(keys)}",
            lambda: made_of((self.config(study, loop).model_dump(mode="json", exclude=OF_PEOPLE), cell.parent)),
        )
        plant = self._once(
            f"plant {scenario} {_key_text(study.plant_with)}",
            lambda: made_of((self.plant(study, scenario), sim.parent)),
        )
        own = {"passes": study.passes, "raster": study.raster, "witness": witness, "poses": poses, "learns": learns}
        named = {"scenario": scenario, "loop": loop, "seed": seed, "belief": belief, "plant": plant}
        return made_of((own, cell.parent), (named, cell.parent))

    def config(self, study: LoopStudy, loop: str) -> CellConfig:
        """Return the cell's configuration for that loop. ConfigError at the loop's or the sweep's key."""
        keys = study.loop(loop)[0]
        try:
            return load_config(study.file_of("cell"), {**UNHURRIED, **keys})
        except ConfigError as error:
            raise _of_loop(error, study, loop) from error

    def plant(self, study: LoopStudy, scenario: str) -> dict[str, Any]:
        """Return SIM.toml's sections, overlaid by the study's and the scenario's. ConfigError."""
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
        """ConfigError at the scenario's, the study's or the sweep's key, where the plant is invalid."""
        path, wrong = study.file_of("plant"), self.scenarios(study)[scenario]
        _, source = self._once(f"sim {path}", lambda: load_plant(path))
        stands: list[tuple[Location, Location]]
        stands = [((a, b), ("plant", a, b)) for a, keys in wrong.plant.items() for b in keys]
        swept = dict(study.source.written_at)
        for a, keys in study.plant_with.items():
            stands += [((a, b), swept.get(("plant_with", a, b), ("plant_with", a, b))) for b in keys]
        included = (*source.included, study.source, wrong.source)
        places = replace(source, included=included, written_at=(*stands, *source.written_at))
        try:
            SimConfig.model_validate(self.plant(study, scenario))
        except ValidationError as error:
            raise ConfigError("\n".join(validation_problems(error, SimConfig, places))) from error

    def _once(self, key: str, make: Callable[[], Any]) -> Any:
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]


def laid_over(plant: Mapping[str, Any], scenario: Scenario) -> dict[str, Any]:
    """Overlay SIM.toml's sections with a scenario's; drop those that a plant without links does not use."""
    whole = deepcopy(dict(plant))
    whole.pop("fault", None)
    overlay(whole, {name: dict(keys) for name, keys in scenario.plant.items()})
    return whole


def cases_of(swept: SweepStudy) -> list[Case]:
    """Return all cases in order: points, of a point seeds, of a seed scenarios, of these loops.

    Cases that are compared are neighbors, with the same draws. ConfigError with one line for each invalid one.
    """
    making, cases = CaseFactory(swept), list[Case]()
    require_all(swept, lambda number, point: cases.extend(_at(making, swept.at(point), number, point, len(cases))))
    return cases


def _at(making: CaseFactory, study: Study, number: int, point: Point, first: int) -> Iterator[Case]:
    """Return the cases of one point."""
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
    """Return a cell loader's message about a loop's key, with the location of that key in the study."""
    lines = []
    for line in str(error).splitlines():
        _, found, rest = line.partition(" (override): ")
        key, _, problem = rest.partition(": ")
        root = ("controllers", loop) if key in study.controllers[loop] else ("cell_with",)
        own = found and (key in study.controllers[loop] or key in study.cell_with)
        lines.append(study.source.error((*root, key), problem) if own else line)
    return ConfigError("\n".join(lines))


def _key_text(value: Any) -> str:
    return json.dumps(value, sort_keys=True, default=str)
