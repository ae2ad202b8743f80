"""A study of whole jobs against simulated plants, and the files of what may be wrong with one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from polishd.config.document import TomlDocument, load_toml
from polishd.config.values import Name, Text, Texts

Taken = Literal["rate", "spot", "touch"]
"""What a loop takes over from a witness part: a spot's volume rate alone, or its shape with it, or all that a first
touch teaches (`polishd calibrate cell`)."""
Poses = tuple[tuple[float, float, float], ...]
"""(angle_deg, x_mm, y_mm) of the part in maps: counter-clockwise as displayed, then further right and up."""
_POSES: TypeAdapter[list[tuple[float] | tuple[float, float, float]]] = TypeAdapter(
    list[tuple[float] | tuple[float, float, float]], config=ConfigDict(allow_inf_nan=False)
)
AS_IT_IS = "nothing"
"""The scenario of a plant as its file has it."""


class Scenario(TomlDocument):
    """What is wrong with a plant: sections of SIM.toml that are laid over the study's."""

    what: Text
    """What is wrong, in words."""
    named: Texts = ()
    """What the loop may rightly say of it, and must say some of: causes, or kinds of findings; none: nothing."""
    also: Texts = ()
    """What it may say besides, and need not."""
    plant: Mapping[str, Mapping[str, Any]] = {}
    """By section of SIM.toml, the keys that differ: `[plant.effects]`."""


class LoopStudy(TomlDocument):
    """Jobs in a closed loop: measured, solved, executed by a plant with its errors, and learned from."""

    kind: Literal["loop"]
    title: Text
    """What the tables and pictures are headed with."""
    cell: Text = "cell.toml"
    """The cell's file: part, program, process, tolerance."""
    cell_with: Mapping[str, Any] = {}
    """What all loops have otherwise than that file: values by dotted key."""
    plant: Text = "sim.toml"
    """The plant's, as the simulator reads it."""
    plant_with: Mapping[str, Mapping[str, Any]] = {}
    """By section of SIM.toml, the keys that differ in all scenarios: `[plant_with.plant]`."""
    scenarios: Texts = ()
    """Files of scenarios, or folders of them; none: the plant as its file has it."""
    loops: Annotated[Mapping[Name, Mapping[str, Any]], Field(min_length=1)]
    """By name, what that loop has otherwise than the cell's file: values by dotted key. And `witness = "rate"`
    or `"spot"`: what it begins with of a spot that the same machine has polished on another part; `"touch"`: it
    begins with what the first touch of `polishd calibrate cell` has taught there. `poses`: how the part lies
    (angle_deg, x_mm, y_mm) in maps before the first pass, which tell the instrument's own error. `learns = false`:
    what its passes teach is judged, and not taken over."""
    seeds: Annotated[int, Field(ge=1, le=10_000)] = 20
    """How many plants a scenario and loop; all loops meet the same ones. [1]"""
    first_seed: Annotated[int, Field(ge=0)] = 1
    """The first of them. [1]"""
    raster: bool = False
    """Take a raster of one's own over the part, as `polishd demo` does, instead of the cell's program."""
    passes: Annotated[int, Field(ge=1, le=100)] = 6
    """Most passes of a job, instead of the cell's. [1]"""

    def without_use(self) -> Iterator[tuple[str, str]]:
        """Nothing is."""
        yield from ()

    def loop(self, name: str) -> tuple[dict[str, Any], Taken | None, Poses, bool]:
        """What it has otherwise than the cell's file by dotted key, its witness, poses and ``learns``; ConfigError."""
        keys = {**self.cell_with, **self.loops[name]}
        learns = keys.pop("learns", True)
        if not isinstance(learns, bool):
            raise self.error(f"loops.{name}.learns", f"must be true or false, not {learns!r}; mend it")
        witness = keys.pop("witness", None)
        if witness not in {None, *get_args(Taken)}:
            raise self.error(
                f"loops.{name}.witness", f'{witness!r} is nothing to begin with; it is "rate", "spot" or "touch"'
            )
        try:
            poses = _POSES.validate_python(keys.pop("poses", []))
        except ValidationError:
            wanted = "a list of [angle_deg, x_mm, y_mm]: the last two left out, the part is not shifted"
            raise self.error(f"loops.{name}.poses", f"is not {wanted}") from None
        return keys, witness, tuple((angle, *(shift or (0.0, 0.0))) for angle, *shift in poses), learns

    def file_of(self, key: Literal["cell", "plant"]) -> Path:
        """That file; ConfigError with the place of its key where it is not there."""
        return self._there(key, self.cell if key == "cell" else self.plant)

    def _there(self, key: str, given: str) -> Path:
        path = self.resolve(given)
        if not path.exists():
            raise self.error(key, f"{path}: no such file; name one that is there")
        return path

    def all_scenarios(self) -> dict[str, Scenario]:
        """By name, those of its files and folders; ConfigError for one that is wrong, or not there."""
        found = {}
        for given in self.scenarios:
            path = self._there("scenarios", given)
            files = sorted(path.glob("*.toml")) if path.is_dir() else [path]
            if not files:
                raise self.error("scenarios", f"{given}: no .toml file is in this folder; name one that has scenarios")
            found.update({file.stem: load_scenario(file) for file in files})
        return found or {AS_IT_IS: Scenario(what="the plant as its file has it")}


def load_scenario(path: Path) -> Scenario:
    """One scenario's file; ConfigError with file, line and key."""
    return Scenario.of(*load_toml(path))
