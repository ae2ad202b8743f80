"""Judge a shop's parts by its database, the cells' journals and the true surfaces of the simulated plants."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.system.shop_rig import Shop, ShopCell

PASSES = "SELECT job.name, pass.cycle, program_sha256, how FROM pass JOIN job ON job.id = pass.job"
OVER = frozenset({"done", "aside", "removed"})


def lost_or_twice(shop: Shop, cells: Sequence[ShopCell]) -> list[str]:
    """Return the differences between the shop and the cells' journals: what is missing, double or different."""
    wrong = []
    for cell in cells:
        wrong += _differences(f"{cell.name}: passes", _passes(shop, cell.name), Counter(cell.rows(PASSES)))
        events = "SELECT id, job, at, cycle, name, data FROM event WHERE name != 'pass_progressed'"
        taken = f"SELECT seq, job, at, cycle, name, data FROM event WHERE cell = '{cell.name}'"
        wrong += _differences(f"{cell.name}: events", _hashed(shop.rows(taken)), _hashed(cell.rows(events)))
    return [*wrong, *_parts(shop, cells)]


def has_unsent_events(shop: Shop, cells: Sequence[ShopCell]) -> bool:
    """Return whether the shop lacks an event of a journal, or a claim has not ended."""
    for cell in cells:
        ((last,),) = cell.rows("SELECT ifnull(max(id), 0) FROM event")
        if [(last,)] != shop.rows(f"SELECT upto FROM feed WHERE cell = '{cell.name}'"):
            return True
    return bool(shop.rows("SELECT 1 FROM claim WHERE ended IS NULL"))


def polished(cell: ShopCell) -> set[str]:
    """Return the parts from which the cell's plant has removed material, with the one that is seated."""
    sim = cell.files.sim_dir
    kept = {path.stem: path for path in (sim / "parts").glob("*.npz")}
    loads = [json.loads(line) for line in (sim / "sim.log").read_text().splitlines() if '"loader_clear"' in line]
    seat = {loads[-1]["seat"]: sim / "truth.npz"} if loads and loads[-1]["seat"] else {}
    return {name for name, path in {**kept, **seat}.items() if _touched(path)}


def twice(found: dict[str, set[str]]) -> Iterator[str]:
    """Yield a message for each part that several cells have polished; ``found``: parts by cell."""
    owners = Counter(part for parts in found.values() for part in parts)
    for part, count in sorted(owners.items()):
        if count > 1:
            yield f"{part}: polished in {[cell for cell, parts in found.items() if part in parts]}"


def _touched(path: Path) -> bool:
    with np.load(path) as file:
        return not np.array_equal(file["height_nm"], file["start_nm"])


def _parts(shop: Shop, cells: Sequence[ShopCell]) -> Iterator[str]:
    """Yield a message for each part that has not ended, has several claims, or differs from its cell's queue."""
    queues = {cell.name: dict(cell.rows("SELECT claim, verdict FROM queue WHERE claim != ''")) for cell in cells}
    sql = (
        "SELECT part.job, part.state, part.verdict, claim.request, claim.cell FROM part LEFT JOIN claim "
        "ON claim.part = part.id AND claim.how NOT IN ('given back', 'refused') ORDER BY part.id"
    )
    seen: Counter[str] = Counter()
    for job, state, verdict, request, cell in shop.rows(sql):
        seen[job] += 1
        if state not in OVER:
            yield f"{job} is {state}"
        elif state == "removed":
            yield from [f"{job} was taken out, and {cell} has it"] if cell else []
        elif queues[cell].get(request) != verdict:
            yield f"{job}: the shop says {verdict}, the queue of {cell} {queues[cell].get(request)}"
    yield from (f"{job} has {count} claims" for job, count in seen.items() if count > 1)
    begun = Counter(name for cell in cells for (name,) in cell.rows("SELECT DISTINCT name FROM job"))
    yield from (f"{job} was begun in {count} cells" for job, count in begun.items() if count > 1)


def _passes(shop: Shop, cell: str) -> Counter[Any]:
    sql = (
        "SELECT job.name, pass.cycle, program_sha256, how FROM pass JOIN job ON job.cell = pass.cell "
        f"AND job.journal = pass.journal AND job.job = pass.job WHERE pass.cell = '{cell}'"
    )
    return Counter(shop.rows(sql))


def _hashed(rows: Sequence[tuple[Any, ...]]) -> Counter[Any]:
    return Counter((row[0], row[4], hashlib.sha256(repr(row).encode()).hexdigest()) for row in rows)


def _differences(what: str, known: Counter[Any], true: Counter[Any]) -> Iterator[str]:
    if known != true:
        missing, more = list((true - known).elements()), list((known - true).elements())
        yield f"{what}: {len(missing)} lost, {len(more)} too many: {[*missing, *more][:3]}"
