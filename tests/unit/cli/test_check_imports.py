"""``polishd check`` starts quickly: it leaves out what only a plan or a fit needs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import write_demo

LEFT_OUT = (
    "matplotlib", "qpsolvers", "clarabel", "scipy.fft", "scipy.ndimage", "scipy.optimize", "scipy.interpolate",
    "scipy.spatial", "scipy.linalg",
)  # fmt: skip
EXAMPLES = Path(__file__).parents[3] / "examples"
SCRIPT = f"""
import gc, sys
from polishd.__main__ import main
sys.argv = ["polishd", "check", sys.argv[1], "--json"]
try:
    main()
except SystemExit as ended:
    assert not ended.code, ended.code
assert gc.get_freeze_count() > 100_000, "Python would search all objects for cycles while it ends"
print("imported:", *(name for name in {LEFT_OUT!r} if name in sys.modules), file=sys.stderr)
"""


@pytest.mark.full
@pytest.mark.parametrize("example", ["demo", "fanuc_rmi"])
def test_a_check_imports_only_what_it_uses(example: str, tmp_path: Path) -> None:
    """The demo's arm has parallel kinematics and NC text, that of ``fanuc_rmi`` six joints and a robot's language."""
    cell = (
        write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
        if example == "demo"
        else EXAMPLES / example / "cell.toml"
    )
    done = subprocess.run([sys.executable, "-c", SCRIPT, str(cell)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip().splitlines()[-1] == "imported:"
