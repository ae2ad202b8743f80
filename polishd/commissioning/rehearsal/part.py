"""Part, process and instrument of a rehearsal: the surface at the start, and notes on what is not simulated."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import tomlkit

from polishd.commissioning.rehearsal.devices import is_simulated
from polishd.commissioning.rehearsal.draft import REQUEST, SIM_STATE, RehearsalDraft, put_kind
from polishd.config.instrument_profile import ProfileFile
from polishd.config.process_sections import MeasuredSection
from polishd.config.simulator import Truth
from polishd.config.simulator_cell import COARSEST_MM, FINEST_MM, MORE_ACCEL
from polishd.config.toml_loader import loads_toml
from polishd.model.outline import Circle
from polishd.model.process import ToolProcess
from polishd.util.files import toml_text

START_OVER_TOLERANCE = 9.0
"""RMS of the part at the start, over the tolerance: as in the demo."""
PV_OVER_RMS = 8.3
OF_MOST_REMOVAL = 0.5
"""Peak to valley at the start, at most, over what one pass may remove."""
LONGEST_NAME = 39
"""Bytes of a part's name in the simulated instrument's files."""


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
    draft.laid["instrument.profile"] = PROFILE


def _add_folder(draft: RehearsalDraft, device: str) -> None:
    folder = f"{SIM_STATE}/maps"
    if not is_simulated(draft, device, folder=folder):
        return
    options = draft.options(device)
    draft.laid[f"{device}.folder"] = folder
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
