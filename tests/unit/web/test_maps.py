"""Maps and cell figure of a pass: values where they lie, figures of the aperture, and a sentence for what is wrong."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from polishd.config.cell import CellConfig
from polishd.config.job_file import JobFile
from polishd.daemon.journal.journal import ARRAYS_NAME, Journal
from polishd.daemon.journal.store import ArrayStore
from polishd.daemon.queue.queue import NewJob, Queue
from polishd.web import cell_figure
from polishd.web.map_data import MAP_KINDS
from tests.unit.web.page_server import Served, served

NY, NX, PITCH = 20, 24, 5.0
X, Y = np.meshgrid((np.arange(NX) - (NX - 1) / 2) * PITCH, ((NY - 1) / 2 - np.arange(NY)) * PITCH)
APERTURE = np.hypot(X, Y) < 40.0
SOLVED = np.hypot(X, Y) < 46.0
SPIKE = (4, 15)
"""Row and column of the highest sample: x = 17.5 mm, y = 27.5 mm."""


def surface(scale: float) -> dict[str, NDArray[Any]]:
    height = scale * (X / 40.0 + 0.5)
    height[SPIKE] = 9.0 * scale
    known = np.where(SOLVED, height, np.nan)
    return {"height_nm": known, "solve_mask": SOLVED, "metric_mask": APERTURE, "pitch_mm": np.array(PITCH)}


def plan() -> dict[str, NDArray[Any]]:
    """Lines along x, 5 mm apart, on which the dwell grows with y and gamma with x."""
    lines = [np.arange(-45.0, 46.0, 2.5)[:: (-1) ** k] for k in range(19)]
    points = np.concatenate([np.stack([x, np.full_like(x, -45.0 + 5 * k), 0 * x], 1) for k, x in enumerate(lines)])
    start = np.concatenate([points[:1], points[:-1]])
    middle = (start + points) / 2
    return {
        "block": np.arange(4, 4 + len(points)),
        "time_s": 0.2 + middle[:, 1] / 1000,
        "gamma": 0.9 + middle[:, 0] / 1000,
        "compliance_um_per_n": np.ones(len(points)),
        "start_mm": start,
        "end_mm": points,
        "predicted_removal_nm": np.where(SOLVED, 30.0, np.nan),
        "residual_nm": np.where(SOLVED, X / 40.0 + 7.0, np.nan),
    }


CELL = "/api/jobs/1/cycles/0/cell"


def fill(state: Path, planned: Mapping[str, Any] | None = None, *, job: str = "demo") -> None:
    """A job of two measurements with a pass between them, and a pass after the second."""
    store = ArrayStore(state / ARRAYS_NAME)
    with Journal.open(state, job=job, part_id="P", terms={}) as journal:
        for cycle, scale in enumerate((10.0, 2.0)):
            name = store.put(surface(scale))
            journal.record_map(cycle, "ab" * 32, "map.dat", {"rms_nm": scale, "judged": []}, name)
            facts = {"certificate": {}, "rate": 1.0}
            name = store.put(dict(planned or plan()))
            journal.begin_pass(cycle, "program", "boot", 700, contact=(4, 700), facts=facts, plan=name)
            journal.end_pass(cycle, "done")


@pytest.fixture
def web(tmp_path: Path) -> Iterator[Served]:
    with served(tmp_path) as found:
        yield found


def at(kind: str, query: str = "", cycle: int = 0) -> str:
    return f"/api/jobs/1/cycles/{cycle}/map/{kind}{query}"


def values_of(answer: Mapping[str, Any]) -> NDArray[np.float64]:
    if answer["encoding"] == "rows":
        return np.array(answer[answer["key"]], dtype=np.float64)
    flat = np.frombuffer(base64.b64decode(answer[answer["key"]]), "<f4")
    return flat.reshape(answer["ny"], answer["nx"]).astype(np.float64)


def place_of(answer: Mapping[str, Any], index: int) -> tuple[float, float]:
    row, column = divmod(index, answer["nx"])
    return answer["x0_mm"] + column * answer["pitch_mm"], answer["y0_mm"] - row * answer["pitch_mm"]


def test_each_kind_in_both_encodings(web: Served) -> None:
    fill(web.config.state_dir)
    for kind, what in MAP_KINDS.items():
        rows, packed = (web.ask("GET", at(kind, f"?encoding={one}")).json() for one in ("rows", "float32"))
        assert (rows["kind"], rows["key"], rows["unit"], rows["signed"]) == (kind, what.key, what.unit, what.signed)
        inside = np.unpackbits(np.frombuffer(base64.b64decode(packed["aperture"]), np.uint8))[: rows["ny"] * rows["nx"]]
        inside = inside.reshape(rows["ny"], rows["nx"]).astype(bool)
        assert np.isfinite(values_of(rows)).sum() == inside.sum() > 100, "rows have the aperture"
        assert np.isfinite(values_of(packed)).sum() > inside.sum(), "float32 has what lies around it, too"
        assert values_of(rows)[inside] == pytest.approx(values_of(packed)[inside], abs=1e-3)
        low, high = rows["scale"]
        assert low < high
        assert low == -high if what.signed else low == pytest.approx(rows["low"])


def test_a_sample_lies_where_it_was_measured_also_where_the_map_is_thinned(web: Served) -> None:
    fill(web.config.state_dir)
    for query in ("", "?px=12", "?encoding=float32&px=8"):
        found = web.ask("GET", at("measured", query)).json()
        values = values_of(found)
        x = np.array([place_of(found, k)[0] for k in range(values.size)])
        plain = np.isfinite(values.ravel()) & (values.ravel() < 50)
        assert values.ravel()[plain] == pytest.approx(10.0 * (x[plain] / 40.0 + 0.5), abs=1e-3)
        assert max(values.shape) <= (128 if not query else int(query.rpartition("=")[2]))
    whole = web.ask("GET", at("measured")).json()
    assert place_of(whole, int(np.nanargmax(values_of(whole)))) == (X[SPIKE], Y[SPIKE])
    assert whole["high"] == pytest.approx(90.0)


def test_the_residual_is_the_next_measurement_less_the_prediction(web: Served) -> None:
    fill(web.config.state_dir)
    found = values_of(web.ask("GET", at("residual")).json())
    after, predicted = surface(2.0)["height_nm"], plan()["residual_nm"]
    wanted = after - after[APERTURE].mean() - (predicted - predicted[APERTURE].mean())
    assert found[APERTURE] == pytest.approx(wanted[APERTURE], abs=1e-3)
    said = web.ask("GET", at("residual", cycle=1))
    assert said.status_code == 404
    assert said.json()["error"].endswith("no measurement after pass 1 yet")


def test_dwell_and_gamma_lie_along_the_path(web: Served) -> None:
    fill(web.config.state_dir)
    for kind, axis, per_mm, offset in (("dwell", 1, 1e-3, 0.2), ("gamma", 0, 1e-3, 0.9)):
        found = web.ask("GET", at(kind)).json()
        values = values_of(found)
        places = np.array([place_of(found, k)[axis] for k in range(values.size)])
        known = np.isfinite(values.ravel())
        assert np.abs((values.ravel()[known] - offset) / per_mm - places[known]).max() <= 5.0, "a line's distance"


@pytest.mark.parametrize(
    ("path", "status", "says"),
    [
        (at("height"), 404, "there is no such map: measured, predicted, residual"),
        (at("measured", cycle=7), 404, "none of that job and cycle"),
        (at("dwell", cycle=7), 404, "none of that job and cycle"),
        ("/api/jobs/9/cycles/0/cell", 404, "none of that job and cycle"),
        ("/api/jobs/9/cycles/0/plan", 404, "none of that job and cycle"),
        (at("measured", "?px=4"), 400, "px must be a whole number from 8 to 768"),
        (at("measured", "?px="), 400, "px must be a whole number"),
        (at("measured", "?px=769&encoding=float32"), 400, "from 8 to 768"),
        (at("measured", "?px=x"), 400, "px must be a whole number"),
        (at("measured", "?encoding=png"), 400, "encoding must be one of rows, float32"),
        ("/api/jobs/1/cycles/0/plan?points=1", 400, "points must be a whole number from 2"),
        ("/api/jobs/1/cycles/0/plan?points=-4", 400, "points must be a whole number from 2"),
    ],
)
def test_what_cannot_be_shown_is_said(web: Served, path: str, status: int, says: str) -> None:
    fill(web.config.state_dir)
    said = web.ask("GET", path)
    assert said.status_code == status
    assert says in said.json()["error"]


def without(key: str) -> dict[str, NDArray[Any]]:
    return {name: value for name, value in plan().items() if name != key}


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("planned", "kind"),
    [
        (without("residual_nm"), "predicted"),
        (plan() | {"residual_nm": np.zeros((3, 3))}, "residual"),
        (plan() | {"predicted_removal_nm": np.zeros(5)}, "removal"),
        (without("gamma"), "gamma"),
        (plan() | {"time_s": np.zeros(0)}, "dwell"),
        (plan() | {"end_mm": np.zeros((2, 3))}, "dwell"),
        (plan() | {"end_mm": np.full_like(plan()["end_mm"], np.nan)}, "gamma"),
    ],
)
def test_arrays_of_another_pass_are_refused(web: Served, planned: dict[str, NDArray[Any]], kind: str) -> None:
    fill(web.config.state_dir, planned)
    said = web.ask("GET", at(kind))
    assert (said.status_code, "it cannot be shown" in said.json()["error"]) == (400, True), said.text


@pytest.mark.parametrize("key", ["block", "time_s", "end_mm"])
def test_a_plan_that_is_none_has_no_cell(web: Served, key: str) -> None:
    fill(web.config.state_dir, without(key) if key == "block" else plan() | {key: np.full_like(plan()[key], np.nan)})
    said = web.ask("GET", CELL)
    assert (said.status_code, "it cannot be shown" in said.json()["error"]) == (400, True), said.text


def test_a_map_without_a_finite_value_is_empty(web: Served) -> None:
    fill(web.config.state_dir, plan() | {"residual_nm": np.full((NY, NX), np.inf)})
    found = web.ask("GET", at("predicted")).json()
    assert (found["scale"], {one for row in found["height_nm"] for one in row}) == ([-1.0, 1.0], {None})


@pytest.mark.parametrize("damage", ["missing", "cut", "no arrays"])
def test_a_damaged_file_of_the_store_is_named(web: Served, damage: str) -> None:
    state = web.config.state_dir
    fill(state)
    store = ArrayStore(state / ARRAYS_NAME)
    if damage == "no arrays":
        with Journal.open(state, job="next", part_id="P", terms={}) as journal:
            journal.record_map(0, "ab" * 32, "map.dat", {"rms_nm": 1.0, "judged": []}, store.put(b"no archive"))
        said = [web.ask("GET", "/api/jobs/2/cycles/0/map/measured")]
    else:
        for path in store.folder.iterdir():
            path.unlink() if damage == "missing" else path.write_bytes(path.read_bytes()[:-9])
        said = [
            web.ask("GET", at("measured")),
            web.ask("GET", at("gamma")),
            web.ask("GET", "/api/jobs/1/cycles/0/cell"),
        ]
    for one in said:
        assert (one.status_code, one.json()["error"].startswith("arrays ")) == (503, True), one.text
    assert web.ask("GET", "/api/state").status_code == 200


def test_the_cell_has_robot_path_and_part(web: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    fill(web.config.state_dir)
    computed = []
    was = cell_figure.cell_figure

    def counted(config: CellConfig, planned: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        computed.append(1)
        return was(config, planned)

    monkeypatch.setattr(cell_figure, "cell_figure", counted)
    found, again = (web.ask("GET", CELL).json() for _ in range(2))
    assert found == again
    assert computed == [1], "once"
    assert (found["robot"], found["problem"], found["up"]) == ("hybrid", "", [0.0, 0.0, -1.0])
    joints, path = np.array(found["poses"]["joints_mm"]), np.array(found["path"]["mm"])
    assert joints.shape == (len(found["poses"]["block"]), len(found["names"]), 3)
    assert joints[0, -1] == pytest.approx(path[0], abs=0.06), "the figure ends at the first point of the path"
    assert found["poses"]["block"][-1] == found["path"]["block"][-1] == plan()["block"][-1]
    origin = np.array(web.config.part.origin_mm)
    assert found["part"]["center_mm"] == pytest.approx(origin, abs=0.01)
    assert np.linalg.norm(np.array(found["part"]["rim_mm"]) - origin, axis=1) == pytest.approx(
        np.full(256, 50.0), abs=0.02
    )


def test_a_job_of_the_queue_has_its_own_part(web: Served, tmp_path: Path) -> None:
    state, cell = web.config.state_dir, web.config
    origin = list(np.add(cell.part.origin_mm, [0.0, 0.0, 40.0]).tolist())
    text = f'[job]\nid = "high"\n[part]\nid = "P2"\norigin_mm = {origin}\n'
    file = JobFile(tmp_path / "high.toml", text)
    with Queue.at_rest(state) as queue:
        queue.add([NewJob("high", "P2", file, {})])
    fill(state, job="high")
    with Queue.at_rest(state) as queue:
        queue.begin(queue.to_do()[0], 1)
    assert web.ask("GET", CELL).json()["part"]["center_mm"][2] == pytest.approx(origin[2])


def test_a_pose_out_of_reach_leaves_path_and_part(web: Served) -> None:
    far = plan()
    far["end_mm"] = far["end_mm"] + [0.0, 0.0, 3000.0]
    fill(web.config.state_dir, far)
    found = web.ask("GET", CELL).json()
    assert "out of the workspace" in found["problem"]
    assert (found["poses"]["joints_mm"], len(found["path"]["mm"])) == ([], len(far["block"]))
    assert found["part"]["rim_mm"]
