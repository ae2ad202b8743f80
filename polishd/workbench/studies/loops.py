"""Many jobs in a closed loop: a row of each scenario and loop."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from statistics import median
from typing import Any

from polishd.config.loop_study import AS_IT_IS, Scenario
from polishd.workbench.studies.loop import ClosedLoopResult


@dataclass(frozen=True, slots=True)
class LoopRow:
    """What a loop came to in a scenario."""

    scenario: str
    loop: str
    runs: int
    accepted: int
    passes_median: float | None
    """To tolerance; None where half of the runs or more did not come so far."""
    true_rms_nm_median: float | None
    """At the end, whatever the end; None where half of the runs or more never polished the part."""
    first_pass_nm_median: float | None
    """As measured after the first pass."""
    false_accepts: int
    named_rightly: int
    """Runs that said of the machine what is wrong with it, and nothing else; nothing, where nothing is."""
    named: Mapping[str, int]
    """How many said what, but for what they need not say: names joined by "+", or "nothing"."""
    forecasts: int
    """Passes of which a map told, ..."""
    held: int
    """... and of these, those that left what was expected with a chance of nine in ten."""
    first_forecasts: int
    """The same of first passes alone, ..."""
    first_held: int
    """... which are expected from what was known before the part."""
    ended: Mapping[str, int]
    """How many ended in which way."""
    cpu_s_median: float


@dataclass(frozen=True, slots=True)
class LoopRows:
    """All runs, and the row of each scenario and loop."""

    runs: tuple[ClosedLoopResult, ...]
    rows: tuple[LoopRow, ...]

    def as_json(self) -> list[dict[str, Any]]:
        """The rows."""
        return [asdict(row) for row in self.rows]


def looped(runs: Sequence[ClosedLoopResult], scenarios: Mapping[str, Scenario]) -> LoopRows:
    """What these jobs came to, in the order of the scenarios."""
    return LoopRows(tuple(runs), tuple(_rows(runs, scenarios)))


def _rows(runs: Sequence[ClosedLoopResult], scenarios: Mapping[str, Scenario]) -> Iterator[LoopRow]:
    """In the scenarios' order."""
    order = {name: number for number, name in enumerate(scenarios)}
    ordered = sorted(runs, key=lambda run: order[run.scenario])  # stable: loops stay in theirs
    for scenario, some in groupby(ordered, key=lambda run: run.scenario):
        mine = list(some)
        for loop in dict.fromkeys(run.loop for run in mine):
            yield _row(scenarios[scenario], [run for run in mine if run.loop == loop])


def _row(scenario: Scenario, runs: Sequence[ClosedLoopResult]) -> LoopRow:
    never = float("inf")
    passes = median(run.passes if run.accepted else never for run in runs)
    true_nm = median(run.true_rms_nm[-1] if run.true_rms_nm else never for run in runs)
    first = [run.rms_nm[1] for run in runs if len(run.rms_nm) > 1]
    came, began = [one for run in runs for one in run.came_nm], [run.came_nm[0] for run in runs if run.came_nm]
    said = [tuple(sorted(set(run.named) - set(scenario.also))) for run in runs]
    right = [set(names) <= set(scenario.named) and bool(names) == bool(scenario.named) for names in said]
    return LoopRow(
        scenario=runs[0].scenario,
        loop=runs[0].loop,
        runs=len(runs),
        accepted=sum(run.accepted for run in runs),
        passes_median=None if passes == never else passes,
        true_rms_nm_median=None if true_nm == never else true_nm,
        first_pass_nm_median=median(first) if first else None,
        false_accepts=sum(run.falsely_accepted for run in runs),
        named_rightly=sum(right),
        named=dict(Counter("+".join(names) or AS_IT_IS for names in said)),
        forecasts=len(came),
        held=_held(came),
        first_forecasts=len(began),
        first_held=_held(began),
        ended={how: sum(run.ended == how for run in runs) for how in dict.fromkeys(run.ended for run in runs)},
        cpu_s_median=median(run.cpu_s for run in runs),
    )


def _held(came: Sequence[tuple[float, float, float]]) -> int:
    return sum(low <= left <= high for low, high, left in came)
