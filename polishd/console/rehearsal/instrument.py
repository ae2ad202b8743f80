"""The instrument of a cell, as the simulator has it: its folder, and maps that lie as the cell's profile says."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from pathlib import Path

import tomlkit

from polishd.config.document import loads_toml
from polishd.config.profile_sections import ProfileFile
from polishd.console.rehearsal.draft import SIM_STATE, RehearsalDraft
from polishd.files import toml_text
from polishd.model.outline import Circle

PROFILE = "instrument.toml"
REQUEST = "measure.request"
FINEST_MM, COARSEST_MM = 0.2, 1.0
"""Spacing of maps that a simulated part can have in a sensible time."""
USUAL_ARTEFACT_MM = 100.0


def add_instrument(draft: RehearsalDraft, device: str) -> None:
    """``[interferometer]``, and a copy of the cell's profile, which its artefact proves anew."""
    _add_folder(draft, device)
    shipped = (resources.files("polishd.console") / "demo_data" / PROFILE).read_text(encoding="utf-8")
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
    if kind != "watched_folder":
        instead = {"type": "watched_folder", "folder": folder, "request_file": REQUEST, "stable_s": 0.3, "poll_s": 0.1}
        draft.replace_device(device, instead, f"there is no simulated {kind!r}")
        draft.plugin("interferometer")
        draft.put("interferometer", "request_file", REQUEST, f"stands in for {kind}")
        return
    options = draft.options(device)
    draft.laid[f"{device}.folder"] = folder
    for key in ("claimed", "refused"):
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
