"""Causes by name: of gate and leftover, of maps with no pass between, and what is waited for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polishd.model.estimates import CAUSES, Diagnosis, Estimate
from polishd.process.identification import residual_diagnosis
from polishd.process.identification.removal_check import RemovalCheckResult, check_removal
from polishd.process.identification.residual_diagnosis import ResidualFit, fit_residual
from tests.unit.process.identification.test_residual_diagnosis_leftover import MASK, POWER, TREFOIL, noise, removal

NOTHING = ResidualFit(
    Estimate(1.0, 0.002), Estimate(0.01, 0.01), Estimate(0.05, 0.02), Estimate(0.05, 0.02), Estimate(0.0, 0.02)
)


def judged(measured: np.ndarray) -> RemovalCheckResult:
    return check_removal(np.where(MASK, removal(), 0.0), np.where(MASK, measured, 0.0), MASK, 1.0)


def named(measured: np.ndarray, again: tuple[Diagnosis, ...] | None = None) -> tuple[Diagnosis, ...]:
    """Return the diagnoses of a pass that should have removed ``removal()``."""
    left = fit_residual(np.where(MASK, measured, 0.0), MASK, 1.0, removal())
    return residual_diagnosis.diagnose_pass(judged(measured), left, 62.0, again)


def causes(found: tuple[Diagnosis, ...]) -> list[str]:
    return [one.cause for one in found]


@pytest.mark.parametrize(
    ("measured", "cause"),
    [
        (0.9 * removal(), None),
        (0.45 * removal(), "rate"),
        (0.7 * removal(), "rate"),
        (removal()[:, ::-1], "map"),
        (np.roll(removal(), 1, axis=1), "shift"),
    ],
)
def test_a_pass_names_what_is_wrong_with_it(measured: np.ndarray, cause: str | None) -> None:
    found = named(measured + noise(0.2))
    assert causes(found) == ([] if cause is None else [cause])
    assert not any(one.again for one in found)
    assert all(one.size > one.limit for one in found)


@pytest.mark.full
@pytest.mark.parametrize(("bent", "cause"), [(-3.0 * POWER, "settling"), (3.0 * TREFOIL, "mount")])
def test_low_orders_are_suspected_until_another_map_tells(bent: np.ndarray, cause: str) -> None:
    measured = removal() + bent + noise(0.2)
    (suspected,) = named(measured)
    assert (suspected.cause, suspected.again) == (cause, True)
    (left,) = named(measured, again=())
    assert (left.cause, left.again) == ("field", False), "the maps since agree: it is the pass's, or stays"
    (still,) = named(measured, again=(replace(suspected, again=False),))
    assert still.cause == cause, "what changes with no pass between is no pass's"
    (proved,) = named(removal() + noise(0.2), again=(replace(suspected, again=False),))
    assert proved.cause == cause, "the pass itself is as it should be by the last map"


def test_what_low_orders_do_to_the_gate_is_not_believed() -> None:
    """The removal check sees power as a shift of a millimeter: another map comes first, without a notification."""
    verdict = judged(removal() - 12.0 * POWER + noise(0.2))
    left = fit_residual(removal() - 12.0 * POWER + noise(0.2), MASK, 1.0, removal())
    stopped = replace(verdict, stop="the removal lies 1.00 +- 0.01 mm from where it was predicted")
    (found,) = residual_diagnosis.diagnose_pass(stopped, left, 62.0)
    assert (found.cause, found.again) == ("settling", True)


def test_a_limit_is_of_the_removal_or_of_the_noise() -> None:
    """A part of a rate that changes by 1 % over it shows so much of a low order; a noisy map eight of its errors."""
    for sigma, limit in ((0.02, 0.62), (0.5, 4.0)):
        for size, expected in ((0.98 * limit, []), (1.02 * limit, ["mount"])):
            left = replace(NOTHING, trefoil_nm=Estimate(size, sigma))
            assert causes(residual_diagnosis.diagnose_pass(judged(removal()), left, 62.0)) == expected


def test_no_cause_is_named_by_a_pass_that_shows_none() -> None:
    weak = check_removal(0.01 * removal(), 0.01 * removal(), MASK, 1.0)
    left = replace(NOTHING, rate=Estimate(0.2, 0.001), shift_mm=Estimate(3.0, 0.01))
    assert residual_diagnosis.diagnose_pass(weak, left, 0.6) == ()
    assert residual_diagnosis.diagnose_pass(weak, None, 0.6) == ()


def test_what_settles_is_waited_for_and_a_mount_is_not() -> None:
    changes = [-5.0 * POWER, -2.0 * POWER, -0.04 * POWER, 2.0 * TREFOIL]
    found = [residual_diagnosis.diagnose_change(fit_residual(one + noise(0.05), MASK, 1.0)) for one in changes]
    before = [(), *found[:-1]]
    assert [residual_diagnosis.is_settling(*pair) for pair in zip(found, before, strict=True)] == [
        True,
        True,
        False,
        False,
    ]
    assert not residual_diagnosis.is_settling(found[0], found[1]), (
        "a set-up that is another each time does not come nearer"
    )
    assert [causes(one) for one in found] == [["settling"], ["settling"], [], ["mount"]]
    (lasting,) = residual_diagnosis.largest_of_each_cause([*found[1], *found[0]])
    assert lasting.size == pytest.approx(5.0, abs=0.1), "each cause once, where it was largest"


def test_a_cause_within_the_tolerance_does_not_stop() -> None:
    (mount,) = residual_diagnosis.diagnose_change(fit_residual(1.0 * TREFOIL + noise(0.05), MASK, 1.0))
    assert residual_diagnosis.limiting_change((mount,), 1.5) == (mount,)
    assert residual_diagnosis.limiting_change((mount,), 3.0) == ()


def test_words_say_how_large_what_else_it_may_be_and_what_is_done() -> None:
    (found,) = named(0.7 * removal() + noise(0.2))
    assert "0.70" in found.words
    assert "process.preston" in found.words
    assert CAUSES["rate"].todo in found.words


def test_beside_a_shift_that_first_order_does_not_tell_no_rate_is_named() -> None:
    far = replace(NOTHING, rate=Estimate(0.4, 0.01), shift_mm=Estimate(1.8, 0.05))
    verdict = replace(judged(removal() + noise(0.2)), stop="")
    assert causes(residual_diagnosis.diagnose_pass(verdict, far, 62.0, most_shift_mm=3.0)) == ["shift"]
    assert causes(residual_diagnosis.diagnose_pass(verdict, replace(far, shift_mm=Estimate(0.3, 0.05)), 62.0)) == [
        "shift",
        "rate",
    ]


def test_a_figure_that_is_nearly_its_own_mirror_image_is_mirrored_and_not_far_aside() -> None:
    """Flipped it fits to 1.000, as it is and 5 mm aside to 0.99: the cell stops for either, by the right name."""
    x = np.broadcast_to(np.arange(41) - 20.0, MASK.shape)
    ridge = 12.0 * np.cos(x / 6.0 + 0.42) + 0.05 * removal(5)
    measured = ridge[:, ::-1] + noise(0.1)
    verdict = check_removal(np.where(MASK, ridge, 0.0), np.where(MASK, measured, 0.0), MASK, 1.0)
    aside = check_removal(
        np.where(MASK, ridge, 0.0), np.where(MASK, np.roll(ridge, 3, axis=1) + noise(0.1), 0.0), MASK, 1.0
    )
    assert residual_diagnosis.diagnose_removal(verdict).cause == "map"
    assert residual_diagnosis.diagnose_removal(aside).cause == "shift", "what truly lies aside is called so"
