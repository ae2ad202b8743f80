"""``polishd device``: what there is, what it means, and templates that the check takes."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.device_profile_checks import DEVICE_PROFILE_DIR, shipped
from tests.fakes.devices_by_profile import file_of
from tests.unit.cli_result import Polishd


def test_the_list_says_what_was_tried(polishd: Polishd) -> None:
    listed = polishd("device", "list", "--json").answer["profiles"]
    assert [one["name"] for one in listed] == shipped()
    assert {one["tried"] for one in listed if one["name"] == "delta_ms300"} == {
        "from the manual, not tried on the device"
    }


def test_show_gives_the_file_to_start_from(polishd: Polishd, tmp_path: Path) -> None:
    said = polishd("device", "show", "hitachi_wj200", "--toml")
    assert said.out == (DEVICE_PROFILE_DIR / "hitachi_wj200.toml").read_text()
    (tmp_path / "mine.toml").write_text(said.out)
    assert polishd("device", "check", tmp_path / "mine.toml").code == 0


def test_show_for_people(polishd: Polishd) -> None:
    said = polishd("device", "show", "delta_ms300").out
    for words in ("Delta MS300", "appendix A", "not tried on the device", "Pr.09-03", "9600 8N1"):
        assert words in said


def test_check_shows_each_request_as_the_manual_prints_it(polishd: Polishd) -> None:
    orders = polishd("device", "check", "hitachi_wj200", "--json").answer["orders"]
    assert orders["forward, 1000 rpm"].endswith("01 05 00 00 FF 00 8C 3A")
    assert orders["look"].startswith("01 01 00 0E 00 02")


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("profile", "raw", "reads"),
    [
        ("voice_coil_modbus", "force=0x04AE", {"force": "11.98 N"}),
        ("voice_coil_modbus", "force=0xFFFE", {"force": "-0.02 N"}),
        ("hitachi_wj200", "speed=0x0000 0x1388", {"speed": "3000 rpm"}),
        ("mark10_series5", "reading=4.285 N", {"force": "4.285 N"}),
    ],
)
def test_raw_examples_are_read(polishd: Polishd, profile: str, raw: str, reads: dict[str, str]) -> None:
    found = polishd("device", "check", profile, "--raw", raw, "--json").answer["reads"][raw]
    assert {key: found[key] for key in reads} == reads
    assert f"{raw} reads" in polishd("device", "check", profile, "--raw", raw).out


def test_a_whole_answer_gives_the_state(polishd: Polishd) -> None:
    raw = "status=C 12.02 5.000 0"
    found = polishd("device", "check", file_of("line_drive.toml"), "--raw", raw, "--json").answer["reads"][raw]
    assert (found["(state)"], found["force"], found["position"]) == ("contact", "12.02 N", "5 mm")


@pytest.mark.parametrize(
    ("raw", "why"),
    [
        ("force", "write NAME=DATA"),
        ("forse=1", "the profile has no such register; it has command"),
        ("force=1 2", "it fills 1 registers, not 2"),
        ("force=twelve", "invalid literal"),
        ("force=70000", "raw example force='70000'"),
    ],
)
def test_bad_raw_examples_are_reported(polishd: Polishd, raw: str, why: str) -> None:
    said = polishd("device", "check", "voice_coil_modbus", "--raw", raw)
    assert said.code == 3
    assert why in said.err


def test_check_warns_of_what_may_be_forgotten(polishd: Polishd, tmp_path: Path) -> None:
    slow = (DEVICE_PROFILE_DIR / "delta_ms300.toml").read_text().replace("baud = 9600", "baud = 1200")
    (tmp_path / "slow.toml").write_text(slow.replace('reverse = ["set_point = asked", "command = 0x22"]', ""))
    warnings = polishd("device", "check", tmp_path / "slow.toml", "--json").answer["warnings"]
    for words in ("set 1 s at the device", "raise serial.baud", "turns forward only"):
        assert any(words in one for one in warnings), warnings


@pytest.mark.one_of_each
@pytest.mark.parametrize("link", ["modbus", "lines"])
@pytest.mark.parametrize("kind", ["actuator", "spindle", "force_sensor"])
def test_templates_are_taken_and_say_what_to_do(polishd: Polishd, tmp_path: Path, kind: str, link: str) -> None:
    template = polishd("device", "new", kind, "--link", link).out
    (tmp_path / "mine.toml").write_text(template)
    warnings = polishd("device", "check", tmp_path / "mine.toml", "--json").answer["warnings"]
    assert "it still contains TODO" in warnings


def test_a_broken_profile_is_reported_with_its_place(polishd: Polishd, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(file_of("line_drive.toml").read_text().replace("max_force_n", "max_farce_n"))
    said = polishd("device", "check", tmp_path / "mine.toml")
    assert said.code == 3
    assert "mine.toml:15: actuator.max_farce_n: unknown key; did you mean 'max_force_n'?" in said.err


def test_find_without_a_device(polishd: Polishd) -> None:
    said = polishd("device", "scan", "hitachi_wj200", "tcp://127.0.0.1:1", "--units", 2)
    assert said.code == 5
    assert "tcp://127.0.0.1:1: " in said.err
