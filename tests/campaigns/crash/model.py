"""The model of the journal's protocol (docs/model/journal.pml), checked exhaustively by Spin."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from tests.campaigns.crash.recording import ROOT

MODEL = ROOT / "docs" / "model" / "journal.pml"
BROKEN = ("EARLY_ACK", "LATE_INTENT", "NO_MARK", "SAME_CYCLE", "ANY_MAP", "BLIND_MEMORY")
"""Daemons that break a promise each: Spin must find how."""
DEPTH = 1_000_000
MISSING = next((f"{tool} is not installed" for tool in ("spin", "gcc") if shutil.which(tool) is None), "")


@dataclass(frozen=True, slots=True)
class Checked:
    """What Spin says."""

    states: int
    wrong: str
    """The first promise that is broken; empty where all hold in every state."""


def check(faults: int, *, broken: str = "", lives: bool = False) -> Checked:
    """All orders of all steps with so many faults; ``lives``: that the job comes to its end, too."""
    options = [f"-DFAULTS={faults}", *([f"-D{broken}"] if broken else [])]
    compiled = ["-DNFAIR=5"] if lives else ["-DSAFETY", "-DNOCLAIM"]
    with tempfile.TemporaryDirectory(prefix="polishd-model-") as folder:
        for command in (
            ["spin", "-a", *options, str(MODEL)],
            ["gcc", "-O1", "-DCOLLAPSE", *compiled, "-o", "pan", "pan.c"],
        ):
            subprocess.run(command, cwd=folder, check=True, capture_output=True)
        search = [str(Path(folder) / "pan"), *(["-a", "-f"] if lives else []), f"-m{DEPTH}"]
        said = subprocess.run(search, cwd=folder, check=True, capture_output=True, text=True).stdout
    states = re.search(r"(\S+) states, stored", said)
    assert states is not None, said
    assert "max search depth too small" not in said, said
    wrong = re.search(r"^pan:\d+: (.*?)(?: \(at depth \d+\))?$", said, re.MULTILINE)
    errors = re.search(r"errors: (\d+)", said)
    assert errors is not None, said
    assert bool(int(errors[1])) == (wrong is not None), said
    return Checked(int(float(states[1])), wrong[1] if wrong else "")
