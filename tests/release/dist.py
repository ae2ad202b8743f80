"""Check what `make dist` built: `python -m tests.release.dist DIST`.

sdist and wheel are built again and must be the same to the byte. The wheel is installed into an empty environment, with
the locked versions, and makes a first plan there from a map; the core alone must do that.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.unit.maps.maps import dat

ROOT = Path(__file__).resolve().parents[2]
PIP = ("pip", "pip-*", "setuptools", "setuptools-*", "pkg_resources", "_distutils_hack", "distutils-precedence.pth")
"""Of a new environment, beside what is installed."""
ANSWERS = """[kinematics]
arm = "ur10e"
tool_length_mm = 180.0

[instrument]
sample = "part.dat"

[part]
id = "MIRROR-60"
aperture_mm = 60.0

[job]
tolerance_nm = 5.0
"""
FIRST_PLAN = (
    ("--version",),
    ("map", "figures", "part.dat"),
    ("init", "cell", "--from", "answers.toml"),
    ("check", "cell/cell.toml"),
    ("plan", "cell/cell.toml", "part.dat", "--out", "cell/plan"),
    ("study", str(ROOT / "examples" / "robustness.toml"), "--limit", "1", "--workers", "1"),
)
"""Commands of a first plan, in an empty folder with a map; and of a first simulated job."""


def hashes(folder: Path) -> dict[str, str]:
    """Return the hash of each sdist and wheel of a folder."""
    files = sorted(path for path in folder.iterdir() if path.suffix in {".gz", ".whl"})
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def build(folder: Path, root: Path = ROOT) -> dict[str, str]:
    """Build sdist and wheel into a folder; return their hashes. ``SOURCE_DATE_EPOCH`` must be set."""
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(command, cwd=root, check=True, stdout=subprocess.DEVNULL)
    return hashes(folder)


def problems_of(folder: Path) -> list[str]:
    """Return what is wrong with the content of sdist and wheel."""
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as file:
        inside = set(file.namelist())
    with tarfile.open(sdist) as packed:
        sent = {name.partition("/")[2] for name in packed.getnames()}
    tracked = subprocess.run(["git", "ls-files", "polishd"], cwd=ROOT, check=True, capture_output=True, text=True)
    wanted = {name for name in tracked.stdout.splitlines() if not name.endswith(".md")}
    found = [f"{wheel.name}: {name} is missing" for name in sorted(wanted - inside)]
    found += [f"{sdist.name}: {name} is missing" for name in sorted((wanted | {"CHANGELOG.md", "LICENSE"}) - sent)]
    strange = [name for name in inside if not re.match(r"polishd/|polishd-[\d.]+\.(dist-info|data)/", name)]
    return found + [f"{wheel.name}: {name} does not belong there" for name in strange]


def install(wheel: Path, folder: Path) -> Path:
    """Install the core of a wheel with the locked versions into a new environment; return its `polishd`."""
    venv.create(folder, with_pip=True, clear=True)
    lock = re.sub(r"\s*\\\n\s*--hash=\S+", "", (ROOT / "requirements.lock").read_text())
    (folder / "constraints.txt").write_text(lock)
    pip = [str(folder / "bin" / "python"), "-m", "pip", "-qq", "--disable-pip-version-check", "--no-input", "install"]
    subprocess.run([*pip, "--constraint", str(folder / "constraints.txt"), str(wheel)], check=True)
    return folder / "bin" / "polishd"


def first_plan(polishd: Path, folder: Path) -> None:
    """Run the commands of a first plan in a folder; CalledProcessError where one fails."""
    at = (np.arange(121) - 60) * 0.5
    x, y = np.meshgrid(at, -at)
    hill = 40 * np.exp(-((x - 8) ** 2 + (y - 5) ** 2) / 150)
    dat(folder / "part.dat", np.where(np.hypot(x, y) <= 30, hill, np.nan), pitch_mm=0.5, part="MIRROR-60")
    (folder / "answers.toml").write_text(ANSWERS)
    env = {key: value for key, value in os.environ.items() if key not in {"PYTHONPATH", "VIRTUAL_ENV"}}
    for words in FIRST_PLAN:
        print(f"polishd {' '.join(words)}", flush=True)
        subprocess.run([str(polishd), *words], cwd=folder, env=env, check=True, stdout=subprocess.DEVNULL)
    if not (folder / "cell" / "plan" / "report.html").exists():
        raise SystemExit("the plan has no report.html")


def megabytes(folder: Path, but: Sequence[str] = ()) -> int:
    """Return the size of a folder on the disk, without what matches ``but``."""
    command = ["du", "-sm", *(f"--exclude={name}" for name in but), str(folder)]
    return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[0])


def main() -> None:
    """Run all checks on a folder of distributions."""
    dist = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as made:
        again = build(Path(made) / "again")
        if again != hashes(dist):
            raise SystemExit(f"two builds differ: {hashes(dist)} and {again}; is the tree unchanged since `make dist`?")
        if wrong := problems_of(dist):
            raise SystemExit("\n".join(wrong))
        (wheel,) = dist.glob("*.whl")
        work = Path(made) / "work"
        work.mkdir()
        first_plan(install(wheel, Path(made) / "venv"), work)
        packages = next(Path(made, "venv", "lib").glob("python*/site-packages"))
        print(f"{megabytes(packages, PIP)} MB of site-packages, {megabytes(packages)} MB with pip and setuptools")
        print("the same hashes twice:")
        for name, digest in again.items():
            print(f"{digest}  {name}")


if __name__ == "__main__":
    main()
