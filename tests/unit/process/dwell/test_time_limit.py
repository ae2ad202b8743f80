"""The time of a solve: CPU seconds, which a busy machine does not use up; wall seconds only in the end."""

from __future__ import annotations

import time

import pytest

from polishd.process.dwell.time_limit import TimeLimit, backstop_s


class Clocks:
    """CPU and wall time as the test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.cpu = self.wall = 100.0
        monkeypatch.setattr(time, "thread_time", lambda: self.cpu)
        monkeypatch.setattr(time, "monotonic", lambda: self.wall)


def test_only_cpu_seconds_count(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks = Clocks(monkeypatch)
    limit = TimeLimit(10.0)
    clocks.wall += backstop_s(10.0) - 0.1
    clocks.cpu += 9.0
    assert not limit.expired()
    assert limit.left_s == pytest.approx(1.0)
    assert str(limit) == "9.0 s of CPU time and 159.9 s of wall time"
    clocks.cpu += 1.0
    assert limit.expired()
    assert limit.left_s == 0.0


def test_what_uses_no_cpu_ends_at_the_backstop(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks = Clocks(monkeypatch)
    limit = TimeLimit(10.0)
    clocks.wall += 160.0
    assert limit.expired()
    assert limit.left_s == 0.0
