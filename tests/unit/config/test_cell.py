"""Configuration: values as written, and errors that name file, line, key and what to do."""

from __future__ import annotations

import pickle
import re
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, ValidationError

from polishd.config.cell import CellConfig, device_options, load_config
from polishd.config.process_sections import ComplianceSection, HybridSection, ProcessSection
from polishd.config.toml_loader import key_lines
from polishd.daemon.assembly import contact_limits
from polishd.hookspecs import DeviceType
from polishd.model.errors import ConfigError
from polishd.model.process import ComplianceOptions, HybridRobot, ToolProcess
from polishd.process.frames import rotation_from_rpy_deg


def line_of(text: str, fragment: str) -> int:
    """1-based line on which the fragment stands."""
    return text[: text.index(fragment)].count("\n") + 1


def replaced(text: str, key: str, line: str, section: str = "") -> str:
    """The text with the line of that key (in that section) replaced."""
    start = text.index(f"[{section}]") if section else 0
    match = re.compile(rf"^{key} *=.*$", re.MULTILINE).search(text, start)
    assert match is not None
    return text[: match.start()] + line + text[match.end() :]


def refused(tmp_path: Path, text: str, overrides: dict[str, Any] | None = None) -> str:
    path = tmp_path / "cell.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides)
    return str(caught.value).replace(f"{path}", "FILE")


def test_example_loads(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example)
    config = load_config(path)
    assert config.cell.name == "bench-cell"
    assert config.state_dir == tmp_path / "state"
    assert config.program_path == tmp_path / "program.rnc"
    assert config.run_dir is None
    assert config.robot.type == "robot_link"
    assert config.job.tolerance_nm == 2.0
    assert list(config.placement().origin_mm) == tomllib.loads(example)["part"]["origin_mm"]
    assert config.path == path


def test_example_shows_every_key_or_its_section_defaults(example: str) -> None:
    """A key that exists but is neither in the example nor has a default would make the example a lie."""
    shown = key_lines(example)
    for name, field in CellConfig.model_fields.items():
        assert (name,) in shown or name in {
            "include",
            "roles",
            "notify",
            "tolerance",
            "loader",
            "force_sensor",
            "monitor",
            "signals",
            "tools",
            "certificate",
            "shop",
            "opcua",
        }, name
        section: Any = HybridSection if name == "kinematics" else field.annotation
        for key, inner in getattr(section, "model_fields", {}).items():
            assert (name, key) in shown or not inner.is_required(), f"{name}.{key}"


@pytest.mark.parametrize("section", ["process", "program", "dwell", "job", "limits", "kinematics", "compliance"])
def test_defaults_are_those_of_the_example(example: str, section: str) -> None:
    model: Any = HybridSection if section == "kinematics" else CellConfig.model_fields[section].annotation
    for key, value in tomllib.loads(example)[section].items():
        field = model.model_fields[key]
        shown = tuple(value) if isinstance(value, list) else value
        if key == "preston":
            shown = float(value.removesuffix(" cm2/N"))
        assert field.is_required() or field.default == shown or key == "tolerance_nm", f"{section}.{key}"


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ('objective = "budget"', "dwell.budget_s: "),
        ('objective = "least"\ntarget_nm = 1.0', "dwell.target_nm: "),
    ],
)
def test_a_rule_of_the_curve_goes_with_its_figure(tmp_path: Path, example: str, keys: str, says: str) -> None:
    assert says in refused(tmp_path, replaced(example, "objective", keys, "dwell"))


def test_values_of_a_config_never_change(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example)
    config = load_config(path)
    with pytest.raises(ValidationError, match="frozen"):
        config.process.force_n = 100.0  # type: ignore[misc]
    again = pickle.loads(pickle.dumps(config))
    assert again == config
    assert again.path == path


@pytest.mark.parametrize(
    ("section", "noun"),
    [(ProcessSection, ToolProcess), (HybridSection, HybridRobot), (ComplianceSection, ComplianceOptions)],
    ids=["process", "kinematics", "compliance"],
)
def test_sections_have_the_keys_and_defaults_of_their_nouns(section: type[BaseModel], noun: Any) -> None:
    own = {"type"} if section is HybridSection else set()
    own |= (
        {"removal_model", "estimates", "correction", "grid_mm", "tif", "force_max_n"}
        if section is ProcessSection
        else set()
    )
    named = {field.name: field.name.removesuffix("_cm2_per_n") for field in fields(noun)}
    assert set(section.model_fields) - own == set(named.values())
    for field in fields(noun):
        assert section.model_fields[named[field.name]].default == field.default, field.name


def test_nouns_carry_the_configured_values(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example)
    values = {
        "process.force_n": 7.5,
        "process.part_poisson": 0.2,
        "kinematics.tool_length_mm": 333,
        "kinematics.stroke_mm": [900.0, 1500.0],
        "machine.corner_deg": 12.0,
        "limits.max_removal_nm": 55.0,
    }
    config = load_config(path, values)
    assert config.tool_process() == ToolProcess(force_n=7.5, part_poisson=0.2)
    assert config.robot_model() == HybridRobot(tool_length_mm=333.0, stroke_mm=(900.0, 1500.0))
    envelope = config.envelope()
    assert (envelope.corner_deg, envelope.max_removal_nm) == (12.0, 55.0)
    assert envelope.x_mm == config.machine.x_mm


@pytest.mark.parametrize(
    ("values", "most_n"),
    [
        ({"process.force_n": 12.0}, 18.0),
        ({"process.force_n": 2.0}, 4.0),
        ({"process.force_n": 12.0, "process.force_max_n": 15.5}, 15.5),
    ],
)
def test_the_largest_force_is_half_as_much_again_and_at_least_two_newton_more(
    tmp_path: Path, example: str, values: dict[str, Any], most_n: float
) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example)
    config = load_config(path, values)
    assert config.process.most_force_n == most_n
    assert contact_limits(config).force_max_n == most_n


def test_a_largest_force_that_regulation_may_have_is_refused(tmp_path: Path, example: str) -> None:
    said = refused(tmp_path, example, {"process.force_max_n": 15.0})
    assert "process.force_max_n: 15 N is within the regulation band: 12 N + 25% (limits.force_band) = 15 N" in said


def test_a_tool_has_a_largest_force_of_its_own(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example + "\n[tools.soft]\nforce_n = 4.0\n[tools.hard]\nforce_n = 10.0\nforce_max_n = 13.0\n")
    assert [turn.process.most_force_n for turn in load_config(path).turns] == [6.0, 13.0]


WRONG = [
    ("process", "force_n", 'force_n = "12"', "process.force_n: must be a number, not the string '12'"),
    ("process", "force_n", "force_n = true", "process.force_n: must be a number, not the truth value true"),
    ("process", "force_n", "force_n = nan", "process.force_n: nan is not allowed; must be a finite number"),
    ("process", "force_n", "force_n = inf", "process.force_n: inf is not allowed; must be a finite number"),
    ("process", "force_n", "force_n = -1", "process.force_n: -1 is out of range; must be at least 0.01"),
    ("process", "force_n", "forc_n = 12.0", "process.forc_n: unknown key; did you mean 'force_n'?"),
    ("touch_off", "force_n", "force_max_n = 1.0", "touch_off.force_max_n: 1.0 is out of range"),
    ("process", "dip_deg", "dip_deg = 90.0", "process.dip_deg: 90.0 is out of range; must be less than 90"),
    ("process", "correction", 'correction = "exakt"', "'power' or 'exact'; did you mean 'exact'?"),
    ("process", "correction", "correction = 1", "process.correction: 1 is not allowed; must be 'none'"),
    ("part", "edge_mm", "edge_mm = 50.0", "part.edge_mm: no clear aperture is left"),
    ("part", "origin_mm", "origin_mm = [1.0, 2.0]", "part.origin_mm: has too few entries"),
    ("part", "origin_mm", "origin_mm = [1, 2, 3, 4]", "part.origin_mm: has 4 entries; must have 3"),
    ("part", "origin_mm", 'origin_mm = [1, "x", 3]', "part.origin_mm: must be a number, not the string 'x'"),
    ("part", "origin_mm", "origin_mm = 3.0", "part.origin_mm: must be a list [...], not 3.0"),
    ("machine", "x_mm", "x_mm = [90.0, -90.0]", "machine.x_mm: [90.0, -90.0] is not a range"),
    ("machine", "min_feed_mm_s", "min_feed_mm_s = 60.0", "machine.min_feed_mm_s: must be less than max_feed_mm_s"),
    (
        "machine",
        "max_feed_mm_s",
        "max_feed_mm_s = 3000",
        "at most 1000 mm/s: if the data sheet says 3000 mm/min, write 50",
    ),
    (
        "machine",
        "accel_mm_s2",
        "accel_mm_s2 = 1e6",
        "machine.accel_mm_s2: 1000000.0 is out of range; must be at most 20",
    ),
    (
        "program",
        "format",
        'coverage = "some"',
        "program.coverage: 'some' is not allowed; must be 'aperture' or 'zone'",
    ),
    ("job", "max_cycles", "max_cycles = 4.5", "job.max_cycles: must be a whole number, not 4.5"),
    ("job", "max_cycles", "max_cycles = 0", "job.max_cycles: 0 is out of range; must be at least 1"),
    ("job", "id", 'id = "../x"', "job.id: '../x' is not allowed; use letters, digits"),
    ("plugins", "load", 'load = ["a", "a"]', "plugins.load: named twice: 'a'"),
    ("plugins", "load", 'load = ["a", 3]', 'plugins.load: must be a string in "quotes", not 3'),
    ("plugins", "load", "load = []", "plugins.load: has 0 entries; must have 1"),
    ("cell", "state_dir", 'state_dir = ""', "cell.state_dir: "),
    ("dwell", "cross_check", "cross_check = SOLVER", "dwell.cross_check: must be another solver than dwell.solver"),
    ("limits", "force_band", "force_band = 1.0", "limits.force_band: 1.0 is out of range; must be less than 1"),
]


@pytest.mark.parametrize(("section", "key", "line", "problem"), WRONG, ids=[row[2] for row in WRONG])
def test_wrong_values_are_named_by_file_line_and_key(
    tmp_path: Path, example: str, section: str, key: str, line: str, problem: str
) -> None:
    solver = re.search(r'^solver *= *(".*?")', example, re.MULTILINE)
    assert solver is not None
    text = replaced(example, key, line.replace("SOLVER", solver[1]), section)
    message = refused(tmp_path, text)
    start = text.index(f"[{section}]")
    expected = text[: text.index(line.split("=", maxsplit=1)[0] + "=", start)].count("\n") + 1
    assert message.startswith(f"FILE:{expected}: {section}.")
    assert problem in message
    assert "\n" not in message


def test_missing_key_is_placed_at_its_section(tmp_path: Path, example: str) -> None:
    text = replaced(example, "aperture_mm", "", "part")
    at = line_of(text, "[part]")
    assert refused(tmp_path, text) == (
        f"FILE:{at}: part.aperture_mm: is missing; add it: aperture_mm = ..., or, if the part is not round, one "
        "of rectangle_mm, hexagon_mm, polygon_mm, polygon_file"
    )


def test_missing_device_type(tmp_path: Path, example: str) -> None:
    text = replaced(example, "type", "", "spindle")
    assert refused(tmp_path, text) == f"FILE:{line_of(text, '[spindle]')}: spindle.type: is missing; add it: type = ..."


def test_misspelt_section_is_two_findings(tmp_path: Path, example: str) -> None:
    text = example.replace("[part]", "[prat]")
    first, second = refused(tmp_path, text).split("\n")
    assert first == "FILE:1: part: is missing; add it: a section [part]"
    assert second.startswith(f"FILE:{line_of(text, '[prat]')}: prat: unknown key; did you mean 'part'? Known here: ")


def test_all_findings_are_reported_at_once(tmp_path: Path, example: str) -> None:
    text = replaced(replaced(example, "force_n", "force_n = 0", "process"), "max_cycles", "max_cycles = 0", "job")
    assert [line.split(": ", 2)[1] for line in refused(tmp_path, text).split("\n")] == [
        "process.force_n",
        "job.max_cycles",
    ]


def test_section_that_is_a_value(tmp_path: Path, example: str) -> None:
    text = "limits = 3\n" + example[: example.index("[limits]")]
    assert refused(tmp_path, text).startswith("FILE:1: limits: must be a section, [limits], not 3")


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [("[robot]", "[robot", "']'"), ('"bench-cell"', "", "Invalid value"), ("[robot]", "[cell]", "declare")],
)
def test_syntax_errors_have_their_line(tmp_path: Path, example: str, old: str, new: str, what: str) -> None:
    message = refused(tmp_path, example.replace(old, new, 1))
    assert message.startswith(f"FILE:{line_of(example, old)}: this is not TOML: ")
    assert what in message


def test_unclosed_at_the_end_of_the_file(tmp_path: Path) -> None:
    assert refused(tmp_path, "a = 1\nb = [1,\n").startswith("FILE:3: this is not TOML")


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: cannot be read: No such file"):
        load_config(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        load_config(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b'a = "\xe4"\n')
    with pytest.raises(ConfigError, match=r"is not UTF-8 text \(byte 5\)"):
        load_config(tmp_path / "latin.toml")


def test_overrides_replace_one_key_and_its_errors_name_them(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example)
    plain, other = load_config(path), load_config(path, {"process.correction": "none"})
    assert other.process.correction == "none"
    assert other.process.model_copy(update={"correction": "exact"}) == plain.process
    assert plain.effective() != other.effective()
    assert plain.effective() == load_config(path).effective()
    message = refused(tmp_path, example, {"process.correction": "nine"})
    assert message.startswith("FILE (override): process.correction: 'nine' is not allowed")
    assert refused(tmp_path, example, {"a.b": 1}).startswith("FILE (override): a: unknown key")
    assert "cell.name.x: 'name' is not a section" in refused(tmp_path, example, {"cell.name.x": 1})


class Options(BaseModel):
    """A device's options that forgets to forbid unknown keys."""

    model_config = ConfigDict(strict=True)
    address: str
    unit: int = 1


def kind(name: str, port: Any, options: type[BaseModel] = Options) -> DeviceType:
    return DeviceType(name, port, options, lambda options, context: None)  # type: ignore[arg-type, return-value]


TYPES = {item.name: item for item in (kind("voice_coil_modbus", "actuator"), kind("cia402_spindle", "spindle"))}


def actuator(tmp_path: Path, example: str, lines: str) -> tuple[CellConfig, int]:
    start, end = example.index("[actuator]"), example.index("[spindle]")
    text = f"{example[:start]}[actuator]\n{lines}\n{example[end:]}"
    path = tmp_path / "cell.toml"
    path.write_text(text)
    return load_config(path), line_of(text, "[actuator]")


def test_device_options_are_those_of_the_type(tmp_path: Path, example: str) -> None:
    config, _ = actuator(tmp_path, example, 'type = "voice_coil_modbus"\naddress = "x"\nunit = 3')
    found, options = device_options(config, "actuator", TYPES)
    assert found is TYPES["voice_coil_modbus"]
    assert options == Options(address="x", unit=3)


@pytest.mark.parametrize(
    ("lines", "offset", "problem"),
    [
        (
            'type = "voice_coil"\naddress = "x"',
            1,
            "actuator.type: unknown type 'voice_coil'; did you mean 'voice_coil_mo",
        ),
        (
            'type = "other"\naddress = "x"',
            1,
            "unknown type 'other'. The loaded plugins have: 'voice_coil_modbus'; plugins.load",
        ),
        (
            'type = "cia402_spindle"\naddress = "x"',
            1,
            "actuator.type: 'cia402_spindle' is a spindle type",
        ),
        ('type = "voice_coil_modbus"', 0, "actuator.address: is missing; add it: address = ..."),
        ('type = "voice_coil_modbus"\naddress = 3', 2, "actuator.address: must be a string"),
        ('type = "voice_coil_modbus"\naddress = "x"\nunti = 3', 3, "actuator.unti: unknown key; did you mean 'unit'?"),
    ],
)
def test_wrong_device_sections(tmp_path: Path, example: str, lines: str, offset: int, problem: str) -> None:
    config, header = actuator(tmp_path, example, lines)
    with pytest.raises(ConfigError) as caught:
        device_options(config, "actuator", TYPES)
    assert str(caught.value).startswith(f"{config.path}:{header + offset}: actuator.")
    assert str(caught.value).count(problem.partition(":")[0]) == 1  # one message a fault
    assert problem in str(caught.value)


def test_own_findings_are_placed_too(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example)
    error = load_config(path).error("dwell.solver", "no plugin has it")
    assert str(error) == f"{path}:{line_of(example, 'solver =')}: dwell.solver: no plugin has it"


def test_key_lines_of_all_that_toml_has() -> None:
    text = (
        "top = 1 # [no.header]\n"
        "[a]\n"
        'b = """\n[not.a.header]\nx = 1\n"""\n'
        "c = [\n  1, # ]\n  2,\n]\n"
        'd.e = { f = 1, g = "}" }\n'
        "\"h i\" = '# no comment'\n"
        '[ j . "k.l" ]\n'
        "m=1\n"
        "[[n]]\n"
        "o = 2\n"
        "[n.p]\nq = 1\n"
        "[[n]]\n"
        "o = 3\n"
        "[[n.r]]\n"
        "s = 4\n"
    )
    assert key_lines(text) == {
        ("top",): 1,
        ("a",): 2,
        ("a", "b"): 3,
        ("a", "c"): 7,
        ("a", "d"): 11,
        ("a", "d", "e"): 11,
        ("a", "d", "e", "f"): 11,
        ("a", "d", "e", "g"): 11,
        ("a", "h i"): 12,
        ("j",): 13,
        ("j", "k.l"): 13,
        ("j", "k.l", "m"): 14,
        ("n",): 15,
        ("n", 0): 15,
        ("n", 0, "o"): 16,
        ("n", 0, "p"): 17,
        ("n", 0, "p", "q"): 18,
        ("n", 1): 19,
        ("n", 1, "o"): 20,
        ("n", 1, "r"): 21,
        ("n", 1, "r", 0): 21,
        ("n", 1, "r", 0, "s"): 22,
    }


@given(st.tuples(*[st.floats(-360, 360)] * 3))
def test_rotation_is_proper_and_intrinsic(angles: tuple[float, float, float]) -> None:
    rotation = rotation_from_rpy_deg(*angles)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    roll, pitch, yaw = (rotation_from_rpy_deg(*axis) for axis in np.diag(angles))
    np.testing.assert_allclose(rotation, roll @ pitch @ yaw, atol=1e-12)


def test_rotation_signs() -> None:
    np.testing.assert_allclose(rotation_from_rpy_deg(90, 0, 0) @ [0, 1, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rotation_from_rpy_deg(0, 90, 0) @ [0, 0, 1], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(rotation_from_rpy_deg(0, 0, 90) @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(rotation_from_rpy_deg(180, 0, 0), np.diag([1, -1, -1]), atol=1e-12)


# several tools


TOOLS = """
[tools.large]
tool_radius_mm = 60.0
passes = 2
[tools.small]
tool_radius_mm = 15.0
force_n = 6.0
position_mm = 4.0
tool_length_mm = 410.0
program = "fine.rnc"
"""


def test_each_tool_replaces_what_it_names_and_nothing_else(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example + TOOLS)
    cell = load_config(path)
    large, small = cell.turns
    assert (large.process.tool_radius_mm, large.process.force_n) == (60.0, cell.process.force_n)
    assert (small.process.tool_radius_mm, small.process.force_n) == (15.0, 6.0)
    assert small.touch_off is not None
    assert small.touch_off.position_mm == 4.0
    assert small.kinematics.tool_length_mm == 410.0
    assert (large.program_path, small.program_path) == (cell.program_path, tmp_path / "fine.rnc")
    assert (large.estimates.tool, small.estimates.tool) == ("large", "small"), "what is learned of each is its own"
    assert not large.tools
    assert load_config(path).of_tool("small").turns[0].process == small.process


def test_a_cell_without_tools_has_one_turn_itself(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example)
    cell = load_config(path)
    assert cell.turns == (cell,)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("passes = 2", "passes = 99", "job.max_cycles: is 4, but the tools have 100 passes; set it to 100 or more"),
        ("passes = 2", "passes = 0", "tools.large.passes: 0 is out of range; must be at least 1"),
        ("force_n = 6.0", "force = 6.0", "tools.small.force: unknown key; did you mean 'force_n'?"),
        ("force_n = 6.0", "force_n = -1.0", "tools.small.force_n: -1.0 is out of range"),
    ],
)
def test_wrong_tools_are_named_by_file_line_and_key(
    tmp_path: Path, example: str, old: str, new: str, said: str
) -> None:
    text = example + TOOLS.replace(old, new)
    found = refused(tmp_path, text)
    assert said in found
    key = "max_cycles" if "max_cycles" in said else new
    assert f"FILE:{line_of(text, key)}: " in found


def test_what_does_not_go_with_several_tools(tmp_path: Path, example: str) -> None:
    own = example.replace('# tool = "bonnet 7"', 'tool = "bonnet 7"')
    assert "estimates.tool: [tools]" in refused(tmp_path, own + TOOLS)
    start = example.index("[touch_off]")
    bare = example[:start] + example[example.index("[part_handling]", start) :]
    assert "tools.small.position_mm: needs [touch_off]" in refused(tmp_path, bare + TOOLS)


def test_what_is_wrong_with_a_tools_value_is_said_where_it_was_written(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(text := example + TOOLS)
    small = load_config(path).of_tool("small")
    line, other = line_of(text, "force_n = 6.0"), line_of(text, "dip_deg =")
    assert str(small.error("process.force_n", "is odd")) == f"{path}:{line}: tools.small.force_n: is odd"
    assert str(small.error("process.dip_deg", "is odd")) == f"{path}:{other}: process.dip_deg: is odd"
    assert f"tools.small.program: {path.parent}" not in str(small.error("program.path", "is missing"))
    assert "tools.small.program: is missing" in str(small.error("program.path", "is missing"))


def test_a_removed_device_type_is_refused_with_what_takes_its_place(tmp_path: Path, example: str) -> None:
    said = refused(tmp_path, example.replace('type = "cia402_spindle"', 'type = "spindle_can"', 1))
    assert "spindle.type: 'spindle_can' was removed or renamed. Write type = \"cia402_spindle\"" in said


# programs that take turns


def with_programs(example: str, programs: str) -> str:
    return example.replace('path = "program.rnc"', f"path = {programs}")


def test_programs_take_turns_in_the_order_of_their_list(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(with_programs(example, '["a.rnc", "sub/b.rnc", "c.rnc"]'))
    cell = load_config(path)
    assert cell.program_paths == (tmp_path / "a.rnc", tmp_path / "sub" / "b.rnc", tmp_path / "c.rnc")
    assert cell.program_path == tmp_path / "a.rnc"
    turns = [cell.program_of_pass(number).name for number in (1, 2, 3, 4, 5)]
    assert turns == ["a.rnc", "b.rnc", "c.rnc", "a.rnc", "b.rnc"]


def test_one_program_is_that_of_all_passes_also_in_a_list(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    for programs in ('"a.rnc"', '["a.rnc"]'):
        path.write_text(with_programs(example, programs))
        cell = load_config(path)
        assert [cell.program_of_pass(number) for number in (1, 2)] == [tmp_path / "a.rnc"] * 2


def test_each_tool_has_its_own_programs(tmp_path: Path, example: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example + TOOLS.replace('program = "fine.rnc"', 'program = ["fine.rnc", "finer.rnc"]'))
    large, small = load_config(path).turns
    assert large.program_paths == (tmp_path / "program.rnc",)
    assert small.program_paths == (tmp_path / "fine.rnc", tmp_path / "finer.rnc")


@pytest.mark.parametrize(
    ("programs", "said"),
    [
        ("[]", "must be the name of a file, or a list of them, such as"),
        ('""', "must be the name of a file, or a list of them, such as"),
        ("3", "must be the name of a file, or a list of them, such as"),
        ('["a.rnc", 3]', "must be the name of a file, or a list of them, such as"),
        ('["a.rnc", ""]', "must be the name of a file, or a list of them, such as"),
        ('["a.rnc", "./a.rnc"]', "names './a.rnc' twice; the programs take turns from pass to pass"),
        ('["a.rnc", "b.rnc", "a.rnc"]', "names 'a.rnc' twice; the programs take turns from pass to pass"),
    ],
)
def test_programs_that_cannot_take_turns_are_refused_in_one_line(
    tmp_path: Path, example: str, programs: str, said: str
) -> None:
    text = with_programs(example, programs)
    (line,) = refused(tmp_path, text).splitlines()
    number = text.splitlines().index(f"path = {programs}") + 1
    assert f"FILE:{number}: program.path: {said}" in line.replace("value error, ", "")


def test_a_tool_that_names_a_program_twice_is_refused_by_its_key(tmp_path: Path, example: str) -> None:
    text = example + TOOLS.replace('program = "fine.rnc"', 'program = ["fine.rnc", "fine.rnc"]')
    (line,) = refused(tmp_path, text).splitlines()
    assert "tools.small.program: names 'fine.rnc' twice" in line
