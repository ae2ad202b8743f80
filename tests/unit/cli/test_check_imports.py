"""``polishd check`` starts quickly: it leaves out what only a plan or a fit needs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import write_demo

LEFT_OUT = ("matplotlib", "qpsolvers", "clarabel", "scipy.fft", "scipy.ndimage", "scipy.optimize", "scipy.interpolate")
SCRIPT = f"""
import sys
from polishd.__main__ import main
sys.argv = ["polishd", "check", sys.argv[1], "--json"]
try:
    main()
except SystemExit as ended:
    assert not ended.code, ended.code
print("imported:", *(name for name in {LEFT_OUT!r} if name in sys.modules), file=sys.stderr)
"""


@pytest.mark.full
def test_a_check_imports_only_what_it_uses(tmp_path: Path) -> None:
    cell = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
    done = subprocess.run([sys.executable, "-c", SCRIPT, str(cell)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip().splitlines()[-1] == "imported:"
