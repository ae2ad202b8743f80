"""Runs that are written once, and certificates that are made once."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.reports.certificate import signature
from polishd.reports.certificate.issue import certificate_verb
from polishd.reports.certificate.options import CertificateOptions
from tests.unit.reports.certificate.runs import torn_run, whole_run


@dataclass(frozen=True)
class Made:
    """A certificate, and the keys that may verify it."""

    pdf: Path
    key: Path

    @property
    def twin(self) -> Path:
        return self.pdf.with_suffix(".json")

    @property
    def public(self) -> Path:
        return self.key.with_name(self.key.name + signature.PUBLIC)


@pytest.fixture(scope="session")
def whole_files(tmp_path_factory: pytest.TempPathFactory) -> DemoFiles:
    """Read only."""
    return whole_run(tmp_path_factory.mktemp("whole") / "cell")


@pytest.fixture(scope="session")
def torn_files(tmp_path_factory: pytest.TempPathFactory) -> DemoFiles:
    """Read only."""
    return torn_run(tmp_path_factory.mktemp("torn") / "cell")


@pytest.fixture
def whole(whole_files: DemoFiles, tmp_path: Path) -> Path:
    """The run folder of a whole run, to be spoilt."""
    return Path(shutil.copytree(whole_files.run_dir, tmp_path / "whole"))


@pytest.fixture(scope="session")
def certified(whole_files: DemoFiles, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Signed; read only."""
    folder = tmp_path_factory.mktemp("certified")
    made = Made(folder / "part.pdf", folder / "shop.key")
    signature.make_key(made.key)
    asked = CertificateOptions(
        made.pdf, key=made.key, operator="A. Meyer", customer="Observatory", shop="Example Optics"
    )
    certificate_verb(whole_files.run_dir, asked, as_json=True)
    return made


@pytest.fixture
def signed(certified: Made, tmp_path: Path) -> Made:
    """The same, to be spoilt."""
    folder = tmp_path / "signed"
    shutil.copytree(certified.pdf.parent, folder)
    return Made(folder / certified.pdf.name, folder / certified.key.name)
