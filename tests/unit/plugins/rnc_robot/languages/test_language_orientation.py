"""Orientations as robots write them: the tool axis points from the tip into the spindle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from polishd.plugins.rnc_robot.languages import read
from polishd.plugins.rnc_robot.languages.columns import Convention, is_rotation, tool_axis
from tests.unit.plugins.rnc_robot.languages.robot_programs import PROGRAMS, profile

H = 0.7071067811865476
# By hand: where the tool's z points in the base frame, for rotations that anyone can do with three fingers.
BY_HAND: list[tuple[str, Convention, str, list[float], list[float]]] = [
    ("quaternion, none", "quaternion", "", [1, 0, 0, 0], [0, 0, 1]),
    ("quaternion, half a turn about x", "quaternion", "", [0, 1, 0, 0], [0, 0, -1]),
    ("quaternion, a quarter about y", "quaternion", "", [H, 0, H, 0], [1, 0, 0]),
    ("quaternion, a quarter about x", "quaternion", "", [H, H, 0, 0], [0, -1, 0]),
    ("KUKA, none", "euler_deg", "ZYX", [0, 0, 0], [0, 0, 1]),
    ("KUKA, C = 180", "euler_deg", "ZYX", [0, 0, 180], [0, 0, -1]),
    ("KUKA, B = 90", "euler_deg", "ZYX", [0, 90, 0], [1, 0, 0]),
    ("KUKA, C = 90", "euler_deg", "ZYX", [0, 0, 90], [0, -1, 0]),
    ("KUKA, A = 90, B = 90: A turns the turned frame", "euler_deg", "ZYX", [90, 90, 0], [0, 1, 0]),
    ("KUKA, A = 90, C = 90", "euler_deg", "ZYX", [90, 0, 90], [1, 0, 0]),
    ("FANUC, W = 180", "euler_deg", "xyz", [180, 0, 0], [0, 0, -1]),
    ("FANUC, P = 90", "euler_deg", "xyz", [0, 90, 0], [1, 0, 0]),
    ("FANUC, W = 90, R = 90: R turns about the fixed z, last", "euler_deg", "xyz", [90, 0, 90], [1, 0, 0]),
    ("UR, half a turn about x", "rotation_vector_rad", "", [np.pi, 0, 0], [0, 0, -1]),
    ("UR, a quarter about y", "rotation_vector_rad", "", [0, np.pi / 2, 0], [1, 0, 0]),
    ("UR, none", "rotation_vector_rad", "", [0, 0, 0], [0, 0, 1]),
]


@pytest.mark.parametrize(("case", "convention", "axes", "values", "tool_z"), BY_HAND)
def test_by_hand(case: str, convention: Convention, axes: str, values: list[float], tool_z: list[float]) -> None:
    one = np.array([values], dtype=float)
    np.testing.assert_allclose(tool_axis(convention, axes, one, tool_z_into_part=False), [tool_z], atol=1e-12)
    np.testing.assert_allclose(tool_axis(convention, axes, one, tool_z_into_part=True), [-np.array(tool_z)], atol=1e-12)


def matrix(axis: str, angle_deg: float) -> np.ndarray:
    """The rotation about one axis, written out."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


angles = st.floats(-180, 180)


@given(angles, angles, angles)
def test_kuka_and_fanuc_are_one_rotation_in_two_orders(a: float, b: float, c: float) -> None:
    expected = (matrix("z", a) @ matrix("y", b) @ matrix("x", c))[:, 2]
    kuka = tool_axis("euler_deg", "ZYX", np.array([[a, b, c]]), tool_z_into_part=False)
    fanuc = tool_axis("euler_deg", "xyz", np.array([[c, b, a]]), tool_z_into_part=False)
    np.testing.assert_allclose(kuka[0], expected, atol=1e-12)
    np.testing.assert_allclose(fanuc[0], expected, atol=1e-12)


def in_languages(rotation: Rotation) -> dict[str, bytes]:
    """One point with this orientation, at the same place, in all four."""
    w, x, y, z = rotation.as_quat(scalar_first=True)
    a, b, c = rotation.as_euler("ZYX", degrees=True)
    rx, ry, rz = rotation.as_rotvec()
    position = (
        f"P[1]{{\n GP1:\n UF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n X = 10 mm, Y = 20 mm, Z = 30 mm,\n"
        f" W = {c:.9f} deg, P = {b:.9f} deg, R = {a:.9f} deg\n}};\n"
    )
    return {
        name: text.encode()
        for name, text in {
            "rapid": f"MODULE M\nPROC m()\nMoveL [[10,20,30],[{w:.12f},{x:.12f},{y:.12f},{z:.12f}],[0,0,0,0],"
            "[9E9,9E9,9E9,9E9,9E9,9E9]],v5,fine,t;\nWaitTime 1;\nENDPROC\nENDMODULE\n",
            "krl": f"DEF M()\nLIN {{X 10,Y 20,Z 30,A {a:.9f},B {b:.9f},C {c:.9f}}}\nWAIT SEC 1\nEND\n",
            "fanuc-tp": f"/PROG M\n/MN\n:L P[1] 5mm/sec FINE ;\n: WAIT 1(sec) ;\n/POS\n{position}/END\n",
            "urscript": f"def m():\nmovel(p[.01,.02,.03,{rx:.12f},{ry:.12f},{rz:.12f}])\nsleep(1)\nend\n",
        }.items()
    }


@pytest.mark.full
@given(st.integers(0, 2**32 - 1))
def test_one_pose_in_four_languages_is_one_pose(seed: int) -> None:
    rotation = Rotation.random(random_state=seed)
    expected = -rotation.as_matrix()[:, 2]
    for name, text in in_languages(rotation).items():
        program = read(profile(name), text, name)
        np.testing.assert_allclose(program.axis[0], expected, atol=1e-7, err_msg=name)
        np.testing.assert_allclose(program.end_mm[0], [10, 20, 30], atol=1e-9, err_msg=name)
        assert np.linalg.norm(program.axis[0]) == pytest.approx(1)


def test_a_tool_whose_z_points_out_of_the_part() -> None:
    for name, said in PROGRAMS.items():
        language = profile(name)
        if language.orientation.tool_z == "out_of_part":
            continue
        out = language.orientation.model_copy(update={"tool_z": "out_of_part"})
        program = read(language.model_copy(update={"orientation": out}), said.text, "part.txt")
        np.testing.assert_allclose(program.axis, -np.array(said.axis), atol=1e-6)


def test_what_is_no_rotation() -> None:
    assert is_rotation("quaternion", [0.7071, 0, 0.7071, 0])
    assert is_rotation("quaternion", [0.707, 0, 0.707, 0])
    assert not is_rotation("quaternion", [0.7, 0, 0.7, 0])
    assert not is_rotation("quaternion", [0, 0, 0, 0])
    assert not is_rotation("euler_deg", [0, np.inf, 0])
    assert not is_rotation("rotation_vector_rad", [np.nan, 0, 0])
    assert is_rotation("rotation_vector_rad", [7.0, 0, 0])


def test_no_orientations_give_no_axes() -> None:
    assert tool_axis("quaternion", "", np.zeros((0, 4)), tool_z_into_part=True).shape == (0, 3)
