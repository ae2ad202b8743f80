"""``polishd rehearse CELL.toml``: the simulated cell of that very cell, and the cell's file with its addresses."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from polishd.commissioning.rehearsal.devices import (
    add_actuator,
    add_line,
    add_monitors,
    add_robot,
    add_spindle,
)
from polishd.commissioning.rehearsal.draft import RehearsalDraft, cell_text, require_apart, sim_text, usual_folder
from polishd.commissioning.rehearsal.part import PROFILE, add_instrument, add_part, note_process
from polishd.commissioning.rehearsal.simulated_cell import measure_artefact, run_simulator
from polishd.config.cell import CellConfig, load_config
from polishd.config.simulator import require_simulated
from polishd.maps.commission import prove_profile
from polishd.model.devices import port_of
from polishd.model.errors import ConfigError
from polishd.plugin_loader import OWN, Hooks, installed, load_cell
from polishd.rendering.terminal import stderr
from polishd.util.files import write_atomic

# The verb: reads a cell, gathers, refuses, writes both files, proves the instrument, starts what is simulated.

SIM = "sim.toml"
STATE = "state"
ARTEFACT = "artefact.dat"
NOTHING = ["true"]
"""A command that does nothing."""
ONE_OF_A_PORT: dict[str, Callable[[RehearsalDraft, str], None]] = {
    "robot": add_robot,
    "actuator": add_actuator,
    "spindle": add_spindle,
    "metrology": add_instrument,
    "loader": add_line,
    "force_sensor": add_line,
}


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """What was written."""

    sim: Path
    cell: Path
    notes: tuple[str, ...]
    """Differences between the simulated cell and the real one."""


def rehearsal_verb(cell: Path, out: Path | None, options: Sequence[str], *, write_only: bool) -> int:
    """Write the rehearsal of a cell and, unless ``write_only``, start its simulator; the exit code."""
    if any(option.partition("=")[0] in {"--state", "--artefact"} for option in options):
        raise ConfigError("--state and --artefact do not go with rehearse, which has its own folders; use --out")
    own = _plant_options(options)
    if write_only and (others := [one for one in options if one not in own.given]):
        raise ConfigError(
            f"{' '.join(others)}: goes to the simulator, which --write-only does not start; of its options --speed and "
            "--seed are written into its file. Leave the others out."
        )
    made = write_rehearsal(cell, out, own.values)
    for note in made.notes:
        stderr.print(f"- {note}", markup=False, highlight=False, soft_wrap=True)
    stderr.print(f"simulated cell: {made.sim}", markup=False, highlight=False, soft_wrap=True)
    stderr.print(f"rehearse with:  polishd run {made.cell}", markup=False, highlight=False, soft_wrap=True)
    return 0 if write_only else run_simulator(made.sim, options)


@dataclass(frozen=True, slots=True)
class _PlantOptions:
    """Options of the simulator that its file can hold, under [plant]."""

    values: Mapping[str, float]
    given: tuple[str, ...]
    """As they were given."""


def _plant_options(options: Sequence[str]) -> _PlantOptions:
    values, given = dict[str, float](), list[str]()
    for at, option in enumerate(options):
        name, _, text = option.partition("=")
        key = name.removeprefix("--")
        if name not in {"--speed", "--seed"}:
            continue
        words = [option] if text else list(options[at : at + 2])
        try:
            values[key] = {"speed": float, "seed": int}[key](words[-1].rpartition("=")[2])
        except ValueError as error:
            raise ConfigError(f"{' '.join(words)}: is no number. Give one, as {name} 20.") from error
        given += words
    return _PlantOptions(values, tuple(given))


def write_rehearsal(cell: Path, out: Path | None = None, plant: Mapping[str, float] | None = None) -> Rehearsal:
    """SIM.toml and the rehearsal's cell, in a new folder; nothing is opened, and nothing of the real cell written.

    ``plant``: keys of [plant] instead of what is usual: ``speed``, ``seed``.

    Raises:
        ConfigError: the cell is wrong, cannot be simulated, or the folder is the real cell's or not empty.
        PluginError: a plugin that the cell names is missing or broken.
    """
    config, hooks = load_cell(cell)
    draft, folder = draft_rehearsal(config, hooks), (out or usual_folder(config)).absolute()
    for key, value in (plant or {}).items():
        draft.put("plant", key, value, f"as --{key} said")
    require_apart(draft, folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    own = f"{cell.stem}-rehearsal.toml"
    with tempfile.TemporaryDirectory(prefix=".polishd-", dir=folder.parent) as scratch:
        beside = Path(scratch) / "rehearsal"  # it appears whole, or not at all
        beside.mkdir()
        _write(draft, beside, own)
        beside.replace(folder)
    return Rehearsal(folder / SIM, folder / own, tuple(draft.notes))


def _write(draft: RehearsalDraft, folder: Path, own: str) -> None:
    """All files; ConfigError where what is written would be no simulated cell."""
    texts = {SIM: sim_text(draft, own), own: cell_text(draft)}
    for name, content in {**draft.files, **{name: text.encode() for name, text in texts.items()}}.items():
        write_atomic(folder / name, content)
    load_config(folder / own)
    try:
        require_simulated(folder / SIM)
        measure_artefact(folder / SIM, folder / ARTEFACT)
    except ConfigError as error:
        wrong = "; ".join(re.sub(r"^.*?\.toml(:\d+)?: ", "", line) for line in str(error).splitlines())
        raise ConfigError(f"{draft.config.path}: there is no simulated cell like this: {wrong}") from error
    prove_profile(folder / PROFILE, folder / ARTEFACT)


def draft_rehearsal(config: CellConfig, hooks: Hooks) -> RehearsalDraft:
    """All of a cell that the simulator is to be; ConfigError where it cannot."""
    draft = RehearsalDraft(config, hooks)
    used = _used(draft)
    add_part(draft, draft.device_type(used["robot"]).simulation_speed)
    note_process(draft)
    for port, add in ONE_OF_A_PORT.items():
        if port in used:
            add(draft, used[port])
    if monitors := [name for name in config.devices if port_of(name) == "monitor"]:
        add_monitors(draft, monitors)
    _add_folders(draft)
    _silence_notifiers(draft)
    return draft


def _used(draft: RehearsalDraft) -> dict[str, str]:
    """The device of each port that the job uses; of several the others are left out."""
    used = dict(draft.config.used)
    for device in draft.config.devices:
        port = port_of(device)
        if port in used and used[port] != device:
            draft.instead(device, None, f"the simulator has one {port}")
    return used


def _add_folders(draft: RehearsalDraft) -> None:
    draft.laid["cell.state_dir"] = STATE
    if draft.config.run_dir is not None:
        draft.laid["cell.run_dir"] = "run"


def _silence_notifiers(draft: RehearsalDraft) -> None:
    """Notifiers and commands of the cell are left out."""
    for name, section in draft.config.part_handling:
        if command := getattr(section, "command", ()):
            why = f"{' '.join(command)} would act on the real cell"
            draft.instead(f"part_handling.{name}.command", NOTHING, why)
    for name in draft.config.notify:
        draft.instead(f"notify.{name}", None, "a rehearsal sends no notifications")
    known = installed()
    if others := [name for name in draft.config.plugins.load if known.get(name) != [OWN]]:
        draft.notes.append(
            f"plugins.load: {', '.join(others)} of others are loaded as in the cell, and do what they do"
        )
