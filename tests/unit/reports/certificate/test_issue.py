"""``polishd certificate``: what is written, what stands on the pages, and one clear error for what cannot be."""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography.exceptions import InvalidSignature

from docs.reference import write
from polishd.cli.app import app
from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.rendering.document import HEIGHT_IN, MARGIN_IN, WIDTH_IN, html
from polishd.reports.certificate import issue
from polishd.reports.certificate.content import CertificateRequest, certificate_content
from polishd.reports.certificate.document import certificate_document
from polishd.reports.certificate.model import schema
from polishd.reports.certificate.sources import find_run
from polishd.web.run_files import RunFiles
from tests.unit.cli_result import Polishd
from tests.unit.reports.certificate.conftest import Made

DOCS = Path(__file__).resolve().parents[4] / "docs" / "how-to" / "certificate.md"
AT = datetime(2026, 11, 25, 12, 0, tzinfo=UTC)


def text_of(pdf: Path) -> str:
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext is not installed: apt-get install poppler-utils")
    return subprocess.run(["pdftotext", "-layout", pdf, "-"], capture_output=True, text=True, check=True).stdout


def page_of(files: DemoFiles, request: CertificateRequest) -> str:
    return html(certificate_document(certificate_content(find_run(files.run_dir, None), request, AT), ""))


def squeezed(text: str) -> str:
    return " ".join(text.split())


# the files


@pytest.mark.full
def test_without_out_it_goes_to_the_run_folder_where_the_page_offers_it(whole: Path, polishd: Polishd) -> None:
    said = polishd("certificate", "make", str(whole), "--number", "Q 7/4", "--json")
    assert said.code == 0, said.err
    assert json.loads(said.out)["pdf"] == str(whole / "certificate-Q-7-4.pdf")
    (offered,) = RunFiles(whole).facts()["certificates"]
    assert (offered["pdf"], offered["number"], offered["signed"]) == ("certificate-Q-7-4.pdf", "Q 7/4", None)
    assert polishd("certificate", "make", str(whole), "--number", "Q 7/4").code == 3, "it is never overwritten"
    again = polishd("certificate", "make", str(whole), "--number", "Q8")
    assert again.code == 0, again.err
    files = json.loads((whole / "certificate-Q8.json").read_text())["files"]
    assert not [one for one in files if one["name"].startswith("certificate-")], "others are no part of the run"


# the PDF


@pytest.mark.full
def test_every_page_says_of_which_certificate_it_is(certified: Made) -> None:
    twin = json.loads(certified.twin.read_text())
    pages = text_of(certified.pdf).rstrip("\f\n").split("\f")
    assert len(pages) == twin["pdf"]["pages"] >= 5
    for number, page in enumerate(pages, 1):
        head, foot = page.strip().splitlines()[0], page.strip().splitlines()[-1]
        assert squeezed(head) == f"Part DEMO-100 Certificate {twin['number']}, {twin['issued'][:10]}"
        assert foot.strip().endswith(f"page {number} of {len(pages)}")


@pytest.mark.full
def test_the_pages_say_what_the_twin_says(certified: Made) -> None:
    twin, text = json.loads(certified.twin.read_text()), squeezed(text_of(certified.pdf))
    for said in ("A. Meyer", "Observatory", "Example Optics", twin["verdict"]["words"], twin["number"]):
        assert said in text
    for title in (
        "Requirement and result", "Uncertainty", "Before and after, nm", "Beyond the reach of the tool", "Signature",
        "Masks", "Power spectra", "Primary aberrations", "ISO 10110-5 and ISO 10110-14", "Slope", "Spatial periods",
        "Zernike terms", "From map to map", "Anomalies", "Pass 1", "Pass 2", "Instrument",
        "Versions", "Journal", "Files of the run", "Editions",
    ):  # fmt: skip
        assert title in text, title
    for change in twin["changes"]:
        figures = f"{change['before_nm']:.3f} {change['after_nm']:.3f} {100 * change['change']:+.1f} %"
        assert f"{change['figure']} {figures}" in text
    assert twin["after"]["iso10110"]["indication"] in text
    assert twin["journal"]["sha256"] in text
    assert all(file["sha256"] in text for file in twin["files"])
    assert twin["seal"]["signature"]["key_id"] in text


@pytest.mark.full
def test_the_first_two_pages_are_for_the_customer(certified: Made) -> None:
    twin = json.loads(certified.twin.read_text())
    first, second, *others = map(squeezed, text_of(certified.pdf).rstrip("\f\n").split("\f"))
    front = (
        "Requirement and result",
        "Before and after",
        "RMS in the clear aperture",
        twin["verdict"]["words"],
        "pass",
    )
    assert [title for title in (*front, "Observatory", twin["part"]["id"]) if title not in first] == []
    figures = ("Before and after, nm", "Uncertainty", "Power spectra", twin["after"]["iso10110"]["indication"])
    assert [title for title in figures if title not in second] == []
    details = ("Instrument", "Pass 1", "Zernike terms", "Files of the run", "Signature The JSON file")
    assert [title for title in details if title in first + second or title not in " ".join(others)] == []


def test_each_word_is_inside_the_margins_and_large_enough(certified: Made, tmp_path: Path) -> None:
    text_of(certified.pdf)
    listed = tmp_path / "words.html"
    subprocess.run(["pdftotext", "-bbox", certified.pdf, listed], check=True)
    word = r'<word xMin="(.*?)" yMin="(.*?)" xMax="(.*?)" yMax="(.*?)">'
    places = [tuple(map(float, found)) for found in re.findall(word, listed.read_text())]
    assert len(places) > 500
    left, right = 72 * MARGIN_IN, 72 * (WIDTH_IN - MARGIN_IN)
    assert min(place[0] for place in places) > left - 1
    assert max(place[2] for place in places) < right + 1
    assert min(place[1] for place in places) > 0
    assert max(place[3] for place in places) < 72 * HEIGHT_IN
    assert min(place[3] - place[1] for place in places) >= 8.0, "letters of 8 pt are as high, with their space"


def test_one_rms_of_each_surface(certified: Made) -> None:
    """Another figure of the same map, on the solver's grid, stood beside it once."""
    twin, text = json.loads(certified.twin.read_text()), squeezed(text_of(certified.pdf))
    whole = [f"{one['rms_nm']:.3f}" for one in twin["measurements"]]
    stated = set(re.findall(r"(?:the next map has|RMS) (\d+\.\d{3})\b", text))
    assert stated <= {*whole}, "in words, in the table of changes, and for each pass"
    assert f"RMS {whole[0]} {whole[-1]}" in text


@pytest.mark.full
def test_an_interrupted_pass_looks_like_one(torn_files: DemoFiles) -> None:
    page = page_of(torn_files, CertificateRequest())
    assert "<h2>A pass that was interrupted at 32%; blocks 13 to 15 uncertain</h2>" in page
    assert page.count("<h2>Pass ") == 1
    assert "1, and 1 interrupted" in page
    assert "LinkError: robot: the link is silent" in page
    assert 'class="verdict bad">Not in tolerance: 0 of 1 lines hold' in page


@pytest.mark.full
def test_hostile_names_are_text(whole_files: DemoFiles) -> None:
    asked = CertificateRequest(operator="<script>", customer="$x^2$", drawing="100 % {{ x }}")
    page = page_of(whole_files, asked)
    assert "<script>" not in page
    assert "$x^2$" in page


# the verbs


@pytest.mark.full
def test_from_a_cell_with_its_key(polishd: Polishd, whole_files: DemoFiles, tmp_path: Path) -> None:
    assert polishd("certificate", "keygen", tmp_path / "shop.key", "--json").answer["private"] == str(
        tmp_path / "shop.key"
    )
    text = whole_files.cell.read_text() + f'\n[certificate]\nshop = "Example Optics"\nkey = "{tmp_path}/shop.key"\n'
    cell = tmp_path / "cell.toml"
    cell.write_text(text.replace('state_dir = "state"', f'state_dir = "{whole_files.state_dir}"'))
    made = polishd("certificate", "make", cell, "--out", tmp_path / "c.pdf", "--json").answer
    assert made["key_id"] is not None
    assert made["verdict"]["state"] == "in tolerance"
    assert json.loads((tmp_path / "c.json").read_text())["issuer"]["shop"] == "Example Optics"
    assert stat.S_IMODE((tmp_path / "c.pdf").stat().st_mode) == 0o644
    said = polishd("certificate", "verify", tmp_path / "c.pdf", "--key", tmp_path / "shop.key.pub")
    assert (said.code, said.out.count("\n")) == (0, 3)


@pytest.mark.full
def test_without_a_key_it_says_so(polishd: Polishd, whole: Path, tmp_path: Path) -> None:
    said = polishd("certificate", "make", whole, "--out", tmp_path / "c.pdf", "--number", "C-17")
    assert said.code == 0
    assert "certificate C-17" in said.out
    assert "not signed" in said.out
    verified = polishd("certificate", "verify", tmp_path / "c.json", "--json").answer
    assert (verified["number"], verified["right"], verified["signer"]) == ("C-17", True, "")


def test_what_is_wrong_is_said_and_is_exit_code_1(polishd: Polishd, signed: Made) -> None:
    signed.pdf.write_bytes(signed.pdf.read_bytes() + b"%")
    said = polishd("certificate", "verify", signed.pdf)
    assert said.code == 1
    assert "WRONG: part.pdf was changed" in said.out
    assert said.err.startswith("polishd: ")
    assert polishd("certificate", "verify", signed.pdf.with_name("none.pdf")).code == 3


def test_nothing_is_overwritten(polishd: Polishd, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "c.json").write_text("mine")
    said = polishd("certificate", "make", whole, "--out", out / "c.pdf")
    assert said.code == 3
    assert "c.json" in said.err
    assert [path.name for path in out.iterdir()] == ["c.json"]


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--out", "c.html"], "c.html"),
        (["--out", "none/c.pdf"], "none: is not a folder"),
        (["--out", "c.pdf", "--key", "none.key"], "none.key: cannot be read"),
        (["--out", "c.pdf", "--operator", "a\nb"], "--operator"),
        (["--out", "c.pdf", "--job", "x"], "--job"),
    ],
)
def test_bad_input_is_one_error_and_no_file(
    polishd: Polishd, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], said: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    monkeypatch.chdir(out)
    found = polishd("certificate", "make", whole, *options)
    assert (found.code, found.err.count("\n")) == (3, 1)
    assert said in found.err
    assert list(out.iterdir()) == []


def test_a_disk_that_is_full_leaves_neither(
    polishd: Polishd, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    out.mkdir()

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    monkeypatch.setattr(issue, "_drawn", lambda drawn, signed_by: (b"%PDF", 1))
    said = polishd("certificate", "make", whole, "--out", out / "c.pdf")
    assert said.code == 3
    assert "No space left on device" in said.err
    assert list(out.iterdir()) == []


# the schema


def test_the_published_schema_is_the_models() -> None:
    published = (write.FOLDER / write.CERTIFICATE).read_text()
    assert published == write.certificate(), "make reference writes it"
    assert json.loads(published) == schema()


def test_the_schema_is_strict_and_of_its_draft(polishd: Polishd) -> None:
    found = polishd("certificate", "schema").answer
    assert found["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    tables = [found, *found["$defs"].values()]
    assert all(table["additionalProperties"] is False for table in tables if table["type"] == "object")
    for table in tables:
        assert {*table["required"]} == {*table["properties"]}, "what is not known is null, and never left out"
    assert found["properties"]["schema"]["const"] == "polishd-certificate-1"


def test_the_command_line_has_it() -> None:
    group = next(one for one in app.registered_groups if one.name == "certificate")
    assert group.typer_instance is not None
    names = {command.name for command in group.typer_instance.registered_commands}
    assert names == {"make", "verify", "keygen", "schema"}


@pytest.mark.full
def test_ten_lines_of_python_verify_it_without_polishd(signed: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    """As docs/how-to/certificate.md has them."""
    (example,) = re.findall(r"^```python\n(.*?)^```", DOCS.read_text(), re.DOTALL | re.MULTILINE)
    monkeypatch.chdir(signed.pdf.parent)
    signed.pdf.rename("LENS-7.pdf")
    signed.twin.rename("LENS-7.json")
    exec(compile(example, str(DOCS), "exec"), {})
    text = Path("LENS-7.json").read_text().replace("A. Meyer", "B. Meyer")
    Path("LENS-7.json").write_text(text)
    with pytest.raises(InvalidSignature):
        exec(compile(example, str(DOCS), "exec"), {})
