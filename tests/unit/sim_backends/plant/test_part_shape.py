"""The plant on parts that are not flat: its own surface, contact and wear, held to the controller's closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from polishd.config.simulator import SimConfig
from polishd.config.simulator_physics import Plant, SimContactSection, Truth
from polishd.config.toml_loader import TomlSource
from polishd.model.errors import ConfigError
from polishd.model.process import MeasuredCompliance, MeasuredTif, Optic, SerialRobot, ToolProcess
from polishd.model.surface import FloatArray, Grid
from polishd.process.optic_surface import sag_mm, unit_normals
from polishd.process.removal.tif import measured_spot
from polishd.process.robot.compliance import measured_compliance, tip_compliance_mm_per_n
from polishd.sim_backends.common import hidden_truth
from polishd.sim_backends.common.hidden_truth import tool_axis
from polishd.sim_backends.plant.part import Shape
from polishd.sim_backends.plant.tool import MeasuredStamp, contact_radius_mm, giving, hertz_depth_mm, wear

SPHERE = {"curvature_radius_mm": 800.0}
OPTICS = {
    "concave sphere": SPHERE,
    "convex ellipsoid": {"curvature_radius_mm": -300.0, "conic": 0.4},
    "asphere": {"curvature_radius_mm": 300.0, "conic": -1.0, "even": (1e-8, -1e-13)},
    "piece off the axis": {"curvature_radius_mm": 500.0, "conic": -0.6, "even": (2e-9,), "off_axis_mm": (80.0, -40.0)},
    "plate with an r^4": {"even": (1e-7,)},
}
TOOL = ToolProcess()


def places(n: int = 40) -> FloatArray:
    return np.random.default_rng(1).uniform(-45.0, 45.0, (n, 2))


@pytest.mark.parametrize("given", OPTICS.values(), ids=OPTICS.keys())
def test_heights_and_normals_are_the_optics(given: dict[str, object]) -> None:
    plant = Plant(**given)
    optic = Optic(plant.curvature_radius_mm, plant.conic, plant.even, plant.off_axis_mm)
    local = Shape(plant).under(places())
    assert np.allclose(local.height_mm, sag_mm(optic, places()), rtol=0, atol=2e-6)
    assert np.allclose(local.normal, unit_normals(optic, places()), rtol=0, atol=1e-6)


def test_a_sphere_curves_alike_everywhere_and_beyond_the_ring_it_goes_on() -> None:
    shape = Shape(Plant(**SPHERE))
    far = np.array([[0.0, 0.0], [40.0, -20.0], [3000.0, 10.0]])
    assert np.allclose(shape.under(far).curvature_per_mm * 800.0, 1.0, atol=1e-6)


def test_an_axis_at_the_dip_to_the_normal_is_seen_at_the_dip() -> None:
    local = Shape(Plant(curvature_radius_mm=100.0)).under(places())
    seen = local.levelled(local.normal)
    assert np.allclose(seen, [0.0, 0.0, 1.0], atol=1e-12)
    across = np.cross(local.normal, [0.0, 1.0, 0.0])
    assert np.allclose(np.linalg.norm(local.levelled(across), axis=1), np.linalg.norm(across, axis=1))


def test_a_direction_along_the_surface_is_raised_to_where_it_is_seen_from() -> None:
    local = Shape(Plant(curvature_radius_mm=100.0)).under(places())
    along = np.random.default_rng(1).standard_normal((len(places()), 2))
    raised = local.raised(along)
    assert np.allclose(np.einsum("ni,ni->n", raised, local.normal), 0.0, atol=1e-12)
    assert np.allclose(local.levelled(raised), np.column_stack([along, np.zeros(len(along))]), atol=1e-12)


def test_the_stretch_is_the_length_along_the_surface() -> None:
    shape = Shape(Plant(curvature_radius_mm=100.0))
    xy, step = np.array([[30.0, -25.0]]), np.array([0.01, 0.02])
    along = shape.under(xy).stretch[0] @ step
    rise = float(sag_mm(Optic(100.0), xy + step)[0] - sag_mm(Optic(100.0), xy)[0])
    assert np.hypot(*along) == pytest.approx(math.hypot(*step, rise), rel=1e-3)


def test_a_bonnet_in_a_hollow_sinks_less_and_wears_the_same_volume_wider() -> None:
    """Preston's volume is force times speed: the hollow only spreads it. On a slope the map sees it foreshortened."""
    grid, n = Grid(161, 161, 0.1), 1
    axis = tool_axis(np.array([15.0]), np.array([40.0]))
    force = np.array([12.0])
    worn = []
    for curvature in (0.0, 1 / 60.0):
        radius = contact_radius_mm(TOOL, np.array([curvature]))
        surface = np.zeros(grid.shape)
        depth = hertz_depth_mm(TOOL, force, radius)
        wear(
            surface, grid, TOOL, centre_mm=np.zeros((n, 2)), axis=axis, depth_mm=depth, rpm=np.full(n, 1000.0),
            seconds=np.ones(n), radius_mm=radius,
        )  # fmt: skip
        worn.append(-surface)
    assert worn[1].sum() == pytest.approx(worn[0].sum(), rel=0.02)
    assert np.count_nonzero(worn[1]) / np.count_nonzero(worn[0]) == pytest.approx(1.5 ** (2 / 3), rel=0.03)


def test_on_a_slope_the_spot_is_foreshortened_by_the_slopes_cosine() -> None:
    local = Shape(Plant(curvature_radius_mm=120.0, aperture_mm=100.0)).under(np.array([[45.0, 20.0]]))
    grid, axis = Grid(201, 201, 0.05), tool_axis(np.array([15.0]), np.array([200.0]))
    sizes = []
    for stretch in (None, local.stretch):
        surface = np.zeros(grid.shape)
        wear(
            surface, grid, TOOL, centre_mm=np.zeros((1, 2)), axis=axis, depth_mm=hertz_depth_mm(TOOL, np.array([12.0])),
            rpm=np.array([1000.0]), seconds=np.ones(1), stretch=stretch,
        )  # fmt: skip
        sizes.append(-surface.sum())
    assert sizes[1] / sizes[0] == pytest.approx(local.normal[0, 2], rel=2e-3)


def test_a_bonnet_that_does_not_fit_into_the_part_is_refused() -> None:
    raw = {"plant": {"aperture_mm": 10.0, "ring_mm": 3.0, "curvature_radius_mm": 22.0}}
    with pytest.raises(ConfigError, match="into a radius of 22 mm a bonnet of 20 mm does not fit"):
        SimConfig.of(raw, TomlSource("sim.toml", ""))


def test_a_measured_spot_wears_what_was_measured_and_scales_as_hertz_does() -> None:
    pitch = 0.2
    x = (np.arange(41) - 20) * pitch
    rate = 100.0 * np.exp(-0.5 * (x[None, :] / 0.7) ** 2 - 0.5 * (x[:, None] / 1.1) ** 2)
    rate[np.hypot(x[None, :], x[:, None]) > 3.6] = 0.0
    tif = MeasuredTif(rate, pitch, azimuth_deg=90.0, depth_ratio=0.9)
    stamp, grid = MeasuredStamp(tif, TOOL), Grid(101, 101, 0.2)
    rigid = float(hertz_depth_mm(TOOL, np.array([12.0]))[0])
    spot = measured_spot(tif, TOOL)
    for gamma, azimuth in ((0.9, 90.0), (0.7, 90.0), (0.9, 180.0)):
        surface = np.zeros(grid.shape)
        lean = np.array([[math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth))]])
        axis = np.column_stack([0.26 * lean, [0.966]])
        stamp.wear(
            surface, grid, centre_mm=np.array([[1.3, -2.1]]), axis=axis, depth_mm=np.array([gamma * rigid]),
            turns=np.array([2.0 * TOOL.rpm]), stretch=np.eye(2)[None],
        )  # fmt: skip
        theirs = 2.0 * spot.patch(np.array([gamma]), np.array([math.radians(azimuth)])).sum()
        assert -surface.sum() * grid.pitch_mm**2 == pytest.approx(theirs, rel=0.01)
        row, column = np.unravel_index(np.argmin(surface), surface.shape)
        assert (grid.x_mm[column], grid.y_mm[row]) == pytest.approx((1.3, -2.1), abs=0.2)
        wide = [float((-surface.sum(axis=k) > 0.02 * -surface.sum(axis=k).min()).sum()) for k in (0, 1)]
        assert (wide[0] < wide[1]) == (azimuth == 90.0), "it turns with the spindle"


def test_what_a_table_says_of_the_robot_is_taken_and_beyond_it_the_nearest_place() -> None:
    x, y = np.meshgrid([0.0, 50.0, 100.0], [0.0, 60.0])
    tip = np.column_stack([x.ravel(), y.ravel(), np.full(6, 7.0)])
    table = MeasuredCompliance(tip, np.array([1.0, 1.2, 1.3, 1.1, 1.4, 1.9]))
    give, axis = giving(table, "linear"), np.tile([0.0, 0.0, 1.0], (2, 1))
    inside = np.array([[20.0, 30.0, 7.0], [80.0, 10.0, 7.0]])
    assert np.allclose(give(inside, axis, axis).along, measured_compliance(table, inside))
    assert give(np.array([[200.0, 90.0, 7.0]]), axis[:1], axis[:1]).along[0] == pytest.approx(1.9e-3)


ARM = SerialRobot(
    dh=((0, 90, 400, 0), (500, 0, 0, 0), (400, 0, 0, 0), (0, 90, 120, 0), (0, -90, 100, 0), (0, 0, 80, 0)),
    joint_stiffness_n_mm_per_rad=(4e8, 4e8, 3e8, 1e8, 1e8, 8e7),
    joint_limits_deg=((-360.0, 360.0),) * 6,
    home_deg=(0.0, -100.0, 100.0, -90.0, -90.0, 0.0),
    tool_length_mm=150.0,
)


def test_an_arms_compliance_by_a_loading_test_is_that_along_the_normal() -> None:
    tip, axis = np.array([[600.0, 100.0, 200.0], [550.0, -50.0, 230.0]]), np.tile([0.0, 0.0, 1.0], (2, 1))
    matrix = tip_compliance_mm_per_n(ARM, tip, axis)
    assert np.allclose(giving(ARM, "normal")(tip, axis, axis).along, np.einsum("ni,nij,nj->n", axis, matrix, axis))


def test_every_kind_of_robot_is_drawn_about_its_own_stiffness_and_the_shipped_one_as_before() -> None:
    drawn = hidden_truth.draw(Truth(), 3, ARM).robot
    assert isinstance(drawn, SerialRobot)
    share = np.array(drawn.joint_stiffness_n_mm_per_rad) / ARM.joint_stiffness_n_mm_per_rad - 1.0
    assert 0.0 < np.abs(share).max() <= 0.10
    assert hidden_truth.draw(Truth(), 3) == hidden_truth.draw(Truth(), 3, SimConfig().robot_model())
    assert SimConfig(process=SimContactSection(preston="2e-9 cm2/N")).process.tool().preston_cm2_per_n == pytest.approx(
        2e-9
    )


def test_a_reversed_spindle_wears_the_mirror_image_of_a_measured_spot() -> None:
    """Across the plane in which it leans, however it lay as it was measured; contacts of both ways are kept apart."""
    pitch = 0.2
    x = (np.arange(41) - 20) * pitch
    rate = 100.0 * np.exp(-0.5 * ((x[None, :] - 0.5) / 0.7) ** 2 - 0.5 * ((x[:, None] + 0.3) / 1.1) ** 2)
    stamp, grid = MeasuredStamp(MeasuredTif(rate, pitch, azimuth_deg=30.0), TOOL), Grid(101, 101, 0.2)
    rigid = hertz_depth_mm(TOOL, np.array([12.0]))
    for lean, mirrored in (((0.26, 0.0), np.flipud), ((0.0, -0.26), np.fliplr)):
        given = {
            "centre_mm": np.zeros((2, 2)), "axis": np.tile([*lean, 0.966], (2, 1)),
            "depth_mm": np.tile(rigid, 2), "stretch": np.tile(np.eye(2), (2, 1, 1)), "skew": 0.1,
        }  # fmt: skip
        turned = {}
        for name, turns in (("forward", (1.0, 1.0)), ("backward", (-1.0, -1.0)), ("both", (1.0, -1.0))):
            turned[name] = np.zeros(grid.shape)
            stamp.wear(turned[name], grid, turns=TOOL.rpm * np.array(turns), **given)
        forward = turned["forward"]
        assert np.abs(forward - mirrored(forward)).max() > 0.2 * np.abs(forward).max()
        assert np.allclose(turned["backward"], mirrored(forward), atol=1e-9)
        assert np.allclose(turned["both"], (forward + mirrored(forward)) / 2.0, atol=1e-9)


def test_contacts_that_follow_one_another_closely_wear_as_each_alone() -> None:
    x = (np.arange(41) - 20) * 0.1
    rate = np.maximum(1.0 - (x[None, :] / 1.5) ** 2 - (x[:, None] / 1.5) ** 2, 0.0) * 80.0
    stamp, grid = MeasuredStamp(MeasuredTif(rate, 0.1), TOOL), Grid(61, 61, 0.3)
    n, rng = 200, np.random.default_rng(2)
    given = {
        "centre_mm": np.column_stack([np.linspace(-4.0, 4.0, n), np.linspace(1.0, 2.0, n)]),
        "axis": np.tile([0.2, 0.1, 0.97], (n, 1)),
        "depth_mm": rng.uniform(0.11, 0.14, n),
        "turns": rng.uniform(0.0, 5.0, n),
        "stretch": np.tile(np.eye(2), (n, 1, 1)),
    }
    at_once, one_by_one = np.zeros(grid.shape), np.zeros(grid.shape)
    stamp.wear(at_once, grid, **given)
    for k in range(n):
        stamp.wear(one_by_one, grid, **{name: values[k : k + 1] for name, values in given.items()})
    assert at_once.sum() == pytest.approx(one_by_one.sum(), rel=5e-3)
    assert np.abs(at_once - one_by_one).max() < 0.02 * np.abs(one_by_one).max()
