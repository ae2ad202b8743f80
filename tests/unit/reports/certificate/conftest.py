"""Shared fixtures: runs and certificates that are made once."""

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
    """Certificate with the keys that can verify it."""

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
    """Write the run once; tests must not change it."""
    return whole_run(tmp_path_factory.mktemp("whole") / "cell")


@pytest.fixture(scope="session")
def torn_files(tmp_path_factory: pytest.TempPathFactory) -> DemoFiles:
    """Write the run once; tests must not change it."""
    return torn_run(tmp_path_factory.mktemp("torn") / "cell")


@pytest.fixture
def whole(whole_files: DemoFiles, tmp_path: Path) -> Path:
    """Return a copy of a complete run folder that the test may damage."""
    return Path(shutil.copytree(whole_files.run_dir, tmp_path / "whole"))


@pytest.fixture(scope="session")
def certified(whole_files: DemoFiles, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Make a signed certificate once; tests must not change it."""
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
    """Return a copy of the certificate that the test may damage."""
    folder = tmp_path / "signed"
    shutil.copytree(certified.pdf.parent, folder)
    return Made(folder / certified.pdf.name, folder / certified.key.name)
