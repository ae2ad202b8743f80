"""The contact against published numbers, vector algebra and numerical integration."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy import integrate

from polishd.model.errors import ComputeError
from polishd.model.process import NormalForce, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process.identification import residual_diagnosis
from polishd.process.removal import contact

PAPER = ToolProcess()
DEPTH = 0.14834891


def integral(process: ToolProcess, depth: float, value: Callable[[float, float, float], float]) -> float:
    """Integral over the contact of value(x, y, rate), adaptive and in polar coordinates about the spot's centre."""
    radius = float(contact.contact_radius_mm(process, depth))
    shift = float(contact.dissipative_shift_mm(process, depth))

    def ring(rho: float, angle: float) -> float:
        x, y = shift + rho * np.cos(angle), rho * np.sin(angle)
        return rho * value(x, y, float(contact.removal_rate_nm_s(process, depth, np.array(x), np.array(y))))

    return integrate.dblquad(ring, 0, 2 * np.pi, 0, radius, epsrel=1e-8)[0]


def dissipative_ratio(rho: FloatArray) -> FloatArray:
    """Dissipative over elastic stress as eq. 29 and 32 print them, ``rho`` contact radii from the centre along x."""
    return contact.dissipative_fraction(PAPER, DEPTH) * rho / (1 - rho**2)


def test_hertz_at_the_figures_of_the_paper() -> None:
    depth = contact.hertz_depth_mm(PAPER)
    assert depth == pytest.approx(0.14835, rel=1e-5)
    assert contact.contact_radius_mm(PAPER, depth) == pytest.approx(1.7225, rel=1e-5)
    assert contact.peak_pressure_mpa(PAPER, depth) == pytest.approx(1.9311, rel=1e-5)


def test_the_resolved_force_presses_deeper() -> None:
    resolved = dataclasses.replace(PAPER, normal_force="resolved")
    assert contact.normal_force_n(resolved) == pytest.approx(12.42, abs=5e-3)
    assert contact.hertz_depth_mm(resolved) == pytest.approx(0.1518, abs=5e-5)
    by_hand = dataclasses.replace(PAPER, force_n=12 / np.cos(np.radians(15)))
    assert contact.hertz_depth_mm(resolved) == pytest.approx(contact.hertz_depth_mm(by_hand), rel=1e-12)


@pytest.mark.parametrize("force", [0.5, 12.0, 60.0])
def test_the_pressure_carries_the_force(force: float) -> None:
    process = dataclasses.replace(PAPER, force_n=force)
    depth = contact.hertz_depth_mm(process)
    radius, peak = contact.contact_radius_mm(process, depth), contact.peak_pressure_mpa(process, depth)
    carried = integrate.quad(lambda r: 2 * np.pi * r * peak * np.sqrt(1 - (r / radius) ** 2), 0, radius)[0]
    assert carried == pytest.approx(force, rel=1e-9)


def test_the_speed_is_the_spin_crossed_with_the_arm() -> None:
    dip, spin = np.radians(15.0), 1000 * 2 * np.pi / 60
    axis = spin * np.array([0.0, np.sin(dip), np.cos(dip)])
    for x, y in np.random.default_rng(3).uniform(-2, 2, (20, 2)):
        slide = np.cross(axis, [x, y, -(20 - DEPTH)])
        want = np.hypot(slide[0], slide[1])
        assert contact.sliding_speed_mm_s(PAPER, DEPTH, x, y) == pytest.approx(want, rel=1e-12)


def test_without_dip_the_centre_stands_still() -> None:
    upright = dataclasses.replace(PAPER, dip_deg=0.0)
    assert contact.sliding_speed_mm_s(upright, DEPTH, 0.0, 0.0) == 0
    assert contact.dissipative_shift_mm(upright, DEPTH) == 0


def test_the_spot_removes_most_on_the_side_where_the_spindle_leans() -> None:
    y = np.array([-0.8, 0.8])
    low, high = contact.removal_rate_nm_s(PAPER, DEPTH, np.zeros(2), y)
    assert high > 1.2 * low > 0


def test_peak_and_volume_at_the_usual_unit_of_the_preston_constant() -> None:
    x, y = np.meshgrid(np.linspace(-2, 2, 401), np.linspace(-2, 2, 401))
    rate = contact.removal_rate_nm_s(PAPER, DEPTH, x, y)
    assert rate.max() == pytest.approx(162.0, abs=0.5)
    assert (rate[np.hypot(x, y) > 1.73] == 0).all()
    assert contact.volume_rate_nm_mm2_s(PAPER, DEPTH)[0] * 1e-6 == pytest.approx(9.72e-4, rel=5e-4)


@pytest.mark.one_of_each
@pytest.mark.parametrize("dip", [0.0, 3.0, 15.0, 60.0])
def test_the_volume_rate_is_the_integral_of_the_rate(dip: float) -> None:
    """At 3 degrees the bonnet's pole, where it stands still, lies inside the contact: a cusp for both sides."""
    process = dataclasses.replace(PAPER, dip_deg=dip)
    for depth in (0.1, DEPTH):
        want = integral(process, depth, lambda x, y, rate: rate)
        assert contact.volume_rate_nm_mm2_s(process, depth)[0] == pytest.approx(want, rel=1e-4 if dip == 3 else 1e-6)


def test_the_volume_goes_as_depth_to_one_and_a_half() -> None:
    full, part = contact.volume_rate_nm_mm2_s(PAPER, np.array([DEPTH, 0.87 * DEPTH]))
    assert part / full == pytest.approx(0.811, abs=1e-3)


def test_the_dissipative_shift_is_about_a_micrometre_and_towards_where_the_bonnet_enters() -> None:
    shift = float(contact.dissipative_shift_mm(PAPER, DEPTH))
    assert shift == pytest.approx(2.144e-6 * 104.72 * 0.25882 * 19.85165, rel=2e-4)
    # at the contact the bonnet moves with -x (spin cross arm): it enters from +x
    slide = np.cross([0.0, np.sin(0.26), np.cos(0.26)], [0.0, 0.0, -19.85])
    assert slide[0] < 0 < shift


def test_the_shift_keeps_the_force_and_gives_the_moment_of_eq_33() -> None:
    """With the speed divided out what is left of the rate is the pressure."""
    thick = dataclasses.replace(PAPER, second_viscosity_mpa_s=0.02, viscosity_mpa_s=0.05)
    shift = float(contact.dissipative_shift_mm(thick, DEPTH))
    assert 0.2 < shift < 0.5
    scale = contact.preston_nm_s(thick)

    def pressure(x: float, y: float, rate: float) -> float:
        return rate / scale / float(contact.sliding_speed_mm_s(thick, DEPTH, np.array(x), np.array(y)))

    force = integral(thick, DEPTH, pressure)
    assert force == pytest.approx(12.0, rel=1e-6)
    assert integral(thick, DEPTH, lambda x, y, r: x * pressure(x, y, r)) == pytest.approx(shift * force, rel=1e-6)


@pytest.mark.one_of_each
@pytest.mark.parametrize("normal_force", ["axial", "resolved"])
@pytest.mark.parametrize("thick", [False, True])
def test_force_and_moment_are_hertz_and_shift_times_force(normal_force: NormalForce, thick: bool) -> None:
    """Eq. 33: integrals of ``p`` and ``x p``, on squares that know nothing of the contact's middle."""
    viscous = {"second_viscosity_mpa_s": 0.02, "viscosity_mpa_s": 0.05} if thick else {}
    process = dataclasses.replace(PAPER, normal_force=normal_force, **viscous)
    depth = contact.hertz_depth_mm(process)
    force = 12.0 / (np.cos(np.radians(15)) if normal_force == "resolved" else 1)
    moment = float(contact.dissipative_shift_mm(process, depth)) * force
    line, step = np.linspace(-2.5, 2.5, 2001, retstep=True)
    x, y = np.meshgrid(line, line)
    pressure = contact.pressure_mpa(process, depth, x, y)
    assert pressure.sum() * step**2 == pytest.approx(force, rel=1e-4)
    assert (x * pressure).sum() * step**2 == pytest.approx(moment, rel=1e-3)


def test_the_dissipative_stress_is_below_a_thousandth_up_to_0_72_radii() -> None:
    """The size physics.md gives to it; at the rim eq. 32 as printed is infinite."""
    fraction = float(contact.dissipative_fraction(PAPER, DEPTH))
    assert fraction == pytest.approx(6.70e-4, rel=2e-3)
    low, high = dissipative_ratio(np.array([0.715, 0.725]))
    assert low < 1e-3 < high
    assert dissipative_ratio(1 - 1e-9) > 1e4


def test_the_dissipative_ratio_is_the_shift_of_the_elastic_pressure() -> None:
    """To first order the pressure moved by the shift is the pressure and the dissipative stress of eq. 32."""
    still = dataclasses.replace(PAPER, dip_deg=0.0)  # same pressure, not shifted
    radius = float(contact.contact_radius_mm(PAPER, DEPTH))
    rho = np.array([-0.6, -0.2, 0.3, 0.7])
    moved, elastic = (contact.pressure_mpa(p, DEPTH, rho * radius, np.zeros(4)) for p in (PAPER, still))
    np.testing.assert_allclose(moved / elastic - 1, dissipative_ratio(rho), rtol=5e-3)


def test_without_dip_there_is_no_moment() -> None:
    upright = dataclasses.replace(PAPER, dip_deg=0.0)
    assert contact.dissipative_shift_mm(upright, DEPTH) == 0
    assert contact.dissipative_fraction(upright, DEPTH) == 0


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("force_n", 0.0, "force_n is 0 N, it must be above 0"),
        ("tool_radius_mm", -20.0, "tool_radius_mm is -20 mm"),
        ("rpm", np.nan, "rpm is nan 1/min"),
        ("preston_cm2_per_n", np.inf, "preston_cm2_per_n is inf cm2/N"),
        ("dip_deg", 90.0, "dip_deg is 90 deg, it must be above -1e-12 and below 90"),
        ("dip_deg", -1.0, "dip_deg is -1 deg"),
        ("tool_poisson", 0.6, "tool_poisson is 0.6"),
        ("part_modulus_mpa", 0.0, "part_modulus_mpa is 0 MPa"),
        ("lame_mpa", 0.0, "lame_mpa is 0 MPa"),
        ("viscosity_mpa_s", -1.0, "viscosity_mpa_s is -1 MPa s"),
        ("force_n", 1e4, "too deep for Hertz"),
        ("depth_exponent", 0.0, "depth_exponent is 0"),
        ("spot_offset_mm", (0.0, np.nan), "spot_offset_mm is nan mm"),
        ("spot_offset_mm", (25.0, 0.0), "spot_offset_mm is 25 mm, it must be above -20 and below 20"),
        ("normal_force", "vertical", "normal_force is 'vertical', it must be axial or resolved"),
    ],
)
def test_a_process_that_cannot_be_is_refused_by_name(name: str, value: object, says: str) -> None:
    with pytest.raises(ComputeError, match=says):
        contact.hertz_depth_mm(dataclasses.replace(PAPER, **{name: value}))


def test_removal_goes_with_force_and_speed_as_the_models_own_volume() -> None:
    process, factor = ToolProcess(), np.array([0.5, 1.0, 1.3])
    found = contact.relative_removal(process, process.force_n * factor, np.full(3, process.rpm))
    own = [
        contact.volume_rate_nm_mm2_s(other, contact.hertz_depth_mm(other))[0]
        for other in (dataclasses.replace(process, force_n=process.force_n * share) for share in factor)
    ]
    assert found == pytest.approx(own / own[1], rel=2e-3), "but for the bonnet's height over a deeper contact"
    faster = contact.relative_removal(process, np.full(2, process.force_n), process.rpm * np.array([0.9, -1.1]))
    assert faster == pytest.approx([0.9, 1.1])


def test_a_fitted_exponent_is_the_processs_law() -> None:
    process = ToolProcess(depth_exponent=1.2)
    found = contact.relative_removal(process, np.array([24.0]), np.array([process.rpm]))
    assert found == pytest.approx([2 ** (2 / 3 * 1.2)])


def test_what_is_not_known_is_the_processs_own() -> None:
    unknown = np.array([np.nan, 12.0, np.nan])
    found = contact.relative_removal(ToolProcess(), unknown, np.array([500.0, np.nan, np.nan]))
    assert found == pytest.approx([0.5, 1.0, 1.0])
    assert contact.relative_removal(ToolProcess(), np.array([-0.01]), np.array([1000.0])) == [0.0], "noise about zero"


def test_a_spindle_that_turns_the_wrong_way_removes_the_same_two_micrometres_aside() -> None:
    """Preston's law takes the speed without its sign: neither a map nor the gate can name the direction."""
    back = dataclasses.replace(PAPER, rpm=-PAPER.rpm)
    x, y = np.meshgrid(np.linspace(-2.0, 2.0, 801), np.linspace(-2.0, 2.0, 801))
    right, wrong = (np.abs(contact.removal_rate_nm_s(process, DEPTH, x, y)) for process in (PAPER, back))
    assert np.allclose(wrong, right[:, ::-1], rtol=1e-12, atol=1e-9), "mirrored, across the lean"
    assert wrong.sum() == pytest.approx(right.sum(), rel=1e-12)
    aside_mm = (x * right).sum() / right.sum() - (x * wrong).sum() / wrong.sum()
    assert aside_mm == pytest.approx(2 * float(contact.dissipative_shift_mm(PAPER, DEPTH)), rel=0.05)
    assert 1e-3 < aside_mm < residual_diagnosis.LEAST_MM / 50
