"""Device profiles: all that polishd brings are sound, and each fault names its location."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from polishd.commissioning.device_profiles import TEMPLATES
from polishd.config.device_profile_checks import DEVICE_PROFILE_DIR, load_device_profile, profile_of, shipped
from polishd.model.errors import ConfigError

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
FILES = [*DEVICE_PROFILE_DIR.glob("*.toml"), *TEMPLATES.glob("*.toml"), EXAMPLES / "line_drive.toml"]
MODBUS = (TEMPLATES / "actuator_modbus.toml").read_text()
LINES = (EXAMPLES / "line_drive.toml").read_text()
SPINDLE = (DEVICE_PROFILE_DIR / "delta_ms300.toml").read_text()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_profile_is_sound(path: Path) -> None:
    profile = load_device_profile(path)
    assert profile.polled
    assert profile.manual
    assert profile.tried == "manual" or profile.kind in {"actuator", "force_sensor"}


def test_profiles_from_manuals_say_so_and_where() -> None:
    for name in shipped():
        profile = profile_of(name, Path())
        if not name.startswith(("voice_coil", "force_sensor_line")):
            assert profile.tried == "manual"
            assert re.search(r"pages?|chapter", profile.manual), name


def test_all_templates_are_there() -> None:
    kinds = {(one.kind, one.link) for one in map(load_device_profile, TEMPLATES.glob("*.toml"))}
    assert len(kinds) == len(list(TEMPLATES.glob("*.toml"))) == 6


def faults(tmp_path: Path, text: str) -> list[str]:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as error:
        load_device_profile(path)
    return [line.removeprefix(str(path)) for line in str(error.value).splitlines()]


def line_of(text: str, what: str) -> int:
    return next(at for at, line in enumerate(text.splitlines(), start=1) if what in line)


CASES = [
    (MODBUS, 'unpowered = "stays"', 'unpowered = "presses"', "actuator.unpowered: a tool that presses without power"),
    (MODBUS, "address = 1  ", "adress = 1  ", "registers.new_force.adress: unknown key; did you mean 'address'?"),
    (MODBUS, 'type = "i16"', 'type = "int16"', "registers.force.type: 'int16' is not allowed"),
    (MODBUS, "scale = 0.01\nrange", "scale = 0\nrange", "registers.force.scale: scale must not be 0"),
    (
        MODBUS,
        'engage = ["command = 1"]',
        'engage = ["comand = 1"]',
        "commands.engage: there is no [registers.comand]; did you mean 'command'?",
    ),
    (MODBUS, 'engage = ["command = 1"]', 'engage = ["GO"]', "commands.engage: 'GO' is not a step"),
    (
        MODBUS,
        'engage = ["command = 1"]',
        'engage = ["command = 65536"]',
        "commands.engage: 65536 does not fit 'command'",
    ),
    (MODBUS, 'engage = ["command = 1"]', 'engage = ["force = 1"]', "commands.engage: 'force' cannot be written"),
    (MODBUS, 'engage = ["command = 1"]', 'stop = ["command = 1"]', "commands.stop: is not a command of this actuator"),
    (MODBUS, "max_force_n = 20.0", "max_force_n = -1", "actuator.max_force_n: -1 is out of range"),
    (MODBUS, 'value = "faults"', 'value = "fault"', "faults.value: there is no value 'fault'; did you mean 'faults'?"),
    (MODBUS, 'state = "contact"', 'state = "running"', '"running" is not a state of this actuator'),
    (MODBUS, 'when = "state"\nequals = [2]', 'when = "states"\nequals = [2]', "there is no value 'states'"),
    (MODBUS, 'title = "TODO: maker and model"', "", ":1: title: is missing"),
    (LINES, 'send = "?"', 'sent = "?"', "asks.status.sent: unknown key; did you mean 'send'?"),
    (LINES, "(?P<state>[UDCL])", "(?P<state>[UDCL]", "asks.status.answer: "),
    (LINES, 'force = ["F{asked:.2f}"]', 'force = ["F{force:.2f}"]', "commands.force: 'F{force:.2f}' cannot be sent"),
    (LINES, 'retract = ["R"]', "", "commands.retract: is missing, and every actuator needs it"),
    (
        LINES,
        'position = { unit = "mm" }',
        'position = { unit = "N" }',
        "values.position.unit: 'N' is not a unit of length",
    ),
    (LINES, 'position = { unit = "mm" }', 'posn = { unit = "mm" }', "values.posn: no answer has a group 'posn'"),
    (LINES, 'unit = "N",', 'unit = "n",', "values.force.unit: unit 'n' is not known"),
    (
        SPINDLE,
        'unit = "Hz"\nscale = 0.01\n# Bits',
        'unit = "N"\n# Bits',
        "registers.speed.unit: 'N' is not a unit of speed",
    ),
    (SPINDLE, "[modbus]\n", "[lines]\n[modbus]\n", "a profile has one of [modbus], [lines]; this one has [modbus] and"),
    (SPINDLE, "[spindle]", "[force_sensor]\nrange_n = [0, 1]\n[spindle]", "a profile has one of [actuator], [spindle]"),
    (
        SPINDLE,
        "unit = 1\n",
        'unit = 1\nmax_registers = 1\n[registers.long]\naddress = 5\ntype = "u32"\n',
        "has 2 registers",
    ),
    (
        SPINDLE,
        "address = 0x2103",
        'address = 65535\ntype = "u32"',
        "registers.speed.address: 2 registers from there end",
    ),
    (SPINDLE, 'clear = ["control = 2"]', "", "faults.clears: "),
]


@pytest.mark.parametrize(("text", "old", "new", "said"), CASES, ids=[case[3][:40] for case in CASES])
def test_faults_are_reported_with_their_place(tmp_path: Path, text: str, old: str, new: str, said: str) -> None:
    assert text.count(old) >= 1
    broken = text.replace(old, new, 1)
    found = faults(tmp_path, broken)
    assert any(said in one for one in found), found
    assert all(re.match(r":\d+: ", one) for one in found), found


def test_the_place_is_the_line(tmp_path: Path) -> None:
    broken = MODBUS.replace('engage = ["command = 1"]', 'engage = ["comand = 1"]')
    (found,) = faults(tmp_path, broken)
    assert found.startswith(f":{line_of(broken, 'comand')}: commands.engage: ")


def test_unknown_names_are_reported_with_what_there_is() -> None:
    with pytest.raises(ConfigError, match=r"'delta_ms30' is not known; did you mean 'delta_ms300'\?"):
        profile_of("delta_ms30", Path())
    with pytest.raises(ConfigError, match=r"no_such\.toml"):
        profile_of("no_such.toml", Path("/nowhere"))
