"""How a map that polishd made came about: which verb, from which files; kept inside the map's own file."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

MOST_DEPTH = 50
"""Steps one after the other."""
MOST_CHARACTERS = 2**20
SYSTEM_ERROR = "system error"
"""Role of the instrument's own error among the inputs of a step."""


@dataclass(frozen=True, slots=True)
class MapInput:
    """A map that went into another."""

    role: str
    """What it was to the verb: "map", "system error", "left out", ..."""
    name: str
    """Of its file, without folders."""
    sha256: str
    """Of its file's bytes."""
    history: MapStep | None = None
    """How it came about itself; None: as an instrument, or somebody else's program, wrote it."""


@dataclass(frozen=True, slots=True)
class MapStep:
    """The last thing that was done to a map; what was done before is the history of its inputs."""

    verb: str
    """Of ``polishd map``."""
    version: str
    """Of polishd."""
    options: Mapping[str, Any]
    """What was asked for besides the maps: values of JSON."""
    inputs: tuple[MapInput, ...]
    uncertainty_nm: float | None = None
    """How sure a sample of the result is: one standard deviation, the median over the map; None: not known."""

    @property
    def depth(self) -> int:
        """How many steps follow one another."""
        return 1 + max((one.history.depth for one in self.inputs if one.history is not None), default=0)

    @property
    def steps(self) -> Iterator[MapStep]:
        """This one and all before it, of whatever input."""
        yield self
        for one in self.inputs:
            if one.history is not None:
                yield from one.history.steps

    @property
    def profiled(self) -> bool:
        """Whether an instrument's profile is in it, of its own or of all that it was made of."""
        before = [one.history is not None and one.history.profiled for one in self.inputs]
        return "profile" in self.options or (bool(before) and all(before))

    @property
    def less_system(self) -> bool:
        """Whether the instrument's own error is off it, or it is that error, or of all that it was made of."""
        before = [one.history is not None and one.history.less_system for one in self.inputs]
        own = {"system", "result"} & set(self.options) or any(one.role == SYSTEM_ERROR for one in self.inputs)
        return bool(own) or (bool(before) and all(before))

    def to_json(self) -> str:
        """One line of ASCII, which every format can hold; ValueError where it is beyond what is read back."""
        if self.depth > MOST_DEPTH:
            raise ValueError(f"{self.depth} steps follow one another, more than {MOST_DEPTH}")
        text = json.dumps(asdict(self), allow_nan=False, separators=(",", ":"))
        if len(text) > MOST_CHARACTERS:
            raise ValueError(f"it takes {len(text)} characters, more than {MOST_CHARACTERS}")
        return text

    @classmethod
    def from_json(cls, text: str) -> MapStep:
        """What ``to_json`` wrote; ValueError for anything else."""
        from pydantic import TypeAdapter  # which the simulators, and most maps, can do without

        if len(text) > MOST_CHARACTERS:
            raise ValueError(f"it takes {len(text)} characters, more than {MOST_CHARACTERS}")
        step: MapStep = TypeAdapter(cls).validate_json(text)
        if step.depth > MOST_DEPTH:
            raise ValueError(f"{step.depth} steps follow one another, more than {MOST_DEPTH}")
        return step
