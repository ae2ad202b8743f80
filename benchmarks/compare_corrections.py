"""What the compliance correction is for: the same simulated cells with and without it (``make compare``).

Runs ``polishd demo --correction none`` and ``exact`` on the same seeds and prints the RMS after the first pass and the
passes needed. Plant, seed and learning are the same; only ``process.correction`` of the controller differs.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

SEEDS = (1, 2, 3)
CORRECTIONS = ("none", "exact")
RESULT = Path("build/corrections.json")


def demo(seed: int, correction: str, folder: Path) -> dict[str, Any]:
    """One demo: RMS after the first pass, passes, outcome."""
    command = [sys.executable, "-m", "polishd.cli", "demo", "--json", "--seed", str(seed), "--correction", correction]
    done = subprocess.run([*command, "--out", str(folder)], stdout=subprocess.PIPE, text=True, check=False)
    summary = json.loads(done.stdout)
    cycles = summary["cycles"]
    return {
        "seed": seed,
        "correction": correction,
        "first_pass_rms_nm": cycles[1]["rms_nm"],
        "passes": len(cycles) - 1,
        "outcome": summary["outcome"],
    }


def main() -> int:
    """0 if exact is better than none on each seed."""
    with tempfile.TemporaryDirectory() as scratch:
        rows = [demo(seed, name, Path(scratch) / f"{seed}-{name}") for seed in SEEDS for name in CORRECTIONS]
    table = Table("seed", "correction", "RMS after pass 1, nm", "passes", "outcome")
    for row in rows:
        first = f"{row['first_pass_rms_nm']:.2f}"
        table.add_row(str(row["seed"]), row["correction"], first, str(row["passes"]), row["outcome"])
    Console().print(table)
    RESULT.parent.mkdir(exist_ok=True)
    RESULT.write_text(json.dumps(rows, indent=2) + "\n")
    pairs = zip(rows[::2], rows[1::2], strict=True)
    return int(
        not all(
            exact["first_pass_rms_nm"] < none["first_pass_rms_nm"] and exact["passes"] <= none["passes"]
            for none, exact in pairs
        )
    )


if __name__ == "__main__":
    sys.exit(main())
