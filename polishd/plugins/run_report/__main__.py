"""``python -m polishd.plugins.run_report FOLDER [gate]``: the report of a run, or the picture of a cycle's gate."""

from __future__ import annotations

import sys
from pathlib import Path

from polishd.plugins.run_report.gate import write_gate
from polishd.plugins.run_report.report import write_report

if __name__ == "__main__":
    draw = write_gate if sys.argv[2:] == ["gate"] else write_report
    draw(Path(sys.argv[1]))
