"""The questions of ``polishd init``: what is asked, what follows from a wrong answer, and from a mere Return."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from polishd.cli.app import app
from polishd.commissioning.init.answers import Answers
from polishd.commissioning.init.connected import Connected, MapFolder, SerialPort, can_interfaces, map_folders
from polishd.commissioning.init.draft import draft_cell
from polishd.commissioning.init.questions import Question, ask_questions
from polishd.config.cell import load_config
from polishd.plugin_loader import load_own

NOTHING = Connected()


class Person:
    """Types what was prepared for a key, one after another, and else takes the default."""

    def __init__(self, **typed: list[str]) -> None:
        self.typed = {key.replace("__", "."): list(answers) for key, answers in typed.items()}
        self.questions: list[Question] = []
        self.problems: list[tuple[str, str]] = []

    def __call__(self, question: Question, problem: str) -> str:
        self.questions.append(question)
        if problem:
            assert self.typed.get(question.key.lstrip("?")), (question, problem)  # else it would ask for ever
            self.problems.append((question.key, problem))
        prepared = self.typed.get(question.key.lstrip("?"))
        return prepared.pop(0) if prepared else str(question.default)


def answered(folder: Path, person: Person, connected: Connected = NOTHING) -> Answers:
    return ask_questions(folder / "cell", connected, load_own(), person)


@pytest.mark.full
def test_each_question_has_a_line_of_why_and_a_part_and_an_arm_become_their_answers(tmp_path: Path) -> None:
    person = Person(robot=["ur10e"], part__id=["M-7"], part__aperture_mm=["150"], surface=["sphere"])
    answers = answered(tmp_path, person)
    assert all(question.why.endswith((".", "]")) for question in person.questions)
    assert answers.own.kinematics.arm == "ur10e"
    assert answers.cell["part"] == {"id": "M-7", "aperture_mm": 150, "curvature_radius_mm": 800.0}


@pytest.mark.full
def test_what_only_got_a_return_is_still_to_be_looked_at(tmp_path: Path) -> None:
    person = Person(robot=["ur5e"], process__force_n=["9.5"])
    draft = draft_cell(answered(tmp_path, person), tmp_path / "cell", load_own())
    assert {"process.rpm", "robot.address", "job.tolerance_nm"} <= set(draft.assumed)
    assert "process.force_n" not in draft.assumed
    assert draft.raw["process"]["force_n"] == 9.5


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("key", "wrong", "right", "said"),
    [
        ("part__aperture_mm", "-5", "50", "is out of range"),
        ("process__preston", "1.49e-9", "2e-9 cm2/N", "unit"),
        ("shape", "square", "round", "is none of round, rectangle"),
        ("process__rpm", "fast", "700", "must be a number"),
    ],
)
def test_a_wrong_answer_is_reported_at_once_and_asked_again(
    tmp_path: Path, key: str, wrong: str, right: str, said: str
) -> None:
    person = Person(**{key: [wrong, right]})
    answered(tmp_path, person)
    ((asked_again, problem),) = person.problems
    assert asked_again.lstrip("?") == key.replace("__", ".")
    assert said in problem


@pytest.mark.full
def test_a_device_type_is_asked_what_it_cannot_do_without(tmp_path: Path) -> None:
    person = Person(
        robot__type=["plc_robot"],
        robot__profile=["", "plc-opcua"],
        robot__delivery=["folder:programs"],
        spindle__type=["spindle_profile"],
        spindle__profile=["delta_ms300"],
    )
    answers = answered(tmp_path, person)
    assert person.problems == [("robot.profile", "cannot be left out")]
    assert answers.cell["robot"]["address"] == "opc.tcp://robot-controller:4840"
    config = draft_cell(answers, tmp_path / "cell", load_own()).judged()
    assert {"devices"} <= set(config.plugins.load)


@pytest.mark.full
def test_a_usual_address_of_another_type_stays_said(tmp_path: Path) -> None:
    answers = answered(tmp_path, Person(actuator__type=["voice_coil_serial"]))
    config = draft_cell(answers, tmp_path / "cell", load_own()).judged()
    assert config.actuator.model_dump() == {"type": "voice_coil_serial", "address": "serial:/dev/ttyUSB0?baud=115200"}


@pytest.mark.full
def test_what_is_connected_becomes_the_defaults(tmp_path: Path) -> None:
    maps = MapFolder(tmp_path, tmp_path / "part.dat", "metropro")
    found = Connected((SerialPort("/dev/serial/by-id/usb-1", "FTDI"),), ("can0",), (maps,))
    person = Person()
    answered(tmp_path, person, found)
    defaults = {question.key: question.default for question in person.questions}
    assert defaults["actuator.address"] == "serial:/dev/serial/by-id/usb-1?baud=115200"
    assert defaults["spindle.address"] == "socketcand://127.0.0.1:29536/can0"
    assert defaults["metrology.folder"] == str(tmp_path)
    assert defaults["instrument.sample"] == str(tmp_path / "part.dat")


def test_can_interfaces_are_those_that_the_kernel_calls_so(tmp_path: Path) -> None:
    for name, kind in (("can1", "280"), ("eth0", "1"), ("can0", "280")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(f"{kind}\n")
    assert can_interfaces(tmp_path) == ("can0", "can1")


def test_a_folder_has_maps_where_the_newest_of_its_files_that_is_one_is_found(tmp_path: Path) -> None:
    with_maps, without = tmp_path / "maps", tmp_path / "notes"
    for folder in (with_maps, without):
        folder.mkdir()
        (folder / "note.dat").write_text("no map at all")
    rows = "\n".join(f"{x} {y} {np.sin(x + y):.4f}" for y in range(9) for x in range(9))
    (with_maps / "old.xyz").write_text(rows)
    os.utime(with_maps / "old.xyz", (0, 0))
    (found,) = map_folders([with_maps, without])
    assert (found.folder, found.sample.name) == (with_maps, "old.xyz")


@pytest.mark.full
def test_on_a_terminal_it_leaves_a_cell_and_its_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    typed = "\n".join(["", "ur10e", *[""] * 12, "M-7", "", "12", "-", *[""] * 12])
    said = CliRunner().invoke(app, ["init", "cell"], input=f"{typed}\n")
    assert said.exit_code == 0, said.output
    assert load_config(tmp_path / "cell" / "cell.toml").part.aperture_mm == 12
    assert 'arm = "ur10e"' in (tmp_path / "cell" / "answers.toml").read_text()
    again = CliRunner().invoke(app, ["init", "cell"])
    assert "answers.toml: there already" in str(again.exception)


@pytest.mark.full
def test_a_sample_that_does_not_say_its_units_is_asked_for_them(tmp_path: Path) -> None:
    sample = tmp_path / "points.xyz"
    sample.write_text("\n".join(f"{x} {y} {x + y}" for x in range(5) for y in range(5)) + "\n")
    person = Person(instrument__sample=[str(sample)], instrument__sample_units=["", "mm,um"])
    answers = answered(tmp_path, person)
    assert person.problems == [("instrument.sample_units", "cannot be left out")]
    assert answers.own.instrument.sample_units == "mm,um"
    assert "instrument.sample_pitch_mm" not in {question.key for question in person.questions}
