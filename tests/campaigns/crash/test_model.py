"""The model of intent, effect and outcome holds in every state, and a daemon that breaks it is caught."""

from __future__ import annotations

import pytest

from tests.campaigns.crash.model import BROKEN, MISSING, check

pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"the model is not checked: {MISSING}")


@pytest.mark.full
def test_no_order_of_steps_and_one_fault_breaks_a_promise() -> None:
    found = check(1)
    assert found.states > 1_000
    assert not found.wrong


@pytest.mark.full
def test_two_faults_and_the_job_still_comes_to_its_end() -> None:
    found = check(2, lives=True)
    assert found.states > 100_000
    assert not found.wrong


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("broken", BROKEN)
def test_a_daemon_that_breaks_a_promise_is_caught(broken: str) -> None:
    assert "assertion violated" in check(2, broken=broken).wrong
