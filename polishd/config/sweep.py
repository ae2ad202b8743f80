"""``[sweep]`` of a study's file: keys with many values, and their combination."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from polishd.config.fields import ConfigSection, Pair, Range, Text, as_tuple
from polishd.config.study import Study, study_of
from polishd.config.toml_loader import Location, TomlSource, load_toml, validation_problems
from polishd.model.errors import ConfigError
from polishd.model.surface import FloatArray
from polishd.util.serialization import toml

How = Literal["crossed", "zipped", "drawn", "latin"]
EVEN = ("linear", "log")
SPREAD = ("uniform", "log_uniform", "normal", "lognormal")
"""Axes that are distributions: they need draws."""


class AxisSection(ConfigSection):
    """The values of one key: a list, or a table with one of these keys."""

    values: Annotated[tuple[Any, ...], BeforeValidator(as_tuple)] | None = None
    """These values; a list alone is the same."""
    linear: Range | None = None
    """`count` values from the first to the last at equal distances. [that of the key]"""
    log: Range | None = None
    """`count` values from the first to the last in equal ratios. [that of the key]"""
    count: Annotated[int, Field(ge=2, le=1_000_000)] | None = None
    """Number of values of `linear` and `log`. [1]"""
    uniform: Range | None = None
    """Uniform distribution between the two. [that of the key]"""
    log_uniform: Range | None = None
    """Uniform distribution of the logarithm between the two. [that of the key]"""
    normal: Pair | None = None
    """Normal distribution: mean, standard deviation. [that of the key]"""
    lognormal: Pair | None = None
    """Lognormal distribution: median, standard deviation of the natural logarithm. [that of the key]"""
    files: Text | None = None
    """All files of this pattern from the study's folder, by name: `"maps/*.dat"`."""
    numbers_from: Annotated[int, Field(ge=0)] | None = None
    """Integers from this one on, one for each draw: seeds. [1]"""
    pair: bool = False
    """The key needs a range, and gets `[value, value]`: the plant draws from ranges."""

    @property
    def kind(self) -> str:
        """Key that defines the values."""
        return next(name for name in _KINDS if getattr(self, name) is not None)

    @model_validator(mode="before")
    @classmethod
    def _of_list(cls, value: Any) -> Any:
        if isinstance(value, list):
            return {"values": value}
        if not isinstance(value, dict):
            raise ValueError(
                f"must have several values, not {value!r}; give a list, or {{ linear = [a, b], count = n }}"
            )
        return value

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        given = [name for name in _KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"has {' and '.join(given) or 'no values'}; give one of {', '.join(_KINDS)}")
        if self.values == ():
            raise ValueError("is empty; give at least one value")
        if (self.count is not None) != (self.kind in EVEN):
            raise ValueError("linear and log need count, and no other kind has it; add or remove it")
        for name in ("log", "log_uniform"):
            if (ends := getattr(self, name)) is not None and ends[0] <= 0:
                raise ValueError(f"{name} starts at {ends[0]:g}; it must be above 0")
        for name in ("normal", "lognormal"):
            if (shape := getattr(self, name)) is not None and shape[1] <= 0:
                raise ValueError(f"the standard deviation of {name} is {shape[1]:g}; it must be above 0")
        if self.lognormal is not None and self.lognormal[0] <= 0:
            raise ValueError(f"the median of lognormal is {self.lognormal[0]:g}; it must be above 0")
        return self


_KINDS = ("values", *EVEN, *SPREAD, "files", "numbers_from")


class GroupSection(ConfigSection):
    """Keys whose values are combined in one way. Groups are crossed with each other."""

    how: How = "crossed"
    """Combination: each value with each of the others (`crossed`), pairwise in order (`zipped`), independent draws
    (`drawn`), or draws that cover each key's range evenly (`latin`, a Latin hypercube)."""
    draws: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """Number of draws of `drawn` and `latin`. [1]"""
    over: Annotated[dict[str, AxisSection], Field(min_length=1)]
    """Values by dotted key of the study, such as `"process.force_n"`; in a study of loops also
    `"cell_with.process.force_n"`, `"plant_with.hidden_truth.rate"` and `"controllers.NAME.process.correction"`."""

    @model_validator(mode="after")
    def _draws_where_drawn(self) -> Self:
        drawn = self.how in {"drawn", "latin"}
        if drawn and self.draws is None:
            raise ValueError(f'draws: is missing; add the number of points of how = "{self.how}"')
        if not drawn and self.draws is not None:
            raise ValueError('draws: needs how = "drawn" or "latin"; remove it')
        return self


class SweepSection(ConfigSection):
    """Many cases of one study."""

    seed: Annotated[int, Field(ge=0)] = 1
    """Seed of all draws. The same seed gives the same cases. [1]"""
    group: Annotated[tuple[GroupSection, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    """Groups of keys, each a table `[[sweep.group]]`."""


# The points of a sweep: each combination of values, and its study.

MOST_POINTS = 100_000
MOST_PROBLEMS = 10
"""Largest number of reported problems; the others are likely similar."""
FIXED = ("kind", "title", "sweep", "seeds", "scenarios", "controllers")
"""Keys that are the same for all cases."""
Point = Mapping[str, Any]
"""Values by dotted key of the study."""


@dataclass(frozen=True, slots=True)
class SweepStudy:
    """A study's file and its points."""

    path: Path
    raw: Mapping[str, Any]
    """All but ``[sweep]``."""
    source: TomlSource
    points: tuple[Point, ...]
    """A single point without keys if there is no sweep."""
    is_sweep: bool

    def at(self, point: Point) -> Study:
        """Return the study at these values; raise ConfigError at the key of the sweep that they come from."""
        raw = deepcopy(dict(self.raw))
        for key, value in point.items():
            put(raw, key, value)
        return study_of(raw, self.source)


def read_swept(path: Path) -> SweepStudy:
    """Read a study's file without its points, for workers that receive them; raise ConfigError."""
    raw, source = load_toml(path)
    swept = raw.pop("sweep", None) is not None
    return SweepStudy(path.absolute(), raw, source, (), is_sweep=swept)


def load_swept(path: Path) -> SweepStudy:
    """Read a study's file with its ``[sweep]``, if any, and check each of its points.

    Raises ConfigError, one line per problem: ``FILE:LINE: key: what is wrong; what to do``.
    """
    raw, source = load_toml(path)
    section = raw.pop("sweep", None)
    if section is None:
        study_of(raw, source)
        return SweepStudy(path.absolute(), raw, source, ({},), is_sweep=False)
    try:
        sweep = SweepSection.model_validate(section)
    except ValidationError as error:
        raise ConfigError("\n".join(validation_problems(error, SweepSection, source, ("sweep",)))) from error
    places = _places(sweep, raw, source)
    points = tuple(_points(sweep, _Values(source, places, _folders(path, raw))))
    stands = (*((location_of(key), place) for key, place in places.items()), *_made(places, raw))
    swept = SweepStudy(path.absolute(), raw, replace(source, written_at=stands), points, is_sweep=True)
    require_all(swept, lambda _, point: swept.at(point))
    return swept


def require_all(swept: SweepStudy, make: Callable[[int, Point], object]) -> None:
    """Try each point; raise ConfigError with one line per problem, at a key of the sweep or with its point."""
    problems: dict[str, str] = {}
    for number, point in enumerate(swept.points):
        try:
            make(number, point)
        except ConfigError as error:
            at = ", ".join(f"{key} = {toml(value)}" for key, value in point.items())
            for line in str(error).splitlines():
                problems.setdefault(line, f"{line} (with {at})" if at and ": sweep." not in line else line)
        if len(problems) >= MOST_PROBLEMS:
            break
    if problems:
        raise ConfigError("\n".join(list(problems.values())[:MOST_PROBLEMS]))


def location_of(key: str) -> Location:
    """Return the location of a dotted key in a study's file: keys of ``[cell_with]`` and of a loop contain dots."""
    root, *rest = key.split(".")
    if root == "cell_with" and rest:
        return (root, ".".join(rest))
    if root == "controllers" and len(rest) > 1:
        return (root, rest[0], ".".join(rest[1:]))
    return (root, *rest)


def put(raw: dict[str, Any], key: str, value: Any) -> None:
    """Set a dotted key of a study's tables, and make missing tables."""
    *tables, last = location_of(key)
    inner: Any = raw
    for name in tables:
        inner = inner.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(f"{key}: {name!r} is not a section; correct the sweep's key")
    inner[last] = value


def _places(sweep: SweepSection, raw: Mapping[str, Any], source: TomlSource) -> dict[str, Location]:
    """Return the location of each swept key; raise ConfigError for one that is repeated or cannot be swept."""
    places: dict[str, Location] = {}
    loops = list(raw.get("controllers", ())) if isinstance(raw.get("controllers", {}), Mapping) else []
    for number, group in enumerate(sweep.group):
        for key in group.over:
            place = ("sweep", "group", number, "over", key)
            if key in places:
                raise ConfigError(source.error(place, "is swept by another group, too; keep one of both"))
            if key in FIXED or not all(key.split(".")):
                raise ConfigError(source.error(place, "is the same for all cases; sweep a key below it, or another"))
            if key.startswith("controllers.") and (name := key.split(".")[1]) not in loops:
                problem = f"the study has no loop {name!r}, only {', '.join(loops) or 'none'}; correct the name"
                raise ConfigError(source.error(place, problem))
            places[key] = place
    return places


def _made(places: Mapping[str, Location], raw: Mapping[str, Any]) -> Iterator[tuple[Location, Location]]:
    """Yield sections that exist only for a swept key, with the location of that key."""
    for key, place in places.items():
        *tables, _ = location_of(key)
        inner: Any = raw
        for depth, name in enumerate(tables, 1):
            inner = inner.get(name) if isinstance(inner, Mapping) else None
            if inner is None:
                yield tuple(tables[:depth]), place


@dataclass(frozen=True, slots=True)
class _Values:
    """The values of keys, and the location of each key."""

    source: TomlSource
    places: Mapping[str, Location]
    folders: Mapping[str, Path]
    """Base folder of relative paths, by the root of a key; "": the study's."""

    def error(self, key: str, problem: str) -> ConfigError:
        return ConfigError(self.source.error(self.places[key], problem))

    def listed(self, key: str, axis: AxisSection) -> list[Any]:
        """Return values that need no draw; raise ConfigError."""
        if axis.values is not None:
            return list(axis.values)
        if axis.files is not None:
            here = self.folders[""]
            found = sorted(path for path in here.glob(axis.files) if path.is_file())
            if not found:
                raise self.error(key, f"{axis.files}: no file fits; correct the pattern")
            base = self.folders.get(key.split(".", maxsplit=1)[0], here)
            return [Path(os.path.relpath(path, base)).as_posix() for path in found]
        count = axis.count or 0
        even = np.linspace(*axis.linear, count) if axis.linear else np.geomspace(*(axis.log or (1.0, 1.0)), count)
        return [float(value) for value in even]

    def of_group(self, group: GroupSection, rng: np.random.Generator) -> list[Point]:
        """Return the points of one group; raise ConfigError."""
        if group.draws is not None:
            return self.drawn(group, group.draws, rng)
        for key, axis in group.over.items():
            if axis.kind in {*SPREAD, "numbers_from"}:
                raise self.error(key, f'{axis.kind} needs draws; set how = "drawn" or "latin", and draws')
        columns = {key: self.listed(key, axis) for key, axis in group.over.items()}
        if group.how == "crossed":
            return [dict(zip(columns, values, strict=True)) for values in itertools.product(*columns.values())]
        first = len(next(iter(columns.values())))
        for key, values in columns.items():
            if len(values) != first:
                problem = f"has {len(values)} values, and the first zipped key has {first}; give each the same number"
                raise self.error(key, problem)
        return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]

    def drawn(self, group: GroupSection, draws: int, rng: np.random.Generator) -> list[Point]:
        """Draw all keys, from (draws, keys) uniform numbers in [0, 1)."""
        even = rng.random((draws, len(group.over)))
        if group.how == "latin":
            from scipy.stats import qmc

            even = qmc.LatinHypercube(len(group.over), rng=rng).random(draws)
        columns: dict[str, Sequence[Any]] = {}
        for (key, axis), u in zip(group.over.items(), even.T, strict=True):
            if axis.numbers_from is not None:
                columns[key] = range(axis.numbers_from, axis.numbers_from + draws)
            elif axis.kind in SPREAD:
                columns[key] = _spread(axis, u).tolist()
            else:
                values = self.listed(key, axis)
                columns[key] = [values[int(share * len(values))] for share in u]
        return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def _points(sweep: SweepSection, values: _Values) -> Iterator[Point]:
    groups = [values.of_group(group, np.random.default_rng([sweep.seed, k])) for k, group in enumerate(sweep.group)]
    count = math.prod(len(group) for group in groups)
    if count > MOST_POINTS:
        problem = f"has {count} points; at most {MOST_POINTS} are allowed: use fewer values"
        raise ConfigError(values.source.error(("sweep",), problem))
    twice = {key for group in sweep.group for key, axis in group.over.items() if axis.pair}
    for chosen in itertools.product(*groups):
        yield {key: [value, value] if key in twice else value for part in chosen for key, value in part.items()}


def _folders(path: Path, raw: Mapping[str, Any]) -> dict[str, Path]:
    here = path.absolute().parent
    cell, plant = (here / str(raw.get(name, "")) for name in ("cell", "plant"))
    return {"": here, "cell_with": cell.parent, "controllers": cell.parent, "plant_with": plant.parent}


def _spread(axis: AxisSection, even: FloatArray) -> FloatArray:
    """Return (n,) values of a distribution from (n,) uniform numbers, by the inverse of its cumulative function."""
    from scipy.special import ndtri

    if axis.uniform is not None:
        low, high = axis.uniform
        return np.asarray(low + (high - low) * even)
    if axis.log_uniform is not None:
        low, high = np.log(axis.log_uniform)
        return np.asarray(np.exp(low + (high - low) * even))
    middle, sigma = axis.normal or axis.lognormal or (0.0, 1.0)
    away = sigma * ndtri(np.clip(even, np.finfo(float).tiny, None))
    return np.asarray(middle + away if axis.normal is not None else middle * np.exp(away))
