"""What a certificate says: one truth, one figure for a surface, and an interrupted pass that looks like one."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.daemon.journal.store import connect
from polishd.model.errors import ConfigError
from polishd.model.states import Outcome
from polishd.model.surface import FloatArray
from polishd.process.metrology.spectra import split_bands
from polishd.reports.certificate.content import CertificateDraft, CertificateRequest, certificate_content
from polishd.reports.certificate.model import Content
from polishd.reports.certificate.sources import find_run, read_rows
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import PITCH_MM, dat
from tests.unit.reports.certificate.runs import CUTOFF_MM, begin, heights

Spoil = Callable[[Path], None]


def drawn(run: Path) -> CertificateDraft:
    return certificate_content(find_run(run, None), CertificateRequest())


@pytest.fixture(scope="module")
def whole_drawn(whole_files: DemoFiles) -> CertificateDraft:
    return drawn(whole_files.run_dir)


@pytest.fixture(scope="module")
def whole_content(whole_drawn: CertificateDraft) -> Content:
    return whole_drawn.content


@pytest.fixture(scope="module")
def torn_content(torn_files: DemoFiles) -> Content:
    return drawn(torn_files.run_dir).content


@pytest.mark.full
def test_a_whole_run_in_tolerance(whole_content: Content) -> None:
    verdict = whole_content.verdict
    assert (verdict.state, verdict.final, verdict.outcome) == ("in tolerance", True, "In tolerance")
    assert verdict.decided_by.startswith("RMS 0.")
    assert [one.name for one in whole_content.passes] == ["pass 1", "pass 2"]
    assert whole_content.anomalies == []
    assert whole_content.left_out == []
    assert whole_content.versions["polished by polishd"] == "0.1.0"


def test_a_surface_has_one_figure_wherever_it_is_reported(whole_drawn: CertificateDraft) -> None:
    content = whole_drawn.content
    for surface, measured, found in (
        (content.before, content.measurements[0], whole_drawn.before),
        (content.after, content.measurements[-1], whole_drawn.after),
    ):
        assert surface is not None
        assert found is not None
        assert (surface.rms_nm, surface.pv_nm) == (measured.rms_nm, measured.pv_nm)
        assert surface.bands is not None
        assert surface.bands[0].rms_nm == measured.lsf_rms_nm
        assert measured.lines[0].value == pytest.approx(measured.rms_nm, rel=1e-12)
        assert found.figure_nm[found.clear].std() == pytest.approx(measured.rms_nm, rel=1e-9), "as it is drawn"
        assert surface.iso10110 is not None
        assert surface.iso10110.rms_t_nm == pytest.approx(measured.rms_nm, rel=1e-9)
        assert np.count_nonzero(found.clear) == measured.samples
    changes = {one.figure: one for one in content.changes}
    assert changes["RMS"].after_nm == content.measurements[-1].rms_nm
    assert changes["RMS"].change == pytest.approx(changes["RMS"].after_nm / changes["RMS"].before_nm - 1)


def test_what_no_dwell_could_remove_is_of_the_same_surface(whole_drawn: CertificateDraft) -> None:
    reach, found = whole_drawn.content.beyond_reach, whole_drawn.after
    assert reach is not None
    assert found is not None
    assert reach.cutoff_period_mm == CUTOFF_MM
    above, below = split_bands(found.figure_nm, found.clear, found.pitch_mm, (CUTOFF_MM,))
    assert reach.after_nm == pytest.approx(below[found.clear].std())
    rms = found.reported.answer["rms_nm"]
    assert math.hypot(above[found.clear].std(), reach.after_nm) == pytest.approx(rms, rel=0.05)


@pytest.mark.full
def test_an_interrupted_pass_is_no_pass(torn_content: Content) -> None:
    torn, whole = torn_content.passes
    assert (torn.number, torn.did.how, torn.did.uncertain_blocks) == (None, "interrupted", [(13, 15)])
    assert torn.name == "a pass that was interrupted at 32%; blocks 13 to 15 uncertain"
    assert torn.did.share == pytest.approx(13 / 40)
    assert torn.taught.rate is None
    assert (whole.number, whole.name, whole.did.how) == (1, "pass 1", "done")
    assert (whole.taught.rate, whole.taught.as_expected) == (1.02, True)
    assert whole.did.force_n == pytest.approx(12.05)
    assert [one.name for one in torn_content.measurements] == ["start", "after an interrupted pass", "after pass 1"]
    assert torn_content.verdict.words == "Not in tolerance: 0 of 1 lines hold"


def test_what_went_wrong_and_what_was_done(torn_content: Content) -> None:
    link, torn = sorted(torn_content.anomalies, key=lambda one: one.kind)
    assert (link.kind, link.what) == ("LinkError", "robot: the link is silent")
    assert "resume was ordered (cable put back)" in link.done
    assert "the part was measured first: RMS" in link.done
    assert torn.kind == "pass interrupted"
    assert "no block of it was repeated" in torn.done


def test_a_pass_after_the_last_map_leaves_the_surface_unknown(tmp_path: Path) -> None:
    made = begin(tmp_path / "cell")
    with closing(made.journal):
        made.size_nm = 0.5
        made.measure(0)
        made.polish(0, share=0.5)
        run = made.end(Outcome.STOPPED, over=False)
    verdict = drawn(run).content.verdict
    assert (verdict.state, verdict.final) == ("not known", False)
    assert verdict.words == "Not known: the part was polished after its last map"


@pytest.mark.one_of_each
@pytest.mark.parametrize("alignment", ["piston", "tilt", "power"])
def test_each_alignment_is_the_one_of_the_figures(tmp_path: Path, alignment: str) -> None:
    made = begin(tmp_path / "cell", part={"alignment": alignment})
    with closing(made.journal):
        made.measure(0)
        run = made.end(Outcome.STOPPED, over=False)
    content = drawn(run).content
    assert content.after is not None
    assert content.after.rms_nm == content.measurements[0].rms_nm
    assert (content.left_out, content.part.alignment) == (
        ["RMS beyond the reach of the tool: no pass was planned"],
        alignment,
    )


def test_a_map_that_is_gone_is_said_and_the_journals_figures_stay(whole: Path, whole_content: Content) -> None:
    (whole / "cycle-02" / "map.dat").unlink()
    content = drawn(whole).content
    assert content.after is None
    assert content.changes == whole_content.changes[:3], "of the journal"
    assert "the file of the map is missing" in content.left_out[0]
    assert content.number == whole_content.number


def test_a_profile_that_measures_otherwise_would_give_a_second_figure(whole: Path) -> None:
    with closing(connect(whole / "journal.sqlite")) as journal:
        journal.execute("""UPDATE job SET terms = json_set(terms, '$."part.alignment"', 'power')""")
    journal.close()
    content = drawn(whole).content
    assert content.after is None
    assert "rms_nm is" in content.left_out[0]


def spoil_map(run: Path) -> None:
    path = run / "cycle-01" / "map.dat"
    content = bytearray(path.read_bytes())
    content[-9] ^= 1
    path.write_bytes(content)


def spoil_program(run: Path) -> None:
    (run / "cycle-01" / "program.rnc").write_text("G1 X9\n")


def spoil_profile(run: Path) -> None:
    (run / "instrument.toml").write_text((run / "instrument.toml").read_text() + "\n# edited\n")


def spoil_summary(run: Path) -> None:
    summary = json.loads((run / "summary.json").read_text())
    summary["cycles"][2]["rms_nm"] = 0.1
    (run / "summary.json").write_text(json.dumps(summary))


def spoil_cycles(run: Path) -> None:
    summary = json.loads((run / "summary.json").read_text())
    del summary["cycles"][2]
    (run / "summary.json").write_text(json.dumps(summary))


def no_journal(run: Path) -> None:
    (run / "journal.sqlite").unlink()


def no_summary(run: Path) -> None:
    (run / "summary.json").unlink()


def broken_journal(run: Path) -> None:
    (run / "journal.sqlite").write_bytes(b"no database" * 100)


def an_early_job(run: Path) -> None:
    with closing(connect(run / "journal.sqlite")) as journal:
        journal.execute("UPDATE job SET terms = 'null'")
    journal.close()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (spoil_map, "map.dat: SHA-256 differs"),
        (spoil_program, "program.rnc: SHA-256 differs"),
        (spoil_profile, "instrument.toml: SHA-256 differs"),
        (spoil_summary, "rms_nm of measurement 2 is 0.1, and"),
        (spoil_cycles, "summary.json has 2 measurements, the journal 3"),
        (no_journal, "has no journal.sqlite"),
        (no_summary, "has no summary.json"),
        (broken_journal, "cannot be read"),
        (an_early_job, "begun by an earlier polishd"),
    ],
)
def test_a_folder_that_tells_two_truths_is_refused(whole: Path, spoil: Spoil, said: str) -> None:
    spoil(whole)
    with pytest.raises(ConfigError, match=said):
        find_run(whole, None)


def test_the_folder_of_a_plan_is_not_a_run(tmp_path: Path) -> None:
    (tmp_path / "plan.npz").touch()
    with pytest.raises(ConfigError, match="is the folder of a plan: nothing was polished"):
        find_run(tmp_path, None)


def test_by_its_cell_a_run_is_the_same(whole_files: DemoFiles) -> None:
    by_cell, by_folder = find_run(whole_files.cell, "demo"), find_run(whole_files.run_dir, None)
    assert by_cell.path == by_folder.path
    assert by_cell.rows.sha256 == by_folder.rows.sha256
    with pytest.raises(ConfigError, match="there is no job 'other'"):
        find_run(whole_files.cell, "other")
    with pytest.raises(ConfigError, match="--job"):
        find_run(whole_files.run_dir, "demo")
    with pytest.raises(ConfigError, match="neither a folder nor a cell's file"):
        find_run(whole_files.run_dir / "summary.json", None)


def test_the_journals_hash_is_of_every_row(whole: Path) -> None:
    before = read_rows(whole)
    with closing(connect(whole / "journal.sqlite")) as journal:
        journal.execute("UPDATE segment SET force_n = 12.5 WHERE cycle = 0 AND seq = 3")
    journal.close()
    after = read_rows(whole)
    assert before.sha256 != after.sha256
    assert before.counts == after.counts == {"job": 1, "map": 3, "phase": 0, "pass": 2, "segment": 80, "event": 3}


def test_files_are_named_with_their_hashes(whole_content: Content, whole_files: DemoFiles) -> None:
    names = [file.name for file in whole_content.files]
    assert names == sorted(names)
    assert {"cell.toml", "instrument.toml", "journal.sqlite", "cycle-00/map.dat", "cycle-01/program.rnc"} <= {*names}
    hashes = {file.name: file.sha256 for file in whole_content.files}
    assert hashes["cycle-02/map.dat"] == whole_content.measurements[-1].map_sha256
    assert hashes["cycle-01/program.rnc"] == whole_content.passes[1].planned.program_sha256


def test_what_is_known_of_the_instrument_is_reported(whole_content: Content) -> None:
    assert whole_content.instrument.commissioned is not None
    assert whole_content.instrument.commissioned.artefact == "three bumps"
    statements = " ".join(whole_content.uncertainty.statements)
    assert "repeatability of the instrument is 0.2 nm RMS" in statements
    assert "has not been measured" in statements


# files that lie beside the cell


def turned(polishd: Polishd, folder: Path, files: DemoFiles) -> None:
    """The system error of the instrument, determined from four turns of a part."""
    error = np.where(np.isfinite(heights(0, 1.0)), 3.0 * np.indices((64, 64))[0] / 64.0 % 1.0, np.nan)
    maps = [dat(folder / f"p{k}.dat", np.rot90(heights(9, 5.0), k) + error) for k in range(4)]
    said = polishd("calibrate", "instrument", files.cell, *maps, "--angles", "0,90,180,270", "--json")
    assert said.code == 0, said.err


@pytest.mark.full
def test_a_system_map_is_taken_off_as_it_was(polishd: Polishd, tmp_path: Path) -> None:
    made = begin(tmp_path / "cell", lambda files: turned(polishd, tmp_path, files), job={"accept_by": "figure"})
    with closing(made.journal):
        made.measure(0)
        run = made.end()
    by_cell = certificate_content(find_run(made.files.cell, None), CertificateRequest()).content
    assert by_cell.after is not None
    assert by_cell.instrument.system_map_sha256
    assert "absolute test" in " ".join(by_cell.uncertainty.statements)
    alone = drawn(run).content
    assert alone.after is None
    assert "the instrument's system map" in alone.left_out[0]


def bowl(depth_nm: float) -> FloatArray:
    """(64, 64) nm, all of it data."""
    y, x = (np.indices((64, 64)) - 31.5) / 32.0
    return depth_nm * (1.0 + x**2 + y**2)


@pytest.mark.full
def test_the_form_wanted_is_known_by_its_hash(tmp_path: Path) -> None:
    def form(files: DemoFiles) -> None:
        dat(files.out / "form.dat", bowl(3.0), part="form")

    made = begin(tmp_path / "cell", form, part={"form": "form.dat"})
    with closing(made.journal):
        made.measure(0)
        run = made.end()
    assert drawn(run).content.after is None, "it lies beside the cell, and the run folder knows no cell"
    by_cell = certificate_content(find_run(made.files.cell, None), CertificateRequest()).content
    assert by_cell.after is not None
    assert "less the map form.dat" in by_cell.part.form
    shutil.copyfile(made.files.out / "form.dat", run / "form.dat")
    assert drawn(run).content.after == by_cell.after
    dat(run / "form.dat", bowl(2.0), part="form")
    assert drawn(run).content.after is None, "another form"


def test_no_folder_of_the_shop_is_reported(whole_content: Content, whole_files: DemoFiles) -> None:
    assert str(whole_files.out) not in whole_content.model_dump_json()
    assert whole_content.journal.events[0].data["run_dir"] == "run"


@pytest.mark.full
def test_a_limit_within_the_uncertainty_is_in_the_verdict(tmp_path: Path) -> None:
    made = begin(tmp_path / "cell", repeatability_nm=50.0)
    with closing(made.journal):
        made.measure(0)
        made.polish(0)
        made.measure(1)
        run = made.end(Outcome.CYCLES_USED)
    content = drawn(run).content
    assert content.verdict.unsure_lines == 1
    assert content.verdict.words.endswith("1 lines hold; for 1 the limit lies within the uncertainty")
    assert "either verdict is possible" in content.uncertainty.statements[0]


def test_a_cycle_whose_folder_is_gone_shifts_no_other(whole: Path, whole_content: Content) -> None:
    shutil.rmtree(whole / "cycle-00")
    content = drawn(whole).content
    assert content.before is None
    assert content.after == whole_content.after
    assert content.aperture == whole_content.aperture
    assert content.passes[0].planned == whole_content.passes[0].planned


@pytest.mark.full
def test_the_ripple_that_the_last_map_does_not_show_is_in_its_bands_and_in_the_verdict(tmp_path: Path) -> None:
    made = begin(tmp_path)
    made.ripple = [
        {
            "direction": "across",
            "period_mm": period,
            "amplitude_nm": 0.42,
            "rms_nm": 0.3,
            "rms_high_nm": 0.4,
            "on_grid": 0.4,
        }
        for period in (0.972, 2.0, 60.0)
    ]
    with closing(made.journal):
        for cycle in (0, 1):
            made.measure(cycle)
            made.polish(cycle)
        made.measure(2)
        made.end()
    content = drawn(made.files.run_dir).content
    figure, middle = content.hidden_ripple[:2]
    assert figure.rms_nm < 0.02, "the map shows a period of 60 mm"
    shown = np.sinc(PITCH_MM / 2.0) ** 2  # of the one at 2 mm; that at 0.972 mm lies below two samples
    assert middle.rms_nm == pytest.approx(2 * 0.3 * np.sqrt(1 + 1 - shown), rel=1e-6)
    assert middle.rms_high_nm == pytest.approx(middle.rms_nm * 4 / 3)
    (line,) = content.verdict.lines
    hidden = 2 * 0.3 * np.sqrt(1 - np.sinc(PITCH_MM / 0.972) ** 2 + 1 - shown)
    assert line.with_ripple == pytest.approx(np.hypot(line.value, hidden), rel=1e-3)
    assert any("ripple that the map does not show" in one for one in content.uncertainty.statements)
