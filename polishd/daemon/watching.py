"""The passes watched over cycles, jobs and restarts: what each showed stands in its row of the journal."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from polishd.config.process import LIMITS_OF_PROCESS
from polishd.daemon.journal import Journal
from polishd.model.finding import Finding, FindingLimits, PassIndicators, PassSeries
from polishd.process.findings import extend_series, findings
from polishd.recipe.encoding import record_of

PROCESS = ("process.", "compliance.", "kinematics.", "roles.")
"""Sections of the config that make the process: rates of passes by others say nothing of this one's."""
FAR_BACK = 8
"""Passes among which the last one that was watched is looked for."""


def watch(journal: Journal, cycle: int, shown: PassIndicators, limits: FindingLimits) -> tuple[Finding, ...]:
    """Keep what that cycle's pass showed, and say what is found in it that was not told of it before.

    A pass is watched again where the cell was held over it and measures anew: a person knows of it then.
    """
    (record,) = (one for one in journal.passes if one.cycle == cycle)
    earlier = [
        record_of(PassIndicators, one.facts["shown"])
        for one in journal.passes
        if one.cycle < cycle and "shown" in one.facts
    ]
    series = extend_series(_series(journal, cycle), shown)
    found = findings(series, [*earlier, shown], limits)
    told = {one["kind"] for one in record.facts.get("findings", ())}
    if any(one.stops == "cell" for one in found):
        series = PassSeries(series.process)  # a person sees to the tool: what follows is held against what it is then
    new = tuple(one for one in found if one.kind not in told)
    said = [*record.facts.get("findings", ()), *map(asdict, new)]
    journal.add_facts(cycle, {"shown": asdict(shown), "series": asdict(series), "findings": said})
    return new


def _series(journal: Journal, cycle: int) -> PassSeries:
    """With the pass before, of whichever job; one that begins where that was by another process."""
    process = _process(journal.terms)
    last = next((facts["series"] for facts in journal.passes_before(cycle, FAR_BACK) if "series" in facts), None)
    if last is None or last["process"] != process:
        return PassSeries(process)
    return record_of(PassSeries, last)


def _process(terms: Mapping[str, Any] | None) -> str:
    """What identifies the process that a job was begun with."""
    known = (terms or {}).items()
    own = {key: value for key, value in known if key.startswith(PROCESS) and key not in LIMITS_OF_PROCESS}
    return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()[:16]
