"""The command line, called in this process as from the shell."""

from __future__ import annotations

import sys

import pytest

from polishd import cli
from tests.unit.console.said import Polishd, Said


@pytest.fixture
def polishd(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Polishd:
    """``polishd("check", path)``."""

    def call(*words: object) -> Said:
        monkeypatch.setattr(sys, "argv", ["polishd", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return Said(int(ended.value.code or 0), captured.out, captured.err)

    return call
