"""What is physical of a cell, as the simulator has it: part, place, tool, spot, robot."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import tomlkit

from polishd.commissioning.rehearsal.draft import SIM_STATE, RehearsalDraft
from polishd.config.fields import as_keys
from polishd.config.instrument_profile import ProfileFile
from polishd.config.process_sections import MeasuredSection
from polishd.config.simulator import Truth
from polishd.config.toml_loader import loads_toml
from polishd.model.outline import Circle
from polishd.model.process import ToolProcess
from polishd.process.frames import rotation_from_rpy_deg
from polishd.util.files import toml_text

PLANT = ("edge_mm", "curvature_radius_mm", "conic", "even", "off_axis_mm", "origin_mm")
CONTACT = (
    "tool_radius_mm", "normal_force", "spot_offset_mm", "tool_modulus_mpa", "tool_poisson", "part_modulus_mpa",
    "part_poisson",
)  # fmt: skip
START_OVER_TOLERANCE = 9.0
"""RMS of the part at the start, over the tolerance: as in the demo."""
PV_OVER_RMS = 8.3
OF_MOST_REMOVAL = 0.5
"""Peak to valley at the start, at most, over what one pass may remove."""
MORE_ACCEL = 1.25
"""What the robot truly accelerates with, over what the cell counts on, which is on the safe side."""
LONGEST_NAME = 39
"""Bytes of a part's name in the simulated instrument's files."""


def add_part(draft: RehearsalDraft, speed: float) -> None:
    """``[plant]`` and ``[hidden_truth]``."""
    part, program, job = draft.config.part, draft.config.program, draft.config.job
    if len(part.id.encode()) > LONGEST_NAME:
        raise draft.config.error("part.id", f"is longer than the {LONGEST_NAME} bytes that a MetroPro map has room for")
    draft.put("plant", "seed", 1, "--seed: the hidden truth is drawn from it")
    draft.put("plant", "speed", speed, "--speed: process seconds per wall second")
    draft.put("plant", "part_id", part.id, "part.id")
    said = part.outline_key
    if said == "polygon_file":
        for key, value in as_keys(draft.config.outline()).items():
            draft.put("plant", key, value, f"part.{said}")
    else:
        draft.take("plant", (said, "hole_mm"), "part", part)
    draft.take("plant", PLANT, "part", part)
    draft.put("plant", "rotation_rpy_deg", part.rotation_rpy_deg, "part.rotation_rpy_deg")
    draft.put("plant", "program_offset_mm", program.offset_mm, draft.origin("program.offset_mm"))
    draft.put("plant", "program_rotation_deg", program.rotation_deg, draft.origin("program.rotation_deg"))
    if job.tolerance_nm is not None:
        _add_start(draft, job.tolerance_nm)
    if part.free_edge:
        draft.notes.append("part.free_edge: the simulated part sits in a flush ring; no tool sinks over its rim")
    if part.form is not None:
        draft.instead("part.form", None, "the simulated instrument shows the part as behind a null, without its form")
    _add_truth(draft)


def _add_start(draft: RehearsalDraft, tolerance_nm: float) -> None:
    """A surface that the job can polish: worse than its tolerance, and within what one pass may take off."""
    most_nm = OF_MOST_REMOVAL * draft.config.limits.max_removal_nm
    rms_nm = min(START_OVER_TOLERANCE * tolerance_nm, most_nm / PV_OVER_RMS)
    origin = f"{START_OVER_TOLERANCE:g} x job.tolerance_nm, or what limits.max_removal_nm lets; or --surface MAP.dat"
    draft.put("plant", "rms_nm", round(rms_nm, 3), origin)
    draft.put("plant", "pv_nm", round(PV_OVER_RMS * rms_nm, 3), f"{PV_OVER_RMS:g} x rms_nm")


def _add_truth(draft: RehearsalDraft) -> None:
    """The hidden truth: how far the machines are off the cell's model."""
    machine, hidden = draft.config.machine, Truth()
    for key in ("rate", "stiffness", "drift", "force_noise", "map_noise_nm"):
        draft.put(
            "hidden_truth",
            key,
            getattr(hidden, key),
            "the cell does not know: drawn from the seed; 0: a perfect machine",
        )
    accel = MORE_ACCEL * machine.accel_mm_s2
    draft.put("hidden_truth", "accel_mm_s2", accel, f"{MORE_ACCEL:g} x machine.accel_mm_s2, which is on the safe side")
    if machine.block_overhead_s:
        draft.put("hidden_truth", "overhead_s", machine.block_overhead_s, draft.origin("machine.block_overhead_s"))


def add_process(draft: RehearsalDraft) -> None:
    """``[process]``: what the tool removes."""
    process, compliance = draft.config.process, draft.config.compliance
    draft.take("process", CONTACT, "process", process)
    draft.put("process", "preston", f"{process.preston!r} cm2/N", draft.origin("process.preston"))
    draft.put("process", "projection", compliance.projection, draft.origin("compliance.projection"))
    if process.removal_model == "measured_tif" and process.tif is not None:
        draft.config.measured_tif()
        draft.put("process", "tif", draft.copy("tif.npz", draft.config.resolve(process.tif)), "a copy of process.tif")
        draft.take("process", ("force_n", "rpm", "dip_deg"), "process", process)
        if process.depth_exponent != ToolProcess().depth_exponent:
            exponent = f"process.depth_exponent = {process.depth_exponent:g}"
            draft.notes.append(f"{exponent}: the simulated spot's volume goes as depth to the 1.5, as Hertz has it")
    elif process.removal_model != "hertz_preston":
        draft.notes.append(
            f"process.removal_model = {process.removal_model!r}: the simulator has it not; hertz_preston stands in for "
            "it, with the tool and the Preston constant of [process]"
        )
    _say_what_is_not_so(draft)


def _say_what_is_not_so(draft: RehearsalDraft) -> None:
    process, compliance, usual = draft.config.process, draft.config.compliance, ToolProcess()
    viscous = ("viscosity_mpa_s", "second_viscosity_mpa_s", "lame_mpa")
    if any(getattr(process, name) != getattr(usual, name) for name in viscous):
        draft.notes.append("process.viscosity_mpa_s: the simulated bonnet has no dissipative stress")
    if compliance.frame != "surface" or compliance.moment != "full":
        draft.notes.append(
            f"compliance.frame = {compliance.frame!r}, moment = {compliance.moment!r}: the simulated robot gives way "
            "as its tip truly does, along the part's normal"
        )


def add_kinematics(draft: RehearsalDraft) -> None:
    """``[kinematics]``: the robot, and its stiffness as the cell has it calibrated."""
    section = draft.config.kinematics
    draft.config.robot_model()
    draft.put("kinematics", "type", section.type, draft.origin("kinematics.type"))
    if isinstance(section, MeasuredSection):
        table = draft.copy("compliance.csv", draft.config.resolve(section.table))
        draft.put("kinematics", "table", table, "a copy of kinematics.table")
        draft.notes.append(
            "kinematics.type = 'measured': where it can be is not known; the simulated one goes everywhere"
        )
        return
    for key, value in section:
        if key != "type" and value is not None:
            draft.put("kinematics", key, value, draft.origin(f"kinematics.{key}"))


def home(draft: RehearsalDraft) -> tuple[float, float, float, float, float]:
    """Over the part's centre, as high as the program may go: X Y Z A C of the program's frame."""
    program, machine = draft.config.program, draft.config.machine
    turn = rotation_from_rpy_deg(0.0, 0.0, program.rotation_deg)
    x, y, _ = (turn.T @ -np.array(program.offset_mm)).tolist()
    low, high = machine.x_mm, machine.y_mm
    x, y = (min(max(round(value, 6), ends[0]), ends[1]) + 0.0 for value, ends in ((x, low), (y, high)))
    return x, y, machine.z_mm[1], 0.0, 0.0


def most_a_deg(draft: RehearsalDraft) -> float:
    """How far the tool leans on the part: its dip, the part's slope, and some room."""
    part = draft.config.part
    slope = 0.0
    if part.curvature_radius_mm is not None:
        share = (draft.config.outline().radius_mm + math.hypot(*part.off_axis_mm)) / abs(part.curvature_radius_mm)
        slope = math.degrees(math.asin(min(share, 1.0)))
    return max(60.0, math.ceil(draft.config.process.dip_deg + slope + 15.0))


def require_force(draft: RehearsalDraft, most_n: float) -> None:
    """ConfigError where the simulated actuator cannot press so."""
    if draft.config.process.force_n > most_n:
        raise draft.config.error("process.force_n", f"the simulated actuator presses with {most_n:g} N at most")


# The instrument of a cell, as the simulator has it: its folder, and maps that lie as the cell's profile says.

PROFILE = "instrument.toml"
REQUEST = "measure.request"
FINEST_MM, COARSEST_MM = 0.2, 1.0
"""Spacing of maps that a simulated part can have in a sensible time."""
USUAL_ARTEFACT_MM = 100.0


def add_instrument(draft: RehearsalDraft, device: str) -> None:
    """``[interferometer]``, and a copy of the cell's profile, which its artefact proves anew."""
    _add_folder(draft, device)
    shipped = (resources.files("polishd.commissioning.rehearsal") / "demo_data" / PROFILE).read_text(encoding="utf-8")
    path = draft.config.profile_path
    if path is None:
        draft.notes.append("instrument.profile: there is none; that of polishd demo stands in for it")
        text, path = shipped, Path(PROFILE)
    else:
        text = toml_text(path)
    profile = ProfileFile.of(*loads_toml(text, path))
    example = ProfileFile.of(*loads_toml(shipped, Path(PROFILE)))
    document = tomlkit.parse(text)
    _mend(draft, document, profile)
    _add_maps(draft, profile)
    if profile.artefact is None or any(bump.angle_deg for bump in profile.artefact.bumps):
        draft.notes.append(
            "instrument.profile: the simulated artefact has no bumps like yours; the demo's stand in for them"
        )
        document["artefact"] = tomlkit.parse(shipped)["artefact"]
        profile = example
    _add_artefact(draft, profile)
    draft.files[PROFILE] = tomlkit.dumps(document).encode()
    draft.laid["instrument.profile"] = PROFILE


def _add_folder(draft: RehearsalDraft, device: str) -> None:
    kind, folder = draft.config.devices[device].type, f"{SIM_STATE}/maps"
    if not draft.device_type(device).simulated_by:
        draft.replace_device(device, folder=folder, request_file=REQUEST, stable_s=0.3, poll_s=0.1)
        draft.put("interferometer", "request_file", REQUEST, f"replaces {kind}")
        return
    options = draft.options(device)
    draft.laid[f"{device}.folder"] = folder
    for key in ("claimed_dir", "refused_dir"):
        if Path(options[key]).is_absolute() or ".." in Path(options[key]).parts:
            draft.instead(f"{device}.{key}", None, "is a folder of the real cell's")
    request = options["request_file"]
    if request is None or Path(request).is_absolute() or len(Path(request).parts) > 1:
        draft.instead(
            f"{device}.request_file", REQUEST, "the simulated instrument measures when it is asked in its folder"
        )
        request = REQUEST
    draft.put("interferometer", "request_file", str(request), draft.origin(f"{device}.request_file"))


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
    _take_pitch(draft, profile, leave_out)


def _take_pitch(draft: RehearsalDraft, profile: ProfileFile, leave_out: Callable[[str, str, str], None]) -> None:
    pitch_mm = profile.lateral.pitch_mm
    if pitch_mm is None:
        return
    if FINEST_MM <= pitch_mm <= COARSEST_MM:
        draft.put("plant", "pitch_mm", pitch_mm, "lateral.pitch_mm of instrument.profile")
    else:
        room = f"{FINEST_MM:g} to {COARSEST_MM:g} mm"
        leave_out("lateral", "lateral.pitch_mm", f"simulated maps have a pitch of {room}, and say it")


def _add_maps(draft: RehearsalDraft, profile: ProfileFile) -> None:
    """Arrays and numbers such that the profile puts them right."""
    turn, height = profile.orientation, profile.height
    back_deg = turn.rotation_deg if turn.mirror else -turn.rotation_deg % 360
    for key, value, origin in (
        ("mirror", turn.mirror, "orientation.mirror"),
        ("rotation_deg", back_deg, "undone by orientation.rotation_deg"),
        ("sign", height.sign, "height.sign"),
        ("factor", 1.0 / height.factor, "1 / height.factor"),
    ):
        draft.put("interferometer.faults", key, value, f"{origin} of instrument.profile")


def _add_artefact(draft: RehearsalDraft, profile: ProfileFile) -> None:
    if profile.artefact is None:
        return
    bumps = [bump.model_dump(exclude={"angle_deg"}) for bump in profile.artefact.bumps]
    farthest_mm = max(max(abs(b["x_mm"]), abs(b["y_mm"])) + 3 * max(b["sigma_x_mm"], b["sigma_y_mm"]) for b in bumps)
    draft.put("interferometer.artefact", "bumps", bumps, "artefact.bumps of instrument.profile")
    size_mm = max(USUAL_ARTEFACT_MM, 2.0 * farthest_mm)
    draft.put("interferometer.artefact", "diameter_mm", size_mm, "holds all of its bumps")
