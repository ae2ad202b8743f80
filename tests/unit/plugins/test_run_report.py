"""The run report: complete, offline, written whole, with a list of what is missing."""

from __future__ import annotations

import base64
import io
import json
import re
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from polishd.api import PolishdError, SurfaceStats
from polishd.config.tolerance import notation
from polishd.model.events import MapMeasured, PlanWritten, RemovalCheckFailed, RunFolderCompleted
from polishd.model.states import Outcome
from polishd.model.tolerance import LineResult
from polishd.plugins import run_report
from polishd.rendering.document import DocumentSection, Picture, Table, html
from polishd.reports import pictures, run_pictures
from polishd.reports.run_reader import ExecutedTimes, ReportSurface, read_folder
from polishd.reports.run_report import (
    CERTIFICATE,
    COLUMNS,
    DrawnSections,
    certificate_rows,
    run_report_document,
    write_report,
)
from polishd.reports.wording import VERDICTS, duration, indication, phase_durations, plain, when
from tests.unit.rendering.printed import require_legible

N = 24
PITCH_MM = 1.0
PER_PASS = ("maps", "dwell", "executed")


def disc() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radius in mm, the part, and its clear aperture."""
    axis = (np.arange(N) - (N - 1) / 2) * PITCH_MM
    radius = np.hypot(axis[None, :], axis[:, None])
    return radius, radius <= N / 2, radius <= N / 2 - 2


def heights(cycle: int) -> np.ndarray:
    radius, part, _ = disc()
    ripple = np.cos(radius / 2) + 0.2 * np.random.default_rng(cycle).standard_normal(radius.shape)
    return np.where(part, ripple * 20.0 / 4**cycle, np.nan)


def plan_arrays(points: int = 40) -> dict[str, np.ndarray]:
    x = np.linspace(-10, 10, points + 1)
    start = np.column_stack([x[:-1], np.sin(x[:-1]), np.zeros(points)])
    end = np.column_stack([x[1:], np.sin(x[1:]), np.zeros(points)])
    time_s = np.linspace(0.1, 0.5, points)
    return {
        "time_s": time_s,
        "expected_s": time_s + 0.005,
        "lower_s": np.full(points, 0.1),
        "compliance_um_per_n": np.linspace(1.2, 1.5, points),
        "gamma": np.linspace(0.90, 0.87, points),
        "start_mm": start,
        "end_mm": end,
        "predicted_removal_nm": np.ones((N, N)),
        "residual_nm": heights(2),
    }


def write_cycle(folder: Path, cycle: int, *, passed: bool, executed: bool = True) -> dict[str, Any]:
    """Write a cycle's files; returns its entry in the summary."""
    folder.mkdir(parents=True, exist_ok=True)
    _, part, clear = disc()
    arrays = {"height_nm": heights(cycle), "solve_mask": part, "metric_mask": clear}
    np.savez_compressed(folder / "surface.npz", pitch_mm=PITCH_MM, **arrays)
    entry: dict[str, Any] = {"rms_nm": 20.0 / 4**cycle, "pv_nm": 60.0 / 4**cycle, "lsf_rms_nm": 1.0, "rate": 0.95}
    entry |= {"band_rms_nm": None, "predicted_rms_nm": None, "dwell_s": None, "executed_s": None}
    if not passed:
        return entry
    plan = plan_arrays()
    np.savez_compressed(folder / "plan.npz", **plan)
    certificate = {"solver": "gradient <&>", "kkt_residual": 3.1e-5, "cross_check": None, "notes": ["one", "two"]}
    (folder / "certificate.json").write_text(json.dumps(certificate))
    (folder / "program.rnc").write_text("G1 X1 F100\n")
    if executed:
        ends = np.concatenate([[0.0], np.cumsum(plan["expected_s"] * 1.01)])
        rows = ["seq,start_s,end_s,contact", "0,0,9,0"]
        rows += [f"{seq + 3},{ends[seq]:.9g},{ends[seq + 1]:.9g},1" for seq in range(len(plan["time_s"]))]
        (folder / "executed.csv").write_text("\n".join(rows) + "\n")
    return entry | {"predicted_rms_nm": 1.1, "dwell_s": 3700.0, "executed_s": 3750.0}


def write_summary(folder: Path, cycles: list[dict[str, Any]], **changes: Any) -> None:
    summary: dict[str, Any] = {"outcome": "in_tolerance", "job": "job", "part_id": "PART <1>", "correction": "exact"}
    summary |= {"tolerance_nm": 2.0, "tolerance_period_mm": 0.0, "cycles": cycles, "run_dir": str(folder)}
    summary |= {"started": "2025-11-21T03:31:12+00:00", "ended": None, "notes": ["rate & force learned"]}
    (folder / "summary.json").write_text(json.dumps(summary | changes))


def write_run(folder: Path, passes: int) -> Path:
    """Write a run with a number of passes and the measurement after them."""
    cycles = [write_cycle(folder / f"cycle-{cycle:02d}", cycle, passed=cycle < passes) for cycle in range(passes + 1)]
    write_summary(folder, cycles)
    return folder


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("polishd.rendering.plots.PAGE_DPI", 40)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not drawn, which takes the time."""
    monkeypatch.setattr("polishd.reports.run_report.png", lambda figure: b"")


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """One pass and the measurement after it."""
    return write_run(tmp_path / "run", 1)


@pytest.fixture
def plan_dir(tmp_path: Path) -> Path:
    """What ``polishd plan`` writes: one cycle in the folder itself."""
    folder = tmp_path / "plan"
    write_summary(folder, [write_cycle(folder, 0, passed=True, executed=False)], outcome="planned")
    return folder


def words_of(folder: Path) -> str:
    """The page without its pictures, which take the time."""
    return html(run_report_document(read_folder(folder), DrawnSections()))


def page_of(folder: Path) -> str:
    return write_report(folder).read_text()


def missing_in(page: str) -> str:
    """The page's own list of what it lacks, empty where it lists nothing."""
    return section(page, "Missing from this report")


def section(page: str, title: str) -> str:
    """A section of the page without its title; empty if there is none."""
    found = re.search(rf"<h2>{re.escape(title)}</h2>\n(.*?)</section>", page, re.DOTALL)
    return found.group(1) if found else ""


def pictures_in(page: str) -> list[bytes]:
    return [base64.b64decode(data) for data in re.findall(r'src="data:image/png;base64,([^"]+)"', page)]


class TestEvents:
    @pytest.mark.full
    @pytest.mark.one_of_each
    @pytest.mark.parametrize("kind", [partial(RunFolderCompleted, outcome="in_tolerance"), PlanWritten])
    def test_what_is_complete_is_reported_by_another_process(
        self, kind: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("polishd.reports.run_report.write_report", None)
        run_report.polishd_on_event(kind(run_dir=str(tmp_path)))
        assert (tmp_path / "report.html").is_file()

    @pytest.mark.full
    def test_a_report_that_fails_is_an_error_with_its_cause(self, tmp_path: Path) -> None:
        with pytest.raises(PolishdError, match="nowhere"):
            run_report.polishd_on_event(PlanWritten(run_dir=str(tmp_path / "nowhere")))

    def test_other_events_pass_by(self, run_dir: Path) -> None:
        stats = SurfaceStats(rms_nm=1.0, pv_nm=2.0, lsf_rms_nm=0.5)
        run_report.polishd_on_event(MapMeasured(stats=stats, spikes=0, notes=(), run_dir=str(run_dir)))
        assert not (run_dir / "report.html").exists()

    def test_loading_the_plugin_does_not_load_matplotlib(self) -> None:
        code = (
            "import sys, polishd.plugins.run_report as p; assert p.POLISHD_API == 1; print('matplotlib' in sys.modules)"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
        assert done.stdout.strip() == "False"


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two passes and the measurement after them, with the report; read only."""
    folder = write_run(tmp_path_factory.mktemp("report") / "run", 2)
    write_report(folder)
    return folder


class TestARun:
    @pytest.fixture
    def page(self, reported: Path) -> str:
        return (reported / "report.html").read_text()

    @pytest.mark.full
    def test_it_opens_offline(self, page: str) -> None:
        assert not re.search(r"https?://|src=\"(?!data:)|@import|url\(|<script|<link", page)

    @pytest.mark.full
    def test_every_picture_can_be_decoded_and_is_a_file_too(self, page: str, reported: Path) -> None:
        files = {file.read_bytes() for file in (reported / "pictures").glob("*.png")}
        embedded = pictures_in(page)
        assert files == set(embedded)
        for content in embedded:
            assert imread(io.BytesIO(content)).shape[0] > 100

    @pytest.mark.full
    def test_it_shows_every_pass_and_the_whole(self, page: str, reported: Path) -> None:
        expected = {"maps", "convergence", "psd", "cycle-00-compliance"}
        expected |= {f"cycle-{cycle:02d}-{kind}" for cycle in (0, 1) for kind in PER_PASS}
        assert {file.stem for file in (reported / "pictures").glob("*")} == expected

    def test_the_header_says_the_verdict_and_the_figures(self, page: str) -> None:
        assert '<p class="verdict good">In tolerance</p>' in page
        assert "20.00 → 1.25 nm" in page
        assert "2 h 05 min" in page
        assert "2025-11-21 03:31:12" in page

    def test_the_table_has_a_row_per_measurement_and_dashes_for_null(self, page: str) -> None:
        table = section(page, "Measurements")
        assert table.count("<tr>") == 4
        assert "–" in table.split("after pass 2")[1]
        assert "–" not in table.split("after pass 2")[0]
        assert "band RMS" not in table

    def test_each_figure_is_that_of_the_summary(self, page: str, reported: Path) -> None:
        summary = json.loads((reported / "summary.json").read_text())
        figures = re.findall(r'<data value="(.*?)" data-key="cycles\.(\d)\.(\w+)">(.*?)</data>', page)
        assert {key for _, _, key, _ in figures} >= {"rms_nm", "pv_nm", "predicted_rms_nm", "executed_s"}
        for value, cycle, key, shown in figures:
            meant = summary["cycles"][int(cycle)][key]
            assert float(value) == meant
            rounding = 0.5 * 10.0 ** -len(shown.partition(".")[2])
            assert float(shown.replace(",", "")) == pytest.approx(meant, abs=rounding * (1 + 1e-9))

    def test_the_certificate_is_there(self, page: str) -> None:
        assert page.count("Certificate of the dwell solution") == 2
        assert "<td>3.1e-05</td>" in page
        assert "<td>one; two</td>" in page

    def test_foreign_text_is_escaped(self, page: str) -> None:
        assert "PART &lt;1&gt;" in page
        assert "rate &amp; force learned" in page
        assert "gradient &lt;&amp;&gt;" in page

    def test_nothing_is_missing(self, page: str) -> None:
        assert missing_in(page) == ""

    def test_links_lead_to_files_beside_the_page(self, page: str, reported: Path) -> None:
        links = re.findall(r'href="([^"]+)"', page)
        assert "cycle-00/program.rnc" in links
        assert all((reported / link).is_file() for link in links)

    def test_no_partial_file_stays_and_others_can_read_it(self, reported: Path) -> None:
        assert not list(reported.rglob("*.tmp"))
        assert (reported / "report.html").stat().st_mode & 0o777 == 0o644


@pytest.mark.full
@pytest.mark.parametrize("passes", [0, 1, 2])
def test_every_picture_is_legible_on_paper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, passes: int) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr("polishd.reports.run_report.png", lambda fig: bytes(figures.append(fig) or b""))
    write_report(write_run(tmp_path / "run", passes))
    assert len(figures) == (2, 7, 10)[passes]
    for fig in figures:
        require_legible(fig)


def test_the_page_begins_with_the_result_and_ends_with_the_details(run_dir: Path) -> None:
    line = LineResult("PSD x f^2 of periods 5 to 30 mm", 31.0, 30.0, "nm^2 mm^2")
    rows = [{"rms_nm": 9.0, "judged": [line.facts()]}] * 2
    write_summary(run_dir, rows, outcome="cycles_used", notes=["a note"])
    chapters = words_of(run_dir).split("<article>")[1:]
    titles = [re.findall("<h[12]>(.*?)</h[12]>", chapter) for chapter in chapters]
    assert titles == [
        ["PART &lt;1&gt;", "Requirement and result"],
        ["Figures", "Measurements"],
        ["Details", "Notes"],
    ]
    assert "PSD × f² of periods 5 to 30 mm</th><td>nm² mm²</td>" in chapters[0]
    assert "ISO 10110-8" in chapters[0]
    assert "<td>fail</td>" in chapters[0]


@pytest.mark.parametrize(
    ("limits", "drawn"),
    [
        ({"3/B": 20.0}, "3/-(20)"),
        ({"3/A": 200.0}, "3/200"),
        ({"3/C": 5.0, "3/A": 200.0}, "3/200(-/5)"),
        ({"RMSi": 4.0, "3/B": 20.0, "3/C": 10.0}, "3/-(20/10); RMSi < 4"),
        ({"RMSt": 4.0, "PV": 8.0}, "RMSt < 4"),
        ({"RMS": 2.0}, ""),
    ],
)
def test_limits_of_form_are_written_as_in_a_drawing(limits: dict[str, float], drawn: str) -> None:
    assert indication([LineResult(what, 1.0, limit, "nm") for what, limit in limits.items()]) == drawn
    if drawn:
        known = {name.removeprefix("3/"): limit for name, limit in limits.items() if name != "PV"}
        assert notation(drawn) == known, "the config reads it"


FOREIGN = "<q a=\"1\" c='2'>{{ 7 * 7 }}&amp;</q>"


def test_whatever_a_file_says_is_text_on_the_page(tmp_path: Path) -> None:
    """In every field of the template: no tag, no attribute, no template code."""
    row = {column.key: 1.0 for column in COLUMNS} | {"notes": [FOREIGN], "how": FOREIGN, "executed_s": FOREIGN}
    summary = dict.fromkeys(("part_id", "job", "correction", "started", "outcome"), FOREIGN) | {"cycles": [row, row]}
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    folder = read_folder(tmp_path)
    folder.missing.append(FOREIGN)
    certificate = dict.fromkeys([*CERTIFICATE, FOREIGN], FOREIGN)
    picture = Picture("p", FOREIGN, b"png")
    tables = [Table((FOREIGN, FOREIGN), certificate_rows(certificate))]
    foreign = DocumentSection(FOREIGN, tables, [FOREIGN], [picture], [f"cycle-00/{FOREIGN}"])
    page = html(run_report_document(folder, DrawnSections(details=[foreign])))
    assert "<q" not in page
    assert "c='2'" not in page
    assert "49" not in page
    assert page.count("{{ 7 * 7 }}&amp;amp;") > len(CERTIFICATE) + 10
    assert f'src="data:image/png;base64,{base64.b64encode(b"png").decode()}"' in page
    assert 'href="cycle-00/%3Cq%20a%3D%221%22' in page


def test_a_section_that_holds_nothing_is_not_on_the_page(tmp_path: Path) -> None:
    page = html(run_report_document(read_folder(tmp_path), DrawnSections([DocumentSection("Nothing")])))
    assert "Nothing" not in page
    assert "Files:" not in page
    assert page.endswith("</html>\n")


@pytest.mark.full
def test_a_plan_shows_its_prediction(plan_dir: Path) -> None:
    page = page_of(plan_dir)
    assert '<p class="verdict plain">' in page
    assert missing_in(page) == ""
    names = {file.stem for file in (plan_dir / "pictures").glob("*")}
    assert names == {"maps", "psd", "plan-compliance", "plan-dwell"}


@pytest.mark.full
def test_what_was_said_of_a_map_and_of_a_pass_is_on_the_page(undrawn: None, run_dir: Path) -> None:
    rows = json.loads((run_dir / "summary.json").read_text())["cycles"]
    write_summary(run_dir, [{**rows[0], "notes": ["a tilt of 150 nm"], "found": ["the rate fell"]}, *rows[1:]])
    (run_dir / "cycle-01/learned.json").write_text(json.dumps({"notes": ["the rate <stays>"]}))
    (run_dir / "cycle-01/settling.json").write_text(json.dumps({"notes": ["settled: 3 maps"]}))
    (run_dir / "cycle-00/touch_off.json").write_text(json.dumps({"notes": ["the part sits 0.02 mm too high"]}))
    page = page_of(run_dir)
    notes = section(page, "Notes")
    assert "measurement 1: settled: 3 maps" in notes
    assert "measurement 0: the part sits 0.02 mm too high" in notes
    assert "measurement 0: a tilt of 150 nm" in notes
    assert "Pass 1: the rate fell" in notes
    assert "measurement 1: the rate &lt;stays&gt;" in notes
    assert "learned.json" not in missing_in(page), "a first measurement has none"


def test_a_tolerance_on_long_periods_is_judged_and_drawn_on_them(run_dir: Path) -> None:
    rows = [{"rms_nm": 9.0, "band_rms_nm": 8.0}, {"rms_nm": 3.0, "band_rms_nm": 1.0}]
    write_summary(run_dir, rows, tolerance_period_mm=7.0)
    assert "RMS, periods &gt; 7 mm</dt><dd>8.00 → 1.00 nm" in words_of(run_dir)
    steps = run_pictures.convergence_steps(rows, 7.0)
    legend = pictures.convergence_figure(steps, 2.0, "measured, periods above 7 mm").axes[0].get_legend()
    labels = [text.get_text() for text in legend.texts]
    assert "measured, periods above 7 mm" in labels
    assert "measured, all periods" in labels


def test_the_drawings_lines_stand_with_what_each_measurement_had(run_dir: Path) -> None:
    def judged(rms_nm: float, pv_nm: float) -> list[dict[str, Any]]:
        return [LineResult("RMS", rms_nm, 2.0, "nm", 0.2).facts(), LineResult("3/B", pv_nm, 20.0, "nm").facts()]

    rows = [{"rms_nm": 9.0, "judged": judged(9.0, 55.0)}, {"rms_nm": 1.8, "judged": judged(1.8, 22.0)}]
    write_summary(run_dir, rows, tolerance_nm=None)
    page = words_of(run_dir)
    assert "<dt>tolerance</dt><dd>1 of 2 lines hold</dd>" in page
    cells = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", page)]
    plain = [[re.sub("<.*?>", "", cell) for cell in row] for row in cells]
    assert ["RMS", "nm", "2", "9", "1.8", "0.2", "undecided, pass"] in plain
    assert ["3/B", "nm", "20", "55", "22", "not known", "fail"] in plain
    assert "ISO 10110-5:2015, nm of surface: 3/-(20)" in page


def test_by_what_a_part_is_accepted_stands_on_the_page(run_dir: Path) -> None:
    line = LineResult("RMS", 0.5, 2.0, "nm", 0.3, bound=1.25, removed="power")
    rows = [{"rms_nm": 0.5, "judged": [line.facts()], "system": "c" * 64}]
    write_summary(run_dir, rows, accept="bound_without_power")
    page = words_of(run_dir)
    bound = "by the 95 % bound of the true RMS, as its mount holds it, power removed"
    assert f"<dt>accepted</dt><dd>{bound}; the instrument&#39;s system map cccccccccccc is subtracted</dd>" in page
    assert "<td>at most 1.25</td><td>pass</td>" in page
    assert "RMS: at most 1.25 nm truly (95 %), guard band 0.75 nm, power removed; judged by this bound." in page
    write_summary(run_dir, [{"rms_nm": 0.5, "judged": [LineResult("RMS", 0.5, 2.0, "nm").facts()]}], accept="figure")
    assert "<dt>accepted</dt><dd>as measured</dd>" in words_of(run_dir)


def test_a_line_that_is_judged_with_hidden_ripple_says_so(run_dir: Path) -> None:
    line = LineResult("RMS", 1.9, 2.0, "nm", with_ripple=2.1, with_ripple_high=2.3)
    write_summary(run_dir, [{"rms_nm": 1.9, "judged": [line.facts()]}], accept="figure")
    page = words_of(run_dir)
    assert "<th>measured</th><th>with ripple</th>" in re.sub(' class="[^"]*"| scope="col"', "", page)
    row = next(row for row in re.findall(r"<tr>(.*?)</tr>", page) if "RMS</t" in row and "2.1" in row)
    assert re.sub("<.*?>", " ", row).split() == ["RMS", "nm", "2", "1.9", "2.1", "not", "known", "fail"]
    assert "With ripple: with the forecast ripple of the path that the map does not show. It decides." in page


@pytest.mark.full
def test_an_interrupted_pass_is_no_pass_like_the_others(undrawn: None, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    cycles = [write_cycle(folder / f"cycle-{cycle:02d}", cycle, passed=cycle < 3) for cycle in range(4)]
    for cycle, how in zip(cycles, ("done", "interrupted", "done", None), strict=True):
        cycle["how"] = how
    cycles[1] |= {"executed_s": 925.0, "predicted_rms_nm": 0.5, "uncertain": [[40, 43]]}
    write_summary(folder, cycles)
    page = page_of(folder)
    assert "<dt>passes</dt><dd>2, and 1 interrupted</dd>" in page
    rows = re.findall(r'<th scope="row">(start|after.*?)</th>', section(page, "Measurements"))
    assert rows == ["start", "after pass 1", "after an interrupted pass", "after pass 2"]
    assert "<td>925; interrupted at 25%; blocks 40 to 43 uncertain</td>" in page
    titles = re.findall(r"<h2>(.*?) \(cycle-\d\d\)</h2>", page)
    assert titles == [
        "Pass 1",
        "Pass that was interrupted at 25%; blocks 40 to 43 uncertain",
        "Pass 2",
        "Measurement after pass 2",
    ]
    steps = run_pictures.convergence_steps(cycles, 0.0)
    assert np.isnan([step.predicted_nm for step in steps]).tolist() == [True, False, True, False]
    assert [step.interrupted for step in steps] == [False, False, True, False]


class TestWhatIsMissing:
    @pytest.mark.parametrize(("outcome", "kind"), [("diverged", "bad"), ("as_programmed", "good"), ("new", "plain")])
    def test_an_outcome_has_its_color(self, run_dir: Path, outcome: str, kind: str) -> None:
        write_summary(run_dir, [], outcome=outcome)
        assert f'<p class="verdict {kind}">' in words_of(run_dir)

    def test_every_outcome_has_a_verdict(self) -> None:
        assert {*VERDICTS} == {*Outcome} | {"failed", "planned", ""}

    @pytest.mark.full
    def test_without_a_summary_the_run_is_called_unfinished(self, undrawn: None, run_dir: Path) -> None:
        (run_dir / "summary.json").unlink()
        page = page_of(run_dir)
        assert "Unfinished" in page
        assert "summary.json: not there" in missing_in(page)
        assert page.count("<img ") == 6

    def test_an_empty_folder_gets_a_page(self, tmp_path: Path) -> None:
        page = page_of(tmp_path)
        assert "no measurement was taken" in missing_in(page)
        assert pictures_in(page) == []

    @pytest.mark.full
    def test_a_pass_that_was_cut_short(self, tmp_path: Path) -> None:
        entry = write_cycle(tmp_path / "cycle-00", 0, passed=True, executed=False)
        write_summary(tmp_path, [entry], outcome="stopped")
        page = page_of(tmp_path)
        assert "cycle-00/executed.csv: not there" in missing_in(page)
        assert (tmp_path / "pictures" / "cycle-00-maps.png").is_file()

    @pytest.mark.parametrize("name", ["surface.npz", "plan.npz", "certificate.json", "executed.csv"])
    @pytest.mark.parametrize("content", [b"", b"PK\x03\x04 not really", b"\x00\xff\xfe"])
    def test_a_broken_file_is_named_and_the_rest_is_shown(self, run_dir: Path, name: str, content: bytes) -> None:
        (run_dir / "cycle-00" / name).write_bytes(content)
        folder = read_folder(run_dir)
        assert [entry.partition(":")[0] for entry in folder.missing] == [f"cycle-00/{name}"]
        assert folder.cycles[1].surface is not None

    @pytest.mark.full
    def test_a_broken_map_does_not_take_the_page_down(self, undrawn: None, run_dir: Path) -> None:
        (run_dir / "cycle-00" / "surface.npz").write_bytes(b"PK\x03\x04")
        page = page_of(run_dir)
        assert "cycle-00/surface.npz: cannot be read" in missing_in(page)
        assert (run_dir / "pictures" / "maps.png").is_file()
        assert (run_dir / "pictures" / "cycle-00-dwell.png").is_file()

    @pytest.mark.full
    def test_a_plan_that_lacks_an_array_loses_that_picture_only(self, undrawn: None, run_dir: Path) -> None:
        arrays = plan_arrays()
        del arrays["gamma"]
        np.savez(run_dir / "cycle-00" / "plan.npz", **arrays)
        assert "picture cycle-00-compliance: KeyError" in missing_in(page_of(run_dir))
        assert (run_dir / "pictures" / "cycle-00-dwell.png").is_file()

    @pytest.mark.full
    def test_a_prediction_on_another_grid_is_not_drawn(self, undrawn: None, run_dir: Path) -> None:
        np.savez(run_dir / "cycle-00" / "plan.npz", **(plan_arrays() | {"residual_nm": np.zeros((5, 5))}))
        assert "picture cycle-00-maps" in missing_in(page_of(run_dir))

    @pytest.mark.full
    def test_a_map_without_data_in_the_clear_aperture(self, undrawn: None, run_dir: Path) -> None:
        path = run_dir / "cycle-01" / "surface.npz"
        arrays = dict(np.load(path))
        np.savez(path, **(arrays | {"height_nm": np.full((N, N), np.nan)}))
        assert "picture psd" in missing_in(page_of(run_dir))

    @pytest.mark.full
    def test_a_summary_of_wrong_shape_is_no_obstacle(self, undrawn: None, run_dir: Path) -> None:
        (run_dir / "summary.json").write_text(
            '{"cycles": [null, {"rms_nm": "high"}], "notes": null, "tolerance_nm": "x"}'
        )
        assert "<h1>run</h1>" in page_of(run_dir)


class TestExecuted:
    def test_pieces_of_one_block_are_summed_and_air_moves_left_out(self, run_dir: Path) -> None:
        rows = "seq,start_s,end_s,contact\n1,0,5,0\n2,5,6,1\n2,6,6.5,1\n3,7,9,1\n"
        (run_dir / "cycle-00" / "executed.csv").write_text(rows)
        done = read_folder(run_dir).cycles[0].executed
        assert done is not None
        assert done.seq.tolist() == [2, 3]
        assert done.seconds.tolist() == [1.5, 2.0]

    def test_blocks_are_matched_by_number_where_the_plan_tells_it(self) -> None:
        done = ExecutedTimes(np.array([4, 7]), np.array([1.0, 3.0]))
        matched = done.per_point({"expected_s": np.ones(3), "block": np.array([4, 7, 8])})
        np.testing.assert_array_equal(matched, [1.0, 3.0, np.nan])

    def test_the_move_to_a_dwell_counts_for_its_point_as_it_does_in_learning(self) -> None:
        """The program of ``test_job.test_the_move_to_a_dwell_counts_for_its_point``."""
        done = ExecutedTimes(np.array([3, 5, 6]), np.array([1.5, 0.25, 2.25]))
        matched = done.per_point({"expected_s": np.ones(2), "block": np.array([3, 6])})
        np.testing.assert_array_equal(matched, [1.5, 2.5])

    def test_otherwise_in_order_where_the_counts_agree(self) -> None:
        plan = {"expected_s": np.ones(3)}
        assert ExecutedTimes(np.arange(3), np.ones(3)).per_point(plan) is not None
        assert ExecutedTimes(np.arange(2), np.ones(2)).per_point(plan) is None


class TestSpectrum:
    def test_its_integral_is_about_the_variance(self) -> None:
        # White noise: the density is flat, variance times the area of a sample.
        rng = np.random.default_rng(5)
        height = 3.0 * rng.standard_normal((128, 128))
        frequency, power = run_pictures.smooth_spectrum(height, np.ones((128, 128), dtype=bool), 0.5)
        flat = power[frequency > 0.1]
        np.testing.assert_allclose(flat.mean(), 9.0 * 0.25, rtol=0.05)

    def test_a_ripple_stands_at_its_own_frequency(self) -> None:
        x = np.arange(128) * 0.5
        height = np.broadcast_to(np.sin(2 * np.pi * x / 8.0), (128, 128))
        frequency, power = run_pictures.smooth_spectrum(height.copy(), np.ones((128, 128), dtype=bool), 0.5)
        assert frequency[np.argmax(power)] == pytest.approx(1 / 8.0, rel=0.1)

    def test_tilt_and_holes_do_not_matter_much(self) -> None:
        rng = np.random.default_rng(6)
        height = rng.standard_normal((96, 96))
        mask = np.ones((96, 96), dtype=bool)
        tilted = height + 40 * np.linspace(-1, 1, 96)[:, None]
        level, raised = (run_pictures.smooth_spectrum(one, mask, 1.0)[1] for one in (height, tilted))
        np.testing.assert_allclose(raised, level, rtol=0.3)
        tilted[40:44, 50:53] = np.nan
        assert np.isfinite(run_pictures.smooth_spectrum(tilted, mask, 1.0)[1]).all()


def test_the_rms_of_a_surface_is_about_its_mean() -> None:
    surface = ReportSurface(np.zeros((4, 6)), np.ones((4, 6), dtype=bool), 0.5)
    assert surface.rms_nm(np.arange(24.0).reshape(4, 6)) == pytest.approx(np.arange(24.0).std())


@pytest.mark.parametrize(
    ("value", "shown"), [(None, "none"), ([], "none"), (0.25, "0.25"), (123456.7, "123,457"), (3, "3")]
)
def test_certificate_values_as_text(value: object, shown: str) -> None:
    assert plain(value) == shown


def test_times_as_text() -> None:
    assert when(0) == "1970-01-01 00:00:00 UTC"
    assert when(None) == ""
    assert duration([{"dwell_s": 61.4}, {"dwell_s": None}], "dwell_s") == "1 min 01 s"
    assert duration([{}], "dwell_s") == ""


@pytest.mark.parametrize(
    ("times", "shown"),
    [
        ({"measure": 61.4, "touch_off": 30, "run": 7260.0}, "measure 1 min 01 s, touch-off 0 min 30 s, run 2 h 01 min"),
        ({"measure": "long"}, ""),
        (None, ""),
    ],
)
def test_what_each_phase_took_as_text(times: object, shown: str) -> None:
    assert phase_durations(times) == shown


@pytest.mark.full
def test_the_gates_picture_is_drawn_of_what_it_left(tmp_path: Path) -> None:
    grid = np.linspace(-1, 1, 40)[None, :] * np.ones((40, 1))
    mask = np.hypot(*np.meshgrid(grid[0], grid[0])) < 0.9
    maps = dict.fromkeys(("predicted_nm", "measured_nm", "explained_nm", "residual_nm", "best_residual_nm"), grid)
    np.savez(tmp_path / "gate.npz", **maps, metric_mask=mask, pitch_mm=0.5)
    best = {"name": "flipped left-right", "shift_mm": [0.5, 0.0], "correlation": 0.97}
    (tmp_path / "gate.json").write_text(json.dumps({"stop": "a flip", "correlation": 0.1, "best": best}))
    run_report.polishd_on_event(RemovalCheckFailed(cycle=1, stop="a flip", cycle_dir=str(tmp_path)))
    assert (tmp_path / "gate.png").read_bytes().startswith(b"\x89PNG")


def test_a_plan_states_the_ripple_that_its_path_adds(tmp_path: Path, undrawn: None) -> None:
    del undrawn
    folder = tmp_path / "plan"
    entry = write_cycle(folder, 0, passed=True, executed=False)
    one = {"direction": "across", "amplitude_nm": 1.2, "rms_nm": 0.85, "rms_high_nm": 1.02, "on_grid": 0.3}
    lines = [one | {"period_mm": 0.93}, one | {"period_mm": 0.46, "rms_nm": 0.07, "rms_high_nm": 0.24}]
    write_summary(folder, [entry | {"ripple": lines}], outcome="planned")
    found = section(page_of(folder), "Ripple that the path adds")
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", found, re.DOTALL)]
    assert ["0.93", "1.20", "0.85", "1.02"] in [row[-4:] for row in rows]
    assert [row[-2:] for row in rows][-1] == ["0.85", "1.05"]
