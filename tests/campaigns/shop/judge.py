"""What became of a shop's parts: by its database, by the cells' journals, and by what their plants know."""

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
    """What the shop does not know, knows twice, or knows otherwise than the cells' journals."""
    wrong = []
    for cell in cells:
        wrong += _differences(f"{cell.name}: passes", _passes(shop, cell.name), Counter(cell.rows(PASSES)))
        events = "SELECT id, job, at, cycle, name, data FROM event WHERE name != 'pass_progressed'"
        taken = f"SELECT seq, job, at, cycle, name, data FROM event WHERE cell = '{cell.name}'"
        wrong += _differences(f"{cell.name}: events", _hashed(shop.rows(taken)), _hashed(cell.rows(events)))
    return [*wrong, *_parts(shop, cells)]


def untold(shop: Shop, cells: Sequence[ShopCell]) -> bool:
    """Something that a journal has is not at the shop yet."""
    for cell in cells:
        ((last,),) = cell.rows("SELECT ifnull(max(id), 0) FROM event")
        if [(last,)] != shop.rows(f"SELECT upto FROM feed WHERE cell = '{cell.name}'"):
            return True
    return bool(shop.rows("SELECT 1 FROM claim WHERE ended IS NULL"))


def polished(cell: ShopCell) -> set[str]:
    """Parts from which the cell's plant has taken something off: the ones beside it, and the one on the seat."""
    sim = cell.files.sim_dir
    kept = {path.stem: path for path in (sim / "parts").glob("*.npz")}
    told = [json.loads(line) for line in (sim / "sim.log").read_text().splitlines() if '"loader_clear"' in line]
    seat = {told[-1]["seat"]: sim / "truth.npz"} if told and told[-1]["seat"] else {}
    return {name for name, path in {**kept, **seat}.items() if _touched(path)}


def twice(found: dict[str, set[str]]) -> Iterator[str]:
    """Parts that several cells have polished; ``found``: what each has."""
    owners = Counter(part for parts in found.values() for part in parts)
    for part, count in sorted(owners.items()):
        if count > 1:
            yield f"{part}: polished in {[cell for cell, parts in found.items() if part in parts]}"


def _touched(path: Path) -> bool:
    with np.load(path) as file:
        return not np.array_equal(file["height_nm"], file["start_nm"])


def _parts(shop: Shop, cells: Sequence[ShopCell]) -> Iterator[str]:
    """Each has ended, by one claim, and as the queue of its cell says."""
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
