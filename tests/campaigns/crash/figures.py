"""Results of the crash campaigns: kept in files, added up, and shown in docs/reference/results.md."""

from __future__ import annotations

import json
import os
import pickle
import platform
import shutil
import sqlite3
from collections import Counter, defaultdict
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from polishd.util.files import write_atomic
from tests.campaigns import result_files
from tests.campaigns.crash.attacks import ATTACKS_KNOWN
from tests.campaigns.crash.daemon_recording import recorded_daemon
from tests.campaigns.crash.kills import Count
from tests.campaigns.crash.model import BROKEN, Checked
from tests.campaigns.crash.recording import ROOT, Op
from tests.campaigns.crash.states import KEY_BYTES, Tried

PROVED = ("polishd/daemon", "polishd/util")
"""What the figures are of: where it changes, they begin anew."""
SAID = {
    "lost": "acknowledged, and lost",
    "twice_unmarked": "polished, and not recorded in the journal",
    "claimed": "blocks that the journal has as polished, and the plant did not see",
    "unopenable": "journals that do not open",
    "dug": "tools that stood on the part for longer than they may",
    "not_held": "starts that were not held",
    "stuck": "jobs that could not go on",
    "model": "promises that the model breaks",
}
"""What may not be."""
PAGE = ROOT / "docs" / "reference" / "results.md"
BEGIN, END = "<!-- written by make crash -->\n", "<!-- end of what make crash writes -->"
EXAMPLES = 20


def proved() -> str:
    """Return the hash of these sources."""
    return result_files.sources(PROVED)


class Figures:
    """A folder: ``figures.json``, and beside it the recording and the states that were tried."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder, self._seed = folder, seed
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "figures.json"
        self.all: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
        if (self.all.get("of"), self.all.get("seed")) != (proved(), seed):
            for old in folder.glob("*"):
                old.unlink() if old.is_file() else None
            self.all = {"of": proved(), "seed": seed, "states": {}, "kills": {}, "model": {}}
        keys = folder / "states.keys"
        content = keys.read_bytes() if keys.exists() else b""
        self.keys = {content[k : k + KEY_BYTES] for k in range(0, len(content), KEY_BYTES)}

    def recording(self) -> list[Op]:
        """That of an earlier session, or a new one."""
        path = self._folder / "recording.pickle"
        if not path.exists():
            folder = self._folder / "recorded"
            shutil.rmtree(folder, ignore_errors=True)  # of a session that was interrupted
            write_atomic(path, pickle.dumps(recorded_daemon(folder)))
            shutil.rmtree(folder)
        found: list[Op] = pickle.loads(path.read_bytes())
        self.all["states"].update(_told(found))
        return found

    @property
    def states(self) -> int:
        """Different ones that were judged."""
        return int(self.all["states"].get("states", 0))

    @property
    def variants(self) -> int:
        """Of a crash at each prefix."""
        return int(self.all["states"].get("variants", 0))

    @property
    def kills(self) -> int:
        """Processes that were killed."""
        return int(self.all["kills"].get("kills", 0))

    @property
    def parts(self) -> int:
        """The number of the next cell."""
        return int(max(self.all["kills"].get("parts", []), default=-1)) + 1

    def add_states(self, variants: int, tried: Tried) -> None:
        """A round, and what came of it."""
        mine = self.all["states"]
        self.keys |= tried.keys
        mine.update(states=len(self.keys), variants=variants, disks=len({key[: KEY_BYTES // 2] for key in self.keys}))
        _add(mine, tried.bad, tried.examples)
        write_atomic(self._folder / "states.keys", b"".join(self.keys))
        self._save()

    def add_kills(self, part: int, count: Count) -> None:
        """A cell, and what befell it."""
        mine = self.all["kills"]
        mine["parts"] = sorted({*mine.get("parts", []), part})
        for name in ("kills", "in_contact", "went_on", "finished"):
            mine[name] = mine.get(name, 0) + getattr(count, name)
        mine["attacks"] = dict(Counter(mine.get("attacks", {})) + count.attacks)
        mine["dug_s"] = round(max(mine.get("dug_s", 0.0), count.dug_s), 3)
        _add(mine, count.bad, count.examples)
        self._save()

    def add_model(self, of: str, faults: int, held: list[Checked], caught: list[str]) -> None:
        """What holds in how many states, and which broken ones were caught."""
        wrong = [found.wrong for found in held if found.wrong]
        wrong += [f"{broken} was not caught" for broken in BROKEN if broken not in caught]
        states = [found.states for found in held]
        self.all["model"] = {"of": of, "faults": faults, "states": states, "caught": caught, "examples": wrong}
        self.all["model"]["bad"] = {"model": len(wrong)}
        self._save()

    def summary(self) -> dict[str, Any]:
        """For the last line."""
        bad = wrong(self.all)
        return {"states": self.states, "kills": self.kills, **{name: bad[name] for name in SAID}, **self._of()}

    def _of(self) -> dict[str, Any]:
        return {"seed": self._seed, "of": self.all["of"]}

    def _save(self) -> None:
        self.all["on"] = f"{platform.system()}, SQLite {sqlite3.sqlite_version}, Python {platform.python_version()}"
        self.all["at"] = datetime.now(UTC).strftime("%Y-%m-%d")
        self.all["cores"] = os.cpu_count()
        write_atomic(self._folder / "figures.json", json.dumps(self.all, indent=1).encode())


def _add(mine: dict[str, Any], bad: Mapping[str, int], examples: list[str]) -> None:
    mine["bad"] = dict(Counter(mine.get("bad", {})) + Counter(bad))
    mine["examples"] = [*mine.get("examples", []), *examples][:EXAMPLES]


def _told(recording: list[Op]) -> dict[str, int]:
    """What the recording holds."""
    kinds = Counter(op.kind for op in recording)
    commits = sum("durable" in op.what for op in recording)
    return {"acts": sum(kinds.values()) - kinds["mark"], "syncs": kinds["sync"], "commits": commits}


def wrong(all_: Mapping[str, Any]) -> Counter[str]:
    """What may not be, in all of it."""
    return sum((Counter(all_[name].get("bad", {})) for name in ("states", "kills", "model")), Counter[str]())


def table(all_: Mapping[str, Any]) -> str:
    """For the page."""
    states, kills, model = (defaultdict(int, all_[name]) for name in ("states", "kills", "model"))
    bad = wrong(all_)
    attacks = Counter(kills["attacks"] or {})
    each = ", ".join(f"{attack.name} {attacks[attack.name]}" for attack in ATTACKS_KNOWN)
    rows = [
        ("crash states judged, all different", f"{states['states']:,}"),
        ("... of them with different files", f"{states['disks']:,}"),
        ("... acts, syncs, commits of the recording", f"{states['acts']:,}, {states['syncs']}, {states['commits']}"),
        ("processes killed", f"{kills['kills']:,}"),
        ("attacks in all", f"{attacks.total():,}"),
        ("... of each kind", each),
        ("... with the tool on its way to the part, or on it", f"{kills['in_contact']:,}"),
        ("starts that came up held, and went on after `resume`", f"{kills['went_on']:,}"),
        ("jobs that went on to their end", f"{kills['finished']:,}"),
        ("longest that a tool stood on the part after an attack, s", f"{kills['dug_s']:g}"),
        ("states of the model", f"{max(model['states'] or [0]):,}, with {model['faults']} faults"),
        ("... daemons that break it, and were caught", ", ".join(model["caught"] or ["not checked"])),
        *((f"**{said}**", f"**{bad[name]}**") for name, said in SAID.items()),
    ]
    of = f"Sources {all_['of']}, seed {all_['seed']}, {all_['on']}, {all_['cores']} cores, {all_['at']}."
    return "| what | how many |\n|---|---|\n" + "".join(f"| {what} | {n} |\n" for what, n in rows) + f"\n{of}\n"


def write_page(all_: Mapping[str, Any]) -> None:
    """Put it into docs/reference/results.md."""
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(before + BEGIN + table(all_) + END + rest.partition(END)[2])
