"""What happens between a cell and its shop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from polishd.model.event import Event


@dataclass(frozen=True, slots=True, kw_only=True)
class ShopRateReceived(Event):
    """The shop tells what another cell has learned of a recipe; a job begins with it where this cell has no lesson."""

    name: ClassVar[str] = "rate_offered"
    recipe: Annotated[str, "of process and tool, a hash"]
    cell: Annotated[str, "which has learned it"]
    job: Annotated[str, "in which job"]
    of_cycle: Annotated[int, "in its pass of that cycle"]
    at_s: Annotated[float, "when, Unix time"]
    rate: Annotated[float, "removal rate, relative to the model's own"]
    sigma: Annotated[float, "its standard error on that cell's machine"]
