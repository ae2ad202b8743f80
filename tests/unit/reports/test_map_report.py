"""``polishd map report``: each number of the page is the JSON's, in HTML, in PDF and in a browser."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from polishd import __version__
from polishd.commissioning.rehearsal.simulated_cell import with_values
from polishd.config.tolerance import notation
from polishd.model.tolerance import ToleranceLine
from polishd.process.metrology.tolerance import judge_lines
from tests import time_limits
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import PITCH_MM, dat, surface
from tests.unit.rendering.printed import require_legible

TOLERANCE = """
[[tolerance]]
iso10110 = "3/-(200/-); RMSi < 20"

[[tolerance]]
psd_nm2_mm2 = 0.001
exponent = 2.0
periods_above_mm = 2.0
periods_below_mm = 10.0
"""
PARTS = [
    "Requirement and result",
    "Surface",
    "Primary aberrations",
    "ISO 10110-5 and ISO 10110-14",
    "Slope",
    "Spatial periods",
]
PARTS += ["Zernike terms", "Measurement", "Editions"]


@dataclass
class Page(HTMLParser):
    """A report's figures as text, value and key, its headings, its words, and all that it would fetch."""

    figures: list[tuple[str, str, str]] = field(default_factory=list)
    headings: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    fetched: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self.tag, self.attributes = "", dict[str, Any]()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tag, self.attributes = tag, dict(attrs)
        self.fetched += [str(value) for name, value in attrs if name in {"src", "href", "action", "srcset"}]

    def handle_endtag(self, tag: str) -> None:
        self.tag = ""

    def handle_data(self, data: str) -> None:
        if self.tag == "data":
            self.figures.append((data, self.attributes["value"], self.attributes["data-key"]))
        if self.tag == "h2":
            self.headings.append(data)
        if self.tag != "style":
            self.words.append(data)

    @property
    def pictures(self) -> int:
        return sum(one.startswith("data:image/png;base64,") for one in self.fetched)


def read(path: Path) -> Page:
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def at(answer: Any, key: str) -> Any:
    for step in key.split("."):
        answer = answer[int(step)] if isinstance(answer, list) else answer[step]
    return answer


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return dat(tmp_path / "good.dat", surface())


@pytest.fixture
def drawing(tmp_path: Path) -> Path:
    path = tmp_path / "tolerance.toml"
    path.write_text(TOLERANCE)
    return path


@pytest.mark.full
def test_each_number_of_the_page_is_the_json_s(polishd: Polishd, tmp_path: Path, good: Path, drawing: Path) -> None:
    out = tmp_path / "r.html"
    asked = ["--tolerance", drawing, "--mask", "circle:0,0,11", "--wavelength", "632.8", "--by", "A. <Optician>"]
    answer = polishd("map", "report", good, "--out", out, "--json", *asked).answer
    page = read(out)
    assert page.headings == PARTS
    for text, value, key in page.figures:
        meant = at(answer, key)
        assert float(value) == meant, key
        digits = len(text.partition(".")[2].partition("e")[0])
        rounding = 0.5 * 10.0**-digits if "." in text else max(0.5, abs(meant) * 1e-3)
        assert abs(float(text) - meant) <= rounding * (1 + 1e-9), (key, text, meant)
    keys = {key for _, _, key in page.figures}
    assert {"level.pv.waves", "level.rms.nm", "aberrations.coma.deg", "slope.rms_urad", "masks.0.samples"} <= keys
    assert {f"zernike.terms.{at}.nm" for at in range(36)} <= keys
    assert {f"tolerance.{at}.value" for at in range(3)} <= keys
    assert answer["level"]["pv"]["waves"] == answer["pv_tilt_removed_nm"] / 632.8
    words = " ".join(page.words)
    for said in (answer["indications"]["iso10110_5"], answer["indications"]["iso10110_14"], answer["sha256"],
                 "A. <Optician>", f"polishd {__version__}", "ISO 14999-4:2015", "blank-7", "circle:0,0,11",
                 "Not in tolerance: 2 of 3 lines hold", "tolerance.toml, over the samples that count"):  # fmt: skip
        assert said in words
    assert page.pictures == len(page.fetched) == 3


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("nm", [1000.0, 1.0])
@pytest.mark.parametrize("form", ["short", "lines"])
@pytest.mark.parametrize("alignment", ["tilt", "piston"])
def test_a_cell_judges_as_its_job_does(
    polishd: Polishd, tmp_path: Path, example: str, good: Path, nm: float, form: str, alignment: str
) -> None:
    """By its tolerance, short or long, and with what it calls alignment taken off; a file of lines goes before it."""
    cell, out = tmp_path / "cell.toml", tmp_path / "r.html"
    text = with_values(example, {"part": {"alignment": alignment}, "job": {"tolerance_nm": nm}})
    if form == "lines":
        text = "\n".join(line for line in text.splitlines() if not line.startswith("tolerance_"))
        text += f"\n[[tolerance]]\nrms_nm = {nm}\n"
    cell.write_text(text)
    answer = polishd("map", "report", good, "--cell", cell, "--out", out, "--json").answer
    (line,) = answer["tolerance"]
    assert (line["limit"], line["holds"], answer["within"]) == (nm, nm > 100, nm > 100)
    assert line["value"] == pytest.approx(answer["rms_tilt_removed_nm" if alignment == "tilt" else "rms_nm"])
    assert (answer["judged_by"], answer["alignment"]) == (str(cell), alignment)
    words = " ".join(read(out).words)
    assert f"{'In' if nm > 100 else 'Not in'} tolerance: {int(nm > 100)} of 1 lines hold" in words
    assert "cell.toml" in words
    drawing = tmp_path / "drawing.toml"
    drawing.write_text("[[tolerance]]\npv_nm = 5000.0\n")
    asked = ["--cell", cell, "--tolerance", drawing, "--out", out, "--json"]
    other = polishd("map", "report", good, *asked).answer
    assert ([one["what"] for one in other["tolerance"]], other["judged_by"]) == (["PV"], str(drawing))


@pytest.mark.full
def test_the_json_is_what_polishd_map_says_of_the_map(polishd: Polishd, tmp_path: Path, good: Path) -> None:
    figures = polishd("map", good, "--json", "--trim", "2").answer
    answer = polishd("map", "report", good, "--json", "--trim", "2", "--out", tmp_path / "r.html").answer
    assert {key: answer[key] for key in figures} == figures
    height = surface()
    level = answer["profiles"][0]
    peak = answer["peak"]
    assert level["through"] == "peak"
    assert level["nm"][peak["column"]] == peak["nm"] == max(one for one in level["nm"] if one is not None)
    # the bump is right of and above the middle: x 0.3 of 12 mm, y 0.2 of 15 mm
    assert abs(peak["x"] - 0.3 * PITCH_MM * height.shape[1] / 2) < 1.5
    assert abs(peak["y"] - 0.2 * PITCH_MM * height.shape[0] / 2) < 1.5


def aberrated() -> np.ndarray:
    """80 x 80 samples of a disc: known power, astigmatism, coma and spherical in fringe amplitudes."""
    y, x = np.meshgrid(np.linspace(1, -1, 80), np.linspace(-1, 1, 80), indexing="ij")
    r2, t = x**2 + y**2, np.arctan2(y, x)
    r = np.sqrt(r2)
    height = 40 * (2 * r2 - 1) + 25 * r2 * np.cos(2 * (t - np.radians(30)))
    height += 15 * (3 * r**3 - 2 * r) * np.cos(t + np.radians(60)) - 10 * (6 * r2**2 - 6 * r2 + 1)
    return np.where(r2 <= 1, height, np.nan)


@pytest.mark.parametrize("order", ["fringe", pytest.param("noll", marks=pytest.mark.full),
                                   pytest.param("ansi", marks=pytest.mark.full)])  # fmt: skip
def test_known_aberrations_come_back_in_any_ordering(polishd: Polishd, tmp_path: Path, order: str) -> None:
    path = dat(tmp_path / "a.dat", aberrated())
    answer = polishd("map", "report", path, "--json", "--out", tmp_path / "r.html", "--zernike", order).answer
    found = answer["aberrations"]
    assert found["power"]["nm"] == pytest.approx(40, rel=0.01)
    assert found["astigmatism"]["nm"] == pytest.approx(25, rel=0.01)
    assert found["astigmatism"]["deg"] == pytest.approx(30, abs=0.5)
    assert found["coma"]["nm"] == pytest.approx(15, rel=0.02)
    assert found["coma"]["deg"] == pytest.approx(-60, abs=1)
    assert found["spherical"]["nm"] == pytest.approx(-10, rel=0.02)


@pytest.mark.full
def test_the_surface_keeps_the_indication_and_no_tighter_one(polishd: Polishd, tmp_path: Path, good: Path) -> None:
    answer = polishd("map", "report", good, "--json", "--out", tmp_path / "r.html").answer
    said = answer["indications"]
    limits = notation(said["iso10110_5"])
    assert len(limits) == 6
    height = surface()
    mask = np.isfinite(height)
    lines = [ToleranceLine(figure, limit) for figure, limit in limits.items()]
    assert all(0.99 < one.excess <= 1 + 1e-4 for one in judge_lines(lines, height, mask, PITCH_MM))
    assert said["iso10110_14"].startswith("13/")
    twice = notation(said["iso10110_14"].removeprefix("1"))
    assert all(limit == pytest.approx(2 * limits[figure], rel=0.01) for figure, limit in twice.items())


@pytest.mark.full
def test_a_pdf_has_the_same_figures(polishd: Polishd, tmp_path: Path, good: Path, drawing: Path) -> None:
    out, page = tmp_path / "r.pdf", tmp_path / "r.html"
    assert polishd("map", "report", good, "--out", page, "--tolerance", drawing).code == 0
    assert polishd("map", "report", good, "--out", out, "--tolerance", drawing).code == 0
    assert out.read_bytes().startswith(b"%PDF-")
    require_figures(text_of(out), read(page))


def text_of(pdf: Path) -> str:
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext is not installed: apt-get install poppler-utils")
    return subprocess.run(["pdftotext", "-layout", pdf, "-"], capture_output=True, text=True, check=True).stdout


def require_figures(text: str, page: Page) -> None:
    """Each figure of the page as often as the page has it, at least, and its parts in their order."""
    words = re.split(r"\s+", text)
    for figure, _, key in page.figures:
        assert figure in words, key
        words.remove(figure)
    lines = [line.strip() for line in text.splitlines()]
    assert [line for line in lines if line in page.headings] == page.headings


@pytest.mark.full
def test_a_browser_prints_all_of_it(polishd: Polishd, tmp_path: Path, good: Path, drawing: Path) -> None:
    """Without a network: text, figures and pictures arrive on paper."""
    chromium = shutil.which("chromium")
    if chromium is None or shutil.which("pdfimages") is None:
        pytest.skip("chromium and pdfimages are not installed: apt-get install chromium poppler-utils")
    page, printed = tmp_path / "r.html", tmp_path / "printed.pdf"
    assert polishd("map", "report", good, "--out", page, "--tolerance", drawing).code == 0
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-pdf-header-footer"]
    options += [f"--user-data-dir={tmp_path / 'browser'}", f"--print-to-pdf={printed}"]
    command = [chromium, *options, page.as_uri()]
    subprocess.run(command, capture_output=True, check=True, timeout=time_limits.SOON_S)
    require_figures(text_of(printed), read(page))
    listed = subprocess.run(["pdfimages", "-list", printed], capture_output=True, text=True, check=True).stdout
    assert len(re.findall(r"^ +\d+ +\d+ image ", listed, re.MULTILINE)) == read(page).pictures


@pytest.mark.full
@pytest.mark.parametrize("shape", [(60, 48), (12, 120), (120, 12)], ids=["round", "wide", "tall"])
def test_every_picture_is_legible_on_paper(
    polishd: Polishd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, drawing: Path, shape: tuple[int, int]
) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr("polishd.reports.map_report.png", lambda fig: bytes(figures.append(fig) or b""))
    path = dat(tmp_path / "m.dat", surface(*shape))
    assert polishd("map", "report", path, "--out", tmp_path / "r.html", "--tolerance", drawing).code == 0
    assert len(figures) == 3
    for fig in figures:
        require_legible(fig)


@pytest.mark.full
def test_several_maps_and_one_that_is_none(polishd: Polishd, tmp_path: Path, good: Path) -> None:
    bare, out = dat(tmp_path / "bare.dat", surface(), pitch_mm=0.0), tmp_path / "r.pdf"
    said = polishd("map", "report", good, tmp_path / "missing.dat", bare, "--out", out, "--json")
    assert said.code == 8
    assert "missing.dat" in said.err
    first, second = map(json.loads, said.out.splitlines())
    assert first["psd"] is not None
    assert second["slope"] is second["psd"] is None
    assert second["place_unit"] == "px"
    assert any(reason.startswith("PSD: ") for reason in second["left_out"])
    assert text_of(out).count("Zernike terms") >= 2


@pytest.mark.full
def test_names_are_shown_as_they_are_or_escaped(polishd: Polishd, tmp_path: Path) -> None:
    """Markup, mathematics, and letters that the PDF's font has not."""
    name = "a <b>$x^2$ \u785d.dat"
    path, page, out = dat(tmp_path / name, surface(), part=""), tmp_path / "r.html", tmp_path / "r.pdf"
    for target in (page, out):
        assert polishd("map", "report", path, "--out", target).code == 0
    assert name in read(page).words
    assert "a <b>$x^2$ \\u785d.dat" in text_of(out)


@pytest.mark.full
def test_a_flat_map_and_one_of_few_samples(polishd: Polishd, tmp_path: Path) -> None:
    flat, few = np.zeros((30, 30)), surface(5, 4)
    flat[25:] = np.nan  # a file that ends in zeros was not written to its end
    for name, height in {"flat.dat": flat, "few.dat": few}.items():
        out = tmp_path / "r.html"
        answer = polishd("map", "report", dat(tmp_path / name, height), "--out", out, "--json").answer
        assert (answer["zernike"] is None) == (name == "few.dat")
        assert out.exists()
    assert any("too few" in reason for reason in answer["left_out"])


@pytest.mark.full
def test_a_strip_has_no_aberrations_of_a_circle(polishd: Polishd, tmp_path: Path) -> None:
    """Its terms are huge and cancel each other."""
    strip = np.random.default_rng(1).normal(0.0, 5.0, (120, 12))
    answer = polishd("map", "report", dat(tmp_path / "s.dat", strip), "--out", tmp_path / "r.html", "--json").answer
    assert answer["aberrations"] is None
    assert answer["zernike"]["condition"] > 1e3
    assert any(reason.startswith("aberrations: ") for reason in answer["left_out"])


@pytest.mark.parametrize(
    ("asked", "words", "code"),
    [
        (["--out", "r.png"], "r.png", 3),
        (["--out", "r.html", "--tolerance", "wrong.toml"], "wrong.toml:2: tolerance", 3),
        (["--out", "r.html", "--tolerance", "fine.toml"], "cannot be judged on this map", 8),
        pytest.param(["--out", "none/r.html"], "r.html", 3, marks=pytest.mark.full),
        pytest.param(["--out", "r.html", "--tolerance", "empty.toml"], "empty.toml", 3, marks=pytest.mark.full),
        pytest.param(["--out", "r.html", "--terms", "9"], "15", 2, marks=pytest.mark.full),
    ],
)
def test_what_cannot_be_is_refused(
    polishd: Polishd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: list[str], words: str, code: int
) -> None:
    monkeypatch.chdir(tmp_path)
    files: Mapping[str, str] = {
        "wrong.toml": "[[tolerance]]\nrms_nm = -1.0\n",
        "empty.toml": "",
        "fine.toml": "[[tolerance]]\nrms_nm = 1.0\nperiods_above_mm = 0.01\n",
    }
    for name, text in files.items():
        Path(name).write_text(text)
    said = polishd("map", "report", dat(tmp_path / "good.dat", surface()), *asked)
    assert said.code == code
    assert words in said.err
    assert not Path("r.html").exists()
