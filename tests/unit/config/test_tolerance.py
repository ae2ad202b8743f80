"""The drawing's lines in a cell's file: what they become, and what is refused, by file, line and key."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from polishd.config.cell import CellConfig, load_config
from polishd.config.tolerance import notation
from polishd.model.errors import ConfigError
from polishd.model.tolerance import ToleranceLine

EXAMPLE = Path(__file__).parents[3] / "examples" / "cell.toml"
SHORT = "tolerance_nm = 2.0 "


def cell(tmp_path: Path, lines: str, *, short: bool = False, alignment: str = "tilt") -> CellConfig:
    text = EXAMPLE.read_text().replace('alignment = "tilt"', f'alignment = "{alignment}"')
    text = text if short else text.replace(SHORT, "# ")
    path = shutil.copy(EXAMPLE, tmp_path / "cell.toml")
    path.write_text(f"{text}\n{lines}")
    return load_config(path)


def refusal(tmp_path: Path, lines: str, **how: object) -> str:
    with pytest.raises(ConfigError) as refused:
        cell(tmp_path, lines, **how)  # type: ignore[arg-type]
    return str(refused.value).removeprefix(f"{tmp_path}/")


@pytest.mark.parametrize(
    ("keys", "line", "what"),
    [
        ("rms_nm = 2.0", ToleranceLine("rms", 2.0), "RMS"),
        ("pv_nm = 9.0\nperiods_below_mm = 5.0", ToleranceLine("pv", 9.0, below_mm=5.0), "PV of periods below 5 mm"),
        (
            "slope_rms_urad = 0.7\nintegration_mm = 2.0\nperiods_above_mm = 4.0",
            ToleranceLine("slope_rms", 0.7, above_mm=4.0, integration_mm=2.0),
            "slope RMS over 2 mm of periods above 4 mm",
        ),
        (
            "psd_nm2_mm2 = 30.0\nexponent = 1.5\nperiods_above_mm = 1.0\nperiods_below_mm = 20.0",
            ToleranceLine("psd", 30.0, 1.0, 20.0, exponent=1.5),
            "PSD x f^1.5 of periods 1 to 20 mm",
        ),
    ],
    ids=["rms", "pv", "slope", "psd"],
)
def test_a_line_of_the_file_is_a_line_of_the_drawing(tmp_path: Path, keys: str, line: ToleranceLine, what: str) -> None:
    (section,) = cell(tmp_path, f"[[tolerance]]\n{keys}").tolerance
    assert section.lines == (line,)
    assert line.what == what


@pytest.mark.parametrize(
    ("text", "limits"),
    [
        ("3/200(50/20)", {"A": 200, "B": 50, "C": 20}),
        ("3/ 2 (0,5 / 0,25)", {"A": 2, "B": 0.5, "C": 0.25}),
        ("3/-(1)", {"B": 1}),
        ("3/4", {"A": 4}),
        ("3/-; RMSi < 5", {"RMSi": 5}),
        ("3/40(20/-); RMSt < 6; RMSa < 1.5", {"A": 40, "B": 20, "RMSt": 6, "RMSa": 1.5}),
        ("RMSi < 5", {"RMSi": 5}),
    ],
)
def test_form_tolerances_as_drawings_write_them(text: str, limits: dict[str, float]) -> None:
    assert notation(text) == limits


@pytest.mark.parametrize(
    "text", ["3/", "4/2(1)", "3/-(-/-)", "3/0(1)", "3/2(1/0.5", "3/2; RMSx < 1", "3/2; RMSi < 1; RMSi < 2"]
)
def test_what_is_no_form_tolerance_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r'^iso10110: .* write "3/200'):
        notation(text)


def test_fringes_are_half_the_wavelength(tmp_path: Path) -> None:
    (section,) = cell(tmp_path, '[[tolerance]]\niso10110 = "3/2(0.5)"\nwavelength_nm = 546.0').tolerance
    assert [(line.figure, line.limit) for line in section.lines] == [("A", 546.0), ("B", 136.5)]


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ("", "each [[tolerance]] has one of rms_nm, pv_nm, "),
        ("rms_nm = 2.0\npv_nm = 9.0", "this one has rms_nm, pv_nm"),
        ("slope_max_urad = 1.0", "integration_mm: "),
        ("psd_nm2_mm2 = 1.0\nperiods_above_mm = 1.0", "periods_below_mm: "),
        ("rms_nm = 1.0\nintegration_mm = 2.0", "integration_mm: needs slope_rms_urad or slope_max_urad, not rms_nm"),
        (
            "rms_nm = 1.0\nperiods_above_mm = 5.0\nperiods_below_mm = 2.0",
            "periods_below_mm: 2 leaves no period above 5",
        ),
        ('iso10110 = "3/2"\nperiods_above_mm = 5.0', "periods_above_mm: needs rms_nm or"),
        ('iso10110 = "3/x"', "iso10110: '3/x' is not a form tolerance of ISO 10110-5"),
        ("rms = 2.0", "unknown key; did you mean 'rms_nm'?"),
    ],
)
def test_half_a_line_is_refused_where_it_stands(tmp_path: Path, keys: str, says: str) -> None:
    said = refusal(tmp_path, f"[[tolerance]]\nrms_nm = 3.0\n\n[[tolerance]]\n{keys}")
    line = len(EXAMPLE.read_text().splitlines()) + 4
    file, number, rest = said.split(":", 2)
    assert (file, int(number) >= line) == ("cell.toml", True), said
    assert says in rest


def test_one_form_or_the_other(tmp_path: Path) -> None:
    lines = "[[tolerance]]\nrms_nm = 3.0"
    assert "job.tolerance_nm: there are [[tolerance]] lines, too; keep one" in refusal(tmp_path, lines, short=True)
    assert "job.tolerance_nm: is missing; add it: tolerance_nm = ..., or the drawing's lines" in refusal(tmp_path, "")


def test_the_power_is_not_judged_where_it_is_alignment(tmp_path: Path) -> None:
    lines = '[[tolerance]]\niso10110 = "3/20(5)"'
    assert "tolerance: 3/A " in refusal(tmp_path, lines, alignment="power")


@pytest.mark.parametrize("accept", ["bound", "bound_without_power"])
def test_what_has_no_bound_is_not_accepted_by_one(tmp_path: Path, accept: str) -> None:
    text = EXAMPLE.read_text().replace(SHORT, f'accept_by = "{accept}"\ntolerance_nm = 2.0 ')
    path = tmp_path / "cell.toml"
    path.write_text(text)
    assert load_config(path).job.accept_by == accept
    for wrong, words in (
        (text.replace('alignment = "tilt"', 'alignment = "piston"'), "part.alignment"),
        (text.replace("tolerance_nm = 2.0", "#") + "\n[[tolerance]]\npv_nm = 9.0\n", "a bound needs"),
        (
            text.replace("tolerance_nm = 2.0", "#") + "\n[[tolerance]]\nrms_nm = 9.0\nperiods_below_mm = 5.0\n",
            "a bound needs",
        ),
    ):
        path.write_text(wrong)
        with pytest.raises(ConfigError, match=rf"cell\.toml:\d+: job\.accept_by: {words}"):
            load_config(path)
