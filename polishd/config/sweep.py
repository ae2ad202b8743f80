"""``[sweep]`` of a study's file: which of its keys take many values, and how these go together."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from polishd.config.values import ConfigSection, Pair, Range, Text, as_tuple

How = Literal["crossed", "zipped", "drawn", "latin"]
EVEN = ("linear", "log")
SPREAD = ("uniform", "log_uniform", "normal", "lognormal")
"""Axes that are distributions: they need draws."""


class AxisSection(ConfigSection):
    """The values of one key: a list, or a table with one of these."""

    values: Annotated[tuple[Any, ...], BeforeValidator(as_tuple)] | None = None
    """Those; a list alone is the same."""
    linear: Range | None = None
    """From the first to the last in `count` equal steps. [that of the key]"""
    log: Range | None = None
    """The same in equal ratios. [that of the key]"""
    count: Annotated[int, Field(ge=2, le=1_000_000)] | None = None
    """How many of `linear` and `log`. [1]"""
    uniform: Range | None = None
    """Drawn evenly between the two. [that of the key]"""
    log_uniform: Range | None = None
    """Drawn so that the logarithm is even between the two. [that of the key]"""
    normal: Pair | None = None
    """Drawn from a normal distribution: mean, standard deviation. [that of the key]"""
    lognormal: Pair | None = None
    """Drawn from a lognormal one: median, standard deviation of the natural logarithm. [that of the key]"""
    files: Text | None = None
    """All files that this pattern finds from the study's folder, by name: `"maps/*.dat"`."""
    numbers_from: Annotated[int, Field(ge=0)] | None = None
    """Whole numbers from this one on, another for each draw: seeds. [1]"""
    pair: bool = False
    """The key wants a range, and is given `[value, value]`: the plant draws from ranges."""

    @property
    def kind(self) -> str:
        """Which of them it is."""
        return next(name for name in _KINDS if getattr(self, name) is not None)

    @model_validator(mode="before")
    @classmethod
    def _of_list(cls, value: Any) -> Any:
        if isinstance(value, list):
            return {"values": value}
        if not isinstance(value, dict):
            raise ValueError(
                f"is one value, {value!r}; give a list, or a table such as {{ linear = [a, b], count = n }}"
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
            raise ValueError("count goes with linear and log, and they need it: how many values")
        for name in ("log", "log_uniform"):
            if (ends := getattr(self, name)) is not None and ends[0] <= 0:
                raise ValueError(f"{name} begins at {ends[0]:g}; it must be above 0")
        for name in ("normal", "lognormal"):
            if (shape := getattr(self, name)) is not None and shape[1] <= 0:
                raise ValueError(f"the standard deviation of {name} is {shape[1]:g}; it must be above 0")
        if self.lognormal is not None and self.lognormal[0] <= 0:
            raise ValueError(f"the median of lognormal is {self.lognormal[0]:g}; it must be above 0")
        return self


_KINDS = ("values", *EVEN, *SPREAD, "files", "numbers_from")


class GroupSection(ConfigSection):
    """Keys whose values go together in one way; groups are crossed with each other."""

    how: How = "crossed"
    """Each value with each of the others; side by side (`zipped`); each drawn by itself (`drawn`); or drawn so that
    each key's range is covered evenly (`latin`, a Latin hypercube)."""
    draws: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """How many of `drawn` and `latin`. [1]"""
    over: Annotated[dict[str, AxisSection], Field(min_length=1)]
    """By dotted key of the study, as `"process.force_n"`; in a study of loops also `"cell_with.process.force_n"`,
    `"plant_with.truth.rate"` and `"loops.NAME.process.correction"`."""

    @model_validator(mode="after")
    def _draws_where_drawn(self) -> Self:
        drawn = self.how in {"drawn", "latin"}
        if drawn and self.draws is None:
            raise ValueError(f'draws: is missing; add it: how many points of how = "{self.how}"')
        if not drawn and self.draws is not None:
            raise ValueError('draws: goes with how = "drawn" and "latin"; drop it')
        return self


class SweepSection(ConfigSection):
    """Many cases of one study."""

    seed: Annotated[int, Field(ge=0)] = 1
    """What all that is drawn is drawn from: the same number gives the same cases. [1]"""
    group: Annotated[tuple[GroupSection, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    """Groups of keys, each a table `[[sweep.group]]`."""
