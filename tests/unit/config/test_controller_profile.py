"""Profiles of controllers: the shipped ones, where a mistake stands, and which controllers must not polish."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.controller_profile import (
    CONTROLLER_PROFILE_DIR,
    ControllerProfile,
    load_controller_profile,
    shipped,
)
from polishd.model.errors import ConfigError

LEAST = """
name = "least"
link = "ads"
report_ms = 50
watchdog_s = 8.0
[variables]
start = { address = "G.start", type = "bool" }
hold = { address = "G.hold", type = "bool" }
feed_hold = { address = "G.feed_hold", type = "bool" }
heartbeat = { address = "G.beat", type = "uint16" }
[variables.line]
address = "G.line"
type = "uint32"
shows = "executed"
[variables.state]
address = "G.state"
type = "uint16"
ready = [1]
running = [2]
paused = [3]
done = [4]
"""


def profile(tmp_path: Path, text: str = LEAST) -> ControllerProfile:
    (tmp_path / "mine.toml").write_text(text)
    return load_controller_profile("mine.toml", tmp_path)


@pytest.mark.parametrize("name", shipped())
def test_shipped_profiles_may_polish(name: str) -> None:
    found = load_controller_profile(name, Path())
    found.require_usable()
    assert found.variables.feed_hold is not None
    assert found.watchdog_s is not None
    text = (CONTROLLER_PROFILE_DIR / f"{name}.toml").read_text()
    assert text.startswith("#"), "it says of what it is"
    if name in ("twincat-nci", "sinumerik-opcua", "staubli-val3", "yaskawa-inform", "yaskawa-hses"):
        assert "not tried on the device" in text


def test_what_is_left_out_has_its_default(tmp_path: Path) -> None:
    found = profile(tmp_path)
    found.require_usable()
    assert found.unseen_stop_s == pytest.approx(0.095)
    assert (found.program.pause, found.program.file) == ("M0", "polishd.nc")
    assert profile(tmp_path, "in_motion_wired = true\n" + LEAST).unseen_stop_s == 0.0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("hold = {", "# {", r"mine\.toml:6: variables: .*\[variables\.hold\]"),
        ("feed_hold = {", "# {", r"mine\.toml:6: variables: "),
        ('shows = "executed"', 'shows = "interpreted"', r"mine\.toml:14: variables\.line\.shows: "),
    ],
)
def test_a_controller_that_must_not_polish_is_refused_with_its_place(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    found = profile(tmp_path, LEAST.replace(old, new, 1) if old != "hold = {" else LEAST.replace("\nhold = {", "\n# {"))
    with pytest.raises(ConfigError, match=said):
        found.require_usable()


def test_a_feed_override_shows_a_hold_too(tmp_path: Path) -> None:
    override = 'feed_override = { address = "G.ovr", type = "double" }'
    profile(
        tmp_path, LEAST.replace('feed_hold = { address = "G.feed_hold", type = "bool" }', override)
    ).require_usable()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("report_ms = 50", "", r"report_ms: .*missing"),
        ("report_ms = 50", "report_ms = 0", r"mine\.toml:4: report_ms: 0 is out of range"),
        ('link = "ads"', 'link = "profinet"', r"mine\.toml:3: link: 'profinet' is not allowed"),
        ("watchdog_s = 8.0", "", r"watchdog_s: .*\[variables\.heartbeat\]"),
        ('type = "uint32"', 'type = "word"', r"mine\.toml:13: variables\.line\.type: 'word' is not allowed"),
        ("ready = [1]", "", r"variables\.state.*ready: is missing"),
        ("done = [4]", "", r"variables\.state.*done: is missing"),
        ("done = [4]", "done = [4.5]", r"mine\.toml:\d+: variables\.state\.done"),
        ("[variables]", "[program]\ndwell = 'G4 P1'\n[variables]", r"dwell: must have \{seconds\}"),
        ("[variables]", "[program]\nfile = '../x.nc'\n[variables]", r"mine\.toml:7: program\.file: '\.\./x\.nc'"),
        ("done = [4]", "ended = [4]\n[program]\nend = ''", r"program\.end: is empty.* or program\.last"),
        ("[variables]", "[variables]\nstop = 1", r"mine\.toml:7: variables\.stop: unknown key"),
        (
            "[variables]",
            '[variables]\nline_began = { address = "G.b", type = "double" }',
            r"line_began: is a time on \[variables\.clock\]",
        ),
        (
            'shows = "executed"',
            'shows = "executed"\ncounts = "statements"',
            r"counted: goes with counts = \"statements\"",
        ),
        (
            'shows = "executed"',
            'shows = "executed"\ncounted = ["movel("]',
            r"counted: goes with counts = \"statements\"",
        ),
        (
            'shows = "executed"',
            'shows = "executed"\ncounts = "n_words"\nstarts_at = "NOP"',
            r"starts_at: goes with counts = \"lines\"",
        ),
    ],
)
def test_a_mistake_is_reported_with_its_place(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        profile(tmp_path, LEAST.replace(old, new, 1))


def test_a_profile_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="known are plc-ads, plc-modbus, plc-opcua, sinumerik-opcua, staubli-val3"):
        load_controller_profile("sinumerik", tmp_path)
    with pytest.raises(ConfigError, match="cannot be read"):
        load_controller_profile("none.toml", tmp_path)
