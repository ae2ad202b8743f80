"""Where compiled code is kept, and when it is not taken any more."""

from __future__ import annotations

import os
import pwd
from pathlib import Path

import pytest

from polishd.util import jit

Patch = pytest.MonkeyPatch


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: Patch) -> tuple[Path, ...]:
    """Two files."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    found = tmp_path / "one.py", tmp_path / "two.py"
    for path in found:
        path.write_text(f"# {path.name}\n")
    return found


def test_the_folder_is_named_after_the_sources(sources: tuple[Path, ...], tmp_path: Path) -> None:
    first = jit._folder("0.61", sources)
    assert first is not None
    assert Path(first).parent == tmp_path / "cache" / "polishd"
    assert Path(first).is_dir()
    assert jit._folder("0.61", sources[::-1]) == first
    assert jit._folder("0.62", sources) != first
    for path in sources:
        before = path.read_bytes()
        path.write_bytes(before + b"\n")
        assert jit._folder("0.61", sources) != first, path.name
        path.write_bytes(before)
    assert jit._folder("0.61", sources) == first


def test_the_users_cache(sources: tuple[Path, ...], tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert Path(jit._folder("1", sources) or "").parent == tmp_path / "home" / ".cache" / "polishd"


def test_no_home_is_writable(sources: tuple[Path, ...], tmp_path: Path, monkeypatch: Patch) -> None:
    """A service's user: nothing is kept, least of all where others could put code."""
    (tmp_path / "home").write_text("no folder")
    for value in (tmp_path / "home" / "cache", sources[0]):
        monkeypatch.setenv("XDG_CACHE_HOME", str(value))
        assert jit._folder("1", sources) is None


@pytest.mark.skipif(os.name != "posix", reason="users without a home are a Unix matter")
def test_no_user_has_a_home(sources: tuple[Path, ...], monkeypatch: Patch) -> None:
    """A container's user without a name: there is no ~ at all."""
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("HOME")

    def unknown(_uid: int) -> None:
        raise KeyError("uid not found")

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    assert jit._folder("1", sources) is None


def double(x: float) -> float:
    return 2 * x


@pytest.mark.parametrize("home", ["cache", "no folder"])
def test_it_computes_the_same_wherever_it_is_kept(home: str, tmp_path: Path, monkeypatch: Patch) -> None:
    (tmp_path / "no folder").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / home))
    assert jit.compile_cached(double, [Path(__file__)])(1.5) == 3.0
    assert bool(list(tmp_path.rglob("*double*.nbc"))) == (home == "cache")
