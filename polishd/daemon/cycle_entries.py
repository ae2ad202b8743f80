"""What a summary says of each cycle."""

from __future__ import annotations

from typing import Any

from polishd.daemon.journal import Journal
from polishd.daemon.journal_records import MapRecord, PassRecord
from polishd.daemon.turns import tool_of
from polishd.recipe.records import figures


def cycle_entries(journal: Journal, *, several_tools: bool) -> list[dict[str, Any]]:
    """One entry a measurement; what belongs to the pass after it is None where there was none."""
    passes = {record.cycle: record for record in journal.passes}
    return [_entry(journal, record, passes.get(record.cycle), several_tools) for record in journal.history]


def _entry(journal: Journal, measured: MapRecord, run: PassRecord | None, several_tools: bool) -> dict[str, Any]:
    tool = {"tool": None if run is None else tool_of(run.facts)}
    return {
        **figures(measured.stats, None if run is None else run.facts),
        "how": None if run is None else run.how or "begun",
        **(tool if several_tools else {}),
        "executed_s": None if run is None else journal.contact_s(run.cycle),
        "uncertain": None if run is None else [[a, end - 1] for a, end in journal.uncertain(run.cycle)],
        "found": [] if run is None else [one["what"] for one in run.facts.get("findings", ())],
        "notes": measured.stats.get("notes", []),
    }
