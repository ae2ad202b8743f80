"""Installed software that changes while a process runs: reported by name, and no worker of other versions computes."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.daemon.runtime.compute import Compute
from polishd.daemon.runtime.installed import installed_at_start, installed_now, require_same
from polishd.model.errors import HostFault


def install(site: Path, version: str, body: str = "VALUE = 1\n") -> None:
    """A plugin's distribution, as pip lays it down."""
    for old in site.glob("gauge_plugin*"):
        shutil.rmtree(old)
    package, info = site / "gauge_plugin", site / f"gauge_plugin-{version}.dist-info"
    package.mkdir(parents=True)
    info.mkdir()
    (package / "__init__.py").write_text(body)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: gauge_plugin\nVersion: {version}\n")
    (info / "entry_points.txt").write_text("[polishd]\ngauge = gauge_plugin\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "site"
    install(folder, "1.0")
    monkeypatch.syspath_prepend(str(folder))
    installed_at_start.cache_clear()
    yield folder
    installed_at_start.cache_clear()


def test_the_same_is_the_same(site: Path) -> None:
    found = installed_now()
    assert found["gauge-plugin"].startswith("1.0, sources ")
    assert found["polishd"]
    assert found["numpy"]  # which polishd requires
    require_same(found, installed_now())


def test_a_newer_installation_does_not_disturb(site: Path) -> None:
    before = {name: what for name, what in installed_now().items() if name != "gauge-plugin"}
    require_same(before, installed_now())


def test_another_version_is_named(site: Path) -> None:
    before = installed_now()
    install(site, "2.0")
    with pytest.raises(HostFault, match=r"gauge-plugin \(1\.0.* now 2\.0.*Restart the daemon") as raised:
        require_same(before, installed_now())
    assert "polishd (" not in str(raised.value)


def test_other_sources_of_the_same_version_are_named(site: Path) -> None:
    before = installed_now()
    install(site, "1.0", "VALUE = 2\n")
    with pytest.raises(HostFault, match=r"gauge-plugin \(1\.0, sources \w+ when .* now 1\.0, sources"):
        require_same(before, installed_now())


def test_one_that_was_removed_is_named(site: Path) -> None:
    before = installed_now()
    shutil.rmtree(site)
    with pytest.raises(HostFault, match=r"gauge-plugin \(1\.0.* now not installed\)"):
        require_same(before, installed_now())


@pytest.mark.full
async def test_a_worker_that_starts_again_proves_its_versions(site: Path) -> None:
    async with Compute() as compute:
        pid = await compute(os.getpid)
        install(site, "2.0")
        assert await compute(os.getpid) == pid, "the one that has all loaded goes on"
        os.kill(pid, signal.SIGKILL)
        await asyncio.to_thread(os.waitid, os.P_PID, pid, os.WEXITED | os.WNOWAIT)
        for _ in range(2):  # and it is not forgotten
            with pytest.raises(HostFault, match=r"gauge-plugin \(1\.0.*now 2\.0.*Restart the daemon"):
                await compute(os.getpid)
            assert compute.pid is None
        install(site, "1.0")
        assert await compute(os.getpid) != pid
