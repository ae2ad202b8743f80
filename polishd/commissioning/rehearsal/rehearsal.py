"""``polishd rehearse CELL.toml``: the simulated cell of that very cell, and the cell's file with its addresses.

Here are the verb, part, process and instrument: the surface at the start, and notes on what is not simulated.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import tomlkit

from polishd.commissioning.rehearsal.draft import (
    REQUEST,
    SIM_STATE,
    RehearsalDraft,
    add_actuator,
    add_line,
    add_monitors,
    add_robot,
    add_spindle,
    cell_text,
    is_simulated,
    put_kind,
    require_separate_folders,
    sim_text,
    usual_folder,
)
from polishd.commissioning.rehearsal.simulated_cell import measure_artefact, run_simulator
from polishd.config.cell import CellConfig, load_config
from polishd.config.instrument_profile import ProfileFile
from polishd.config.process_sections import MeasuredSection
from polishd.config.simulator import require_simulated
from polishd.config.simulator_cell import COARSEST_MM, FINEST_MM, MORE_ACCEL
from polishd.config.simulator_physics import Truth
from polishd.config.toml_loader import did_you_mean, loads_toml
from polishd.maps.commission import prove_profile
from polishd.model.devices import port_of
from polishd.model.errors import ConfigError
from polishd.model.outline import Circle
from polishd.model.process import ToolProcess
from polishd.plugin_loader import OWN, Hooks, installed, load_cell
from polishd.rendering.terminal import stderr
from polishd.util.files import toml_text, unwritable_message, write_atomic

START_OVER_TOLERANCE = 9.0
"""RMS of the part at the start, over the tolerance: as in the demo."""
PV_OVER_RMS = 8.3
OF_MOST_REMOVAL = 0.5
"""Peak to valley at the start, at most, over what one pass may remove."""
LONGEST_NAME = 39
"""Bytes of a part's name in the simulated instrument's files."""

SIM = "sim.toml"
STATE = "state"
ARTEFACT = "artefact.dat"
NOTHING = ["true"]
"""A command that does nothing."""

# Part and process: the surface at the start, and what of the tool is not simulated.


def add_part(draft: RehearsalDraft, speed: float) -> None:
    """Add the surface at the start and the ranges of the hidden truth."""
    part, job, machine, hidden = draft.config.part, draft.config.job, draft.config.machine, Truth()
    if len(part.id.encode()) > LONGEST_NAME:
        raise draft.config.error("part.id", f"is longer than the {LONGEST_NAME} bytes that a MetroPro map has room for")
    draft.put("plant", "seed", 1, "--seed: the hidden truth is drawn from it")
    draft.put("plant", "speed", speed, "--speed: process seconds per wall second")
    if job.tolerance_nm is not None:
        most_nm = OF_MOST_REMOVAL * draft.config.limits.max_removal_nm
        rms_nm = min(START_OVER_TOLERANCE * job.tolerance_nm, most_nm / PV_OVER_RMS)
        start = f"{START_OVER_TOLERANCE:g} x job.tolerance_nm, or what limits.max_removal_nm lets; or --surface MAP.dat"
        draft.put("plant", "rms_nm", round(rms_nm, 3), start)
        draft.put("plant", "pv_nm", round(PV_OVER_RMS * rms_nm, 3), f"{PV_OVER_RMS:g} x rms_nm")
    for key in ("rate", "stiffness", "drift", "force_noise", "map_noise_nm"):
        draft.put("hidden_truth", key, getattr(hidden, key), "drawn from the seed; 0: a perfect machine")
    accel = f"{MORE_ACCEL:g} x machine.accel_mm_s2, which is on the safe side"
    draft.put("hidden_truth", "accel_mm_s2", MORE_ACCEL * machine.accel_mm_s2, accel)
    if part.free_edge:
        draft.notes.append("part.free_edge: the simulated part sits in a flush ring; no tool sinks over its rim")
    if part.form is not None:
        draft.instead("part.form", None, "the simulated instrument shows the part as behind a null, without its form")


def note_process(draft: RehearsalDraft) -> None:
    """Note what is not simulated of tool and robot. Raise ConfigError if one of their files cannot be read."""
    config, process, compliance, usual = draft.config, draft.config.process, draft.config.compliance, ToolProcess()
    config.robot_model()
    if process.removal_model == "measured_tif" and process.tif is not None:
        config.measured_tif()
        if process.depth_exponent != usual.depth_exponent:
            exponent = f"process.depth_exponent = {process.depth_exponent:g}"
            draft.notes.append(f"{exponent}: the simulated spot's volume goes as depth to the 1.5, as Hertz has it")
    elif process.removal_model != "hertz_preston":
        draft.notes.append(
            f"process.removal_model = {process.removal_model!r}: it is not simulated; hertz_preston is, with the tool "
            "and the Preston constant of [process]"
        )
    viscous = ("viscosity_mpa_s", "second_viscosity_mpa_s", "lame_mpa")
    if any(getattr(process, name) != getattr(usual, name) for name in viscous):
        draft.notes.append("process.viscosity_mpa_s: the simulated bonnet has no dissipative stress")
    if compliance.frame != "surface" or compliance.moment != "full":
        draft.notes.append(
            f"compliance.frame = {compliance.frame!r}, moment = {compliance.moment!r}: the simulated robot gives way "
            "as its tip truly does, along the part's normal"
        )
    if isinstance(config.kinematics, MeasuredSection):
        draft.notes.append(
            "kinematics.type = 'measured': where it can be is not known; the simulated one goes everywhere"
        )


# The instrument: its folder, and a copy of its profile, which the simulated artefact proves anew.

PROFILE = "instrument.toml"


def add_instrument(draft: RehearsalDraft, device: str) -> None:
    """Folder and profile of the instrument."""
    _add_folder(draft, device)
    shipped = (resources.files("polishd.commissioning.rehearsal") / "demo_data" / PROFILE).read_text(encoding="utf-8")
    path = draft.config.profile_path
    if path is None:
        draft.notes.append("instrument.profile: there is none; the rehearsal has that of polishd demo")
        text, path = shipped, Path(PROFILE)
    else:
        text = toml_text(path)
    profile = ProfileFile.of(*loads_toml(text, path))
    document = tomlkit.parse(text)
    _mend(draft, document, profile)
    if profile.artefact is None or any(bump.angle_deg for bump in profile.artefact.bumps):
        draft.notes.append("instrument.profile: the simulated artefact has no bumps like yours; it has the demo's")
        document["artefact"] = tomlkit.parse(shipped)["artefact"]
    draft.files[PROFILE] = tomlkit.dumps(document).encode()
    draft.overrides["instrument.profile"] = PROFILE


def _add_folder(draft: RehearsalDraft, device: str) -> None:
    folder = f"{SIM_STATE}/maps"
    if not is_simulated(draft, device, folder=folder):
        return
    options = draft.options(device)
    draft.overrides[f"{device}.folder"] = folder
    for key in ("claimed_dir", "refused_dir"):
        named = Path(options.get(key) or "")
        if named.is_absolute() or ".." in named.parts:
            draft.instead(f"{device}.{key}", None, "is a folder of the real cell's")
    request = options.get("request_file", REQUEST)
    if request is None or Path(request).is_absolute() or len(Path(request).parts) > 1:
        draft.instead(f"{device}.request_file", REQUEST, "the simulated instrument measures on a request in its folder")
        request = REQUEST
    if put_kind(draft, device):
        draft.put("interferometer", "request_file", str(request), f"{device}.request_file")


def _mend(draft: RehearsalDraft, document: tomlkit.TOMLDocument, profile: ProfileFile) -> None:
    """Take out of the profile's copy what a simulated instrument cannot have, by name."""
    document.pop("commissioned", None)

    def leave_out(table: str, key: str, why: str) -> None:
        draft.notes.append(f"{key} of instrument.profile: {why}; it is left out of the copy")
        (document[table] if table else document).pop(key.rpartition(".")[2])

    if profile.serials:
        leave_out("", "serials", "the simulated instrument has no serial number")
    diameter_mm = profile.aperture.diameter_mm
    if diameter_mm is not None and draft.config.outline() != Circle(diameter_mm / 2):
        leave_out("aperture", "aperture.diameter_mm", "simulated maps show the whole part")
    if profile.registration.by in {"fiducials", "both"}:
        leave_out("registration", "registration.by", "the simulated part has no marks, and lies in the array's centre")
    pitch_mm = profile.lateral.pitch_mm
    if pitch_mm is not None and not FINEST_MM <= pitch_mm <= COARSEST_MM:
        room = f"{FINEST_MM:g} to {COARSEST_MM:g} mm"
        leave_out("lateral", "lateral.pitch_mm", f"simulated maps have a pitch of {room}, and say it")


# The verb: reads a cell, gathers, refuses, writes both files, proves the instrument, starts what is simulated.


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """What was written."""

    sim: Path
    cell: Path
    notes: tuple[str, ...]
    """Differences between the simulated cell and the real one."""


SIM_OPTIONS = ("--speed", "--seed", "--surface", "--only", "--device")
"""Options of the simulator that ``polishd rehearse`` passes on."""


def rehearsal_verb(cell: Path, out: Path | None, options: Sequence[str], *, write_only: bool) -> int:
    """Write the rehearsal of a cell and, unless ``write_only``, start its simulator; the exit code."""
    if any(option.partition("=")[0] in {"--state", "--artefact"} for option in options):
        raise ConfigError("--state and --artefact do not go with rehearse, which has its own folders; use --out")
    names = [option.partition("=")[0] for option in options if option.startswith("--")]
    if unknown := next((name for name in names if name not in SIM_OPTIONS), None):
        raise ConfigError(
            f"{unknown}: the simulator has no such option{did_you_mean(unknown, SIM_OPTIONS)} "
            f"Use {', '.join(SIM_OPTIONS)}; nothing was written"
        )
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
    require_separate_folders(draft, folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    own = f"{cell.stem}-rehearsal.toml"
    try:
        with tempfile.TemporaryDirectory(prefix=".polishd-", dir=folder.parent) as scratch:
            beside = Path(scratch) / "rehearsal"  # it appears whole, or not at all
            beside.mkdir()
            _write(draft, beside, own)
            beside.replace(folder)
    except OSError as error:
        raise unwritable_message(folder, error) from error
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


ONE_OF_A_PORT: dict[str, Callable[[RehearsalDraft, str], None]] = {
    "robot": add_robot,
    "actuator": add_actuator,
    "spindle": add_spindle,
    "metrology": add_instrument,
    "loader": add_line,
    "force_sensor": add_line,
}


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
    draft.overrides["cell.state_dir"] = STATE
    if draft.config.run_dir is not None:
        draft.overrides["cell.run_dir"] = "run"


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
