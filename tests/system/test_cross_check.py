"""The controller's physics and program reader against the simulator's own: two laws, written apart, that must agree.

They share the nouns (`polishd.model`), and nothing else.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import Program
from polishd.config.simulator_physics import Plant, Truth
from polishd.model.errors import ProgramError
from polishd.model.process import HybridRobot, Placement, ToolProcess
from polishd.model.surface import FloatArray, Grid, SurfaceMap
from polishd.pipeline import steps
from polishd.process import frames as controller_frames
from polishd.process.metrology import conditioning
from polishd.process.metrology.resampling import Registration
from polishd.process.removal import contact
from polishd.process.removal.dynamic_tif import effect_matrix, tif_at_point
from polishd.process.removal.tif import HertzSpot
from polishd.process.robot.compliance import depth_ratio, path_compliance, tip_compliance_mm_per_n
from polishd.process.robot.compliance import equivalent_compliance as controller_compliance
from polishd.sim_backends.common import hidden_truth
from polishd.sim_backends.common.hidden_truth import Frames, rotation_rpy, tool_axis
from polishd.sim_backends.plant import part as parts
from polishd.sim_backends.plant.tool import given_way, hertz_depth_mm, wear, worn_depth_mm
from polishd.sim_backends.robot.program_reader import Reader
from tests.rs274 import read
from tests.unit.plugins.rnc_robot.test_traps_rs274 import BAD, GOOD, Bad, Good

ROBOT = HybridRobot()
PLANT = Plant(origin_mm=(60.0, -40.0, 2080.0))
PLACEMENT = Placement(PLANT.origin_mm, rotation_rpy(PLANT.rotation_rpy_deg))
ONE = np.ones(1)

PROCESSES = {
    "the paper's": ToolProcess(),
    "gentle": ToolProcess(force_n=4.0, rpm=300.0),
    "hard": ToolProcess(force_n=25.0, rpm=2000.0),
    "steep": ToolProcess(dip_deg=30.0),
    "small bonnet": ToolProcess(tool_radius_mm=10.0, force_n=6.0, dip_deg=20.0),
    "stiff bonnet": ToolProcess(tool_modulus_mpa=60.0, tool_poisson=0.3, preston_cm2_per_n=3e-9),
}
POSES = [(0.0, 0.0, 0.0), (30.0, -20.0, 45.0), (-45.0, 10.0, 200.0), (12.5, 40.25, -90.0), (-3.3, -44.4, 131.0)]
"""X, Y in mm and C in degrees, program frame."""


def worn_nm_s(tool: ToolProcess, grid: Grid, axis: FloatArray, depth_mm: FloatArray, xy: FloatArray) -> FloatArray:
    """Return the simulator's removal of one second at each of the contacts, positive, (ny, nx)."""
    surface = np.zeros(grid.shape)
    n = len(xy)
    wear(surface, grid, tool, centre_mm=xy, axis=axis, depth_mm=depth_mm, rpm=np.full(n, tool.rpm), seconds=np.ones(n))
    return -surface


def program_at(poses: list[tuple[float, float, float]], dip_deg: float) -> Program:
    """Return a program that dwells for a second at each pose."""
    text = b"G21 G90 G94\nG0 X0 Y0 Z0 A0 C0\nF600\n"
    for x, y, c in poses:
        text += b"G1 X%.4f Y%.4f Z0 A%.4f C%.4f\nG4 P1\n" % (x + 1.0, y, dip_deg, c)
        text += b"G1 X%.4f\nG4 P1\n" % x
    found = read(text + b"M2\n", "poses.rnc")
    keep = slice(1, None, 2)
    return replace(
        found,
        **{
            name: getattr(found, name)[keep] for name in ("line", "block", "start_mm", "end_mm", "axis", "time_s")
        },
    )  # fmt: skip


@pytest.mark.parametrize("process", PROCESSES.values(), ids=PROCESSES.keys())
def test_depth_radius_and_peak_pressure_of_the_rigid_contact(process: ToolProcess) -> None:
    theirs = float(hertz_depth_mm(process, np.array([process.force_n]))[0])
    ours = contact.hertz_depth_mm(process)
    assert ours == pytest.approx(theirs, rel=1e-12)
    assert float(contact.contact_radius_mm(process, ours)) == pytest.approx(np.sqrt(process.tool_radius_mm * theirs))


@pytest.mark.parametrize("gamma", [1.0, 0.95, 0.8, 0.5])
@pytest.mark.parametrize("process", PROCESSES.values(), ids=PROCESSES.keys())
def test_volume_peak_and_extent_of_the_spot(process: ToolProcess, gamma: float) -> None:
    depth = gamma * contact.hertz_depth_mm(process)
    radius = float(contact.contact_radius_mm(process, depth))
    grid = Grid(161, 161, 2.4 * radius / 160)
    axis = tool_axis(np.array([process.dip_deg]), np.array([70.0]))
    worn = worn_nm_s(process, grid, axis, np.array([depth]), np.zeros((1, 2)))
    volume = float(contact.volume_rate_nm_mm2_s(process, depth)[0])
    assert worn.sum() * grid.pitch_mm**2 == pytest.approx(volume, rel=2e-3)
    # the tool's frame: y where the spindle leans, x = y cross z
    lean = axis[0, :2] / np.linalg.norm(axis[0, :2])
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    rate = contact.removal_rate_nm_s(process, depth, lean[1] * x - lean[0] * y, lean[0] * x + lean[1] * y)
    assert worn.max() == pytest.approx(rate.max(), rel=3e-3)
    # the plant knows no dissipative shift (a few um): only the rim, where the rate falls steeply, may show it
    inside = np.hypot(x, y) < 0.95 * radius
    assert np.abs(worn - rate)[inside].max() < 0.01 * rate.max()
    assert np.abs(worn - rate).mean() < 0.002 * rate.max()
    touched = np.hypot(x, y)[worn > 0.02 * worn.max()].max()
    assert touched == pytest.approx(radius, rel=0.03)


@pytest.mark.parametrize("process", PROCESSES.values(), ids=PROCESSES.keys())
def test_gamma_at_poses_over_the_part(process: ToolProcess) -> None:
    program = program_at(POSES, process.dip_deg)
    compliance = path_compliance(program, process, ROBOT, PLACEMENT).compliance_mm_per_n
    ours = depth_ratio(compliance, process, contact.hertz_depth_mm(process))
    pose = np.array([[x, y, 0.0, process.dip_deg, c] for x, y, c in POSES])
    world = Frames(PLANT)
    tips, axes = world.in_part(pose)
    theirs_c = given_way(ROBOT, *world.in_base(tips, axes), world.to_base[:, 2]).along
    rigid = hertz_depth_mm(process, np.full(len(pose), process.force_n))
    theirs = worn_depth_mm(process, np.full(len(pose), process.force_n), axes, theirs_c) / rigid
    np.testing.assert_allclose(compliance, theirs_c, rtol=1e-6)
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)
    assert (theirs < 0.99).all(), "the robot gives way, or nothing is compared here"
    assert np.ptp(theirs) > 0.002


@pytest.mark.parametrize("name", ["the paper's", "hard", "small bonnet"])
def test_the_effect_matrix_is_what_the_plant_removes(name: str) -> None:
    """Pose by pose, on the plant's own grid: text, geometry, compliance, contact and cell averages in one."""
    process = PROCESSES[name]
    grid = Grid(221, 221, 0.5)
    program = program_at(POSES, process.dip_deg)
    compliance = path_compliance(program, process, ROBOT, PLACEMENT).compliance_mm_per_n
    spots = tif_at_point("exact", depth_ratio(compliance, process, contact.hertz_depth_mm(process)))
    effect = effect_matrix(grid, HertzSpot(process), program, spots.depth_ratio, spots.factor)
    world = Frames(PLANT)
    tips, axes = world.in_part(np.array([[x, y, 0.0, process.dip_deg, c] for x, y, c in POSES]))
    theirs_c = given_way(ROBOT, *world.in_base(tips, axes), world.to_base[:, 2]).along
    worn_depth = worn_depth_mm(process, np.full(len(tips), process.force_n), axes, theirs_c)
    for k in range(len(POSES)):
        one = slice(k, k + 1)
        theirs = worn_nm_s(process, grid, axes[one], worn_depth[one], tips[one, :2])
        ours = np.asarray(effect[:, [k]].todense()).reshape(grid.shape)
        # the plant integrates by midpoints 1/6 mm apart, the controller exactly
        assert ours.sum() == pytest.approx(theirs.sum(), rel=6e-3)
        assert np.abs(ours - theirs).max() / theirs.max() < 0.03
        row, column = np.unravel_index(np.argmax(theirs), theirs.shape)
        assert np.hypot(grid.x_mm[column] - POSES[k][0], grid.y_mm[row] - POSES[k][1]) < 2.0


def test_a_moving_block_removes_what_many_short_stops_along_it_remove() -> None:
    process = ToolProcess()
    text = b"G21 G90 G94\nG0 X-5 Y2 Z0 A15 C60\nG1 X7 Y-3 F120\nM2\n"
    program = read(text, "move.rnc")
    grid = Grid(81, 81, 0.5)
    effect = effect_matrix(grid, HertzSpot(process), program, ONE, ONE)
    ours = np.asarray(effect @ program.time_s).reshape(grid.shape)
    share = (np.arange(260) + 0.5) / 260
    xy = program.start_mm[:, :2] + share[:, None] * (program.end_mm - program.start_mm)[:, :2]
    axis = np.tile(tool_axis(np.array([15.0]), np.array([60.0])), (260, 1))
    depth = np.full(260, contact.hertz_depth_mm(process))
    theirs = worn_nm_s(process, grid, axis, depth, xy) * program.time_s[0] / 260
    assert ours.sum() == pytest.approx(theirs.sum(), rel=2e-3)
    assert np.abs(ours - theirs).max() < 0.015 * theirs.max()


@pytest.mark.parametrize("seed", [None, 1, 2, 3])
def test_compliance_projection_on_random_poses_placements_and_robots(seed: int | None) -> None:
    """Linear projection (eq. 43) of both sides, also of the hidden robots that the simulator draws."""
    robot = ROBOT if seed is None else hidden_truth.draw(Truth(), seed).robot
    rng = np.random.default_rng(seed or 0)
    for rpy in ((180.0, 0.0, 0.0), (175.0, 8.0, 30.0), (187.0, -6.0, -120.0)):
        plant = Plant(origin_mm=(-40.0, 60.0, 2090.0), rotation_rpy_deg=rpy, program_rotation_deg=25.0)
        world = Frames(plant)
        placement = Placement(plant.origin_mm, controller_frames.rotation_from_rpy_deg(*rpy))
        pose = np.column_stack(
            [rng.uniform(-60, 60, (40, 2)), rng.uniform(-1, 1, 40), rng.uniform(5, 30, 40), rng.uniform(-180, 180, 40)]
        )
        tips, axes = world.in_part(pose)
        base_tips, base_axes = world.in_base(tips, axes)
        np.testing.assert_allclose(controller_frames.points_to_base(placement, tips), base_tips, atol=1e-9)
        np.testing.assert_allclose(controller_frames.directions_to_base(placement, axes), base_axes, atol=1e-12)
        theirs = given_way(robot, base_tips, base_axes, world.to_base[:, 2]).along
        normals = controller_frames.surface_normals(placement, np.zeros_like(tips))
        ours = controller_compliance(tip_compliance_mm_per_n(robot, base_tips, base_axes), base_axes, normals)
        assert (theirs > 0).all(), "all of these poses are within reach"
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)


@pytest.mark.parametrize("pitch_mm", [0.5, 0.50000002, 0.49999998, 0.3])
@pytest.mark.parametrize("aperture_mm", [30.0, 50.0])
def test_the_stated_rms_is_the_plants_own(aperture_mm: float, pitch_mm: float) -> None:
    """Over the same clear aperture, although the process grid lies half a sample beside the map's."""
    plant = Plant(aperture_mm=aperture_mm, pv_nm=100.0, pitch_mm=pitch_mm)
    part = parts.make(plant, 3)
    shown = SurfaceMap(height_nm=part.map_nm(), pitch_mm=pitch_mm)
    conditioned = conditioning.condition(shown, outline=plant.outline, edge_mm=plant.edge_mm, grid_mm=0.5)
    clear = steps.on_map(shown, conditioned.grid, conditioned.metric_mask, Registration())
    assert clear.sum() == pytest.approx(part.clear.sum(), rel=0.03)
    assert part.map_nm()[clear].std() == pytest.approx(part.stats()[0], rel=0.015)


@given(a=st.floats(-60, 60), c=st.floats(-360, 360))
def test_tool_axes_of_a_and_c(a: float, c: float) -> None:
    theirs = tool_axis(np.array([a]), np.array([c]))
    back = controller_frames.angles_from_axis(theirs)
    np.testing.assert_allclose(tool_axis(*back), theirs, atol=1e-9)


def simulated(text: bytes) -> tuple[dict[int, float], list[tuple[float, ...]]]:
    """Return the seconds of each line as the simulated controller reads it, and the poses after each line."""
    reader = Reader((0.0, 0.0, 0.0, 0.0, 0.0))
    seconds: dict[int, float] = {}
    poses = [reader.pose]
    for number, line in enumerate(text.split(b"\n"), 1):
        block = reader.read(line)
        poses.append(block.end)
        if block.kind == "dwell" or (block.kind == "move" and block.inverse):
            seconds[number] = block.rate
        elif block.kind == "move" and block.rate > 0.0:
            seconds[number] = float(np.linalg.norm(np.subtract(poses[-1], poses[-2])[:3])) / block.rate
    return seconds, poses


@pytest.mark.parametrize("trap", GOOD, ids=lambda trap: trap.name)
def test_both_readers_find_the_same_seconds_in_the_trap_corpus(trap: Good) -> None:
    """The machine runs exactly the planned times, and refuses no program that was planned."""
    seconds, _ = simulated(trap.text)
    assert [seconds[line] for line in trap.lines] == pytest.approx(trap.seconds, rel=1e-12)


SEEN_OTHERWISE = {
    "two dwells at one point",
    "no end: the file may be cut",
    "cut inside a number",
    "SINUMERIK F beside P",
    "G93 and G94 in one file",
    "a dwell in an inverse-time file",
    "G91 from nowhere",
    "an absolute move from nowhere",
    "turning on the spot at mm/min",
    "a wait for a person",
    "F beside a change to inches",
    "F does not outlive a change to inches",
}
"""Programs that only the controller accepts: it knows its position, and changes no number of the program."""


@pytest.mark.parametrize("trap", [t for t in BAD if t.name not in SEEN_OTHERWISE], ids=lambda trap: trap.name)
def test_an_unreadable_program_is_refused_by_the_machine_too(trap: Bad) -> None:
    with pytest.raises(ProgramError):
        simulated(trap.text)


@st.composite
def programs(draw: st.DrawFn) -> bytes:
    """Draw a program of one encoding, in words that both readers support."""
    encoding = draw(st.sampled_from(["feed", "dwell", "inverse"]))
    lines = [draw(st.sampled_from(["G21 G90 G94", "G90 G94", "N5 G20 G90", "g21g90g94 (a)"])), "G0 X0 Y0 Z0 A10 C0"]
    lines.append("G93" if encoding == "inverse" else f"F{draw(st.integers(1, 3000))}")
    for number in range(draw(st.integers(1, 8))):
        words = ["G1"] + [f"{axis}{draw(st.floats(-20, 20)):.3f}" for axis in draw(st.sets(st.sampled_from("YZC")))]
        # each goes somewhere: turning on the spot is refused by the planner
        words.append(f"X{21 + number + draw(st.floats(0, 0.9)):.2f}")
        if encoding == "inverse" or (encoding == "feed" and draw(st.booleans())):
            words.append(f"F{draw(st.floats(0.5, 2000)):.2f}")
        line = draw(st.sampled_from([" ", "", "\t"])).join(words)
        lines.append(draw(st.sampled_from([line, line.lower(), line + " ; F9", "(F9) " + line])))
        if encoding == "dwell":
            lines.append(draw(st.sampled_from(["G4 P%.3f", "g4p%.2f", "P%.4f G4"])) % draw(st.floats(0, 99)))
    return "\n".join([*lines, "M2", ""]).encode()


@pytest.mark.full
@given(programs())
def test_both_readers_find_the_same_seconds_and_places(text: bytes) -> None:
    found = read(text, "t.rnc")
    seconds, poses = simulated(text)
    np.testing.assert_allclose([seconds[int(line)] for line in found.line], found.time_s, rtol=1e-9)
    ends = np.array([poses[int(line)] for line in found.line])
    np.testing.assert_allclose(found.end_mm, ends[:, :3], atol=1e-9)
    np.testing.assert_allclose(found.axis, tool_axis(ends[:, 3], ends[:, 4]), atol=1e-12)
    assert all(a < b for a, b in pairwise(found.line.tolist()))
