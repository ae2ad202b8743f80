"""Build the container image and run it; where nothing can build images, check the Containerfile: `make image-check`."""

from __future__ import annotations

import fnmatch
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TAG = "polishd:check"
INSTRUCTIONS = {
    "ARG", "FROM", "RUN", "CMD", "ENTRYPOINT", "COPY", "USER", "WORKDIR", "VOLUME", "EXPOSE", "STOPSIGNAL", "ENV",
    "LABEL",
}  # fmt: skip


def builder() -> str | None:
    """Return a program that builds images and whose engine answers; None where there is none."""
    for name in ("podman", "docker"):
        if shutil.which(name) and subprocess.run([name, "info"], capture_output=True, check=False).returncode == 0:
            return name
    return None


def instructions(text: str) -> list[tuple[int, str, str]]:
    """Return line number, instruction and the rest of each instruction; continued lines are one."""
    found, begun, joined = [], 0, ""
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or (line.lstrip().startswith("#") and not joined):
            continue
        begun = begun if joined else number
        joined += line.strip().removesuffix("\\") + " "
        if not line.rstrip().endswith("\\"):
            name, _, rest = joined.strip().partition(" ")
            found.append((begun, name, rest.strip()))
            joined = ""
    if joined:
        found.append((begun, "", "the last line goes on"))
    return found


def problems(text: str, root: Path = ROOT) -> Iterator[str]:
    """Yield ``Containerfile:LINE: what is wrong; what to do``."""
    found = instructions(text)
    args = {rest.partition("=")[0] for _, name, rest in found if name == "ARG"}
    for number, name, rest in found:
        for problem in (*_anywhere(name, rest, args), *_RULES.get(name, _nothing)(rest, root)):
            yield f"Containerfile:{number}: {problem}"
    names = [name for _, name, _ in found]
    if [name for name in names if name != "ARG"][:1] != ["FROM"]:
        yield "Containerfile: the first instruction must be FROM"
    last_stage = found[max((at for at, name in enumerate(names) if name == "FROM"), default=0) :]
    if [rest for _, name, rest in last_stage if name == "USER"][-1:] in ([], ["root"], ["0"]):
        yield "Containerfile: the last stage runs as root; add USER"
    if "ENTRYPOINT" not in names:
        yield "Containerfile: has no ENTRYPOINT"


def _anywhere(name: str, rest: str, args: set[str]) -> Iterator[str]:
    if name not in INSTRUCTIONS:
        yield f"{name or rest!r} is no instruction; write one of {', '.join(sorted(INSTRUCTIONS))}"
    for used in re.findall(r"\$\{?([A-Z_]+)\}?", rest):
        if used not in args:
            yield f"${used} is not declared by ARG"
    if re.search(r"https?://|--index-url|--extra-index", rest):
        yield "names a host; where packages come from is the builder's business"


def _nothing(_rest: str, _root: Path) -> Iterator[str]:
    yield from ()


def _from(rest: str, _root: Path) -> Iterator[str]:
    image = rest.split(maxsplit=1)[0]
    if "$" not in image and (":" not in image or image.endswith(":latest")):
        yield f"{image} has no fixed version; name one"


def _copy(rest: str, root: Path) -> Iterator[str]:
    ignored = (root / ".containerignore").read_text().split()
    for source in rest.split()[:-1] if "--from=" not in rest else ():
        if not (root / source).exists():
            yield f"there is no {source}"
        elif _is_ignored(source, ignored):
            yield f".containerignore leaves out {source}"


def _command(rest: str, _root: Path) -> Iterator[str]:
    if not _is_list(rest):
        yield 'write CMD and ENTRYPOINT as lists, ["a", "b"]: signals then reach polishd'


_RULES: dict[str, Callable[[str, Path], Iterator[str]]] = {
    "FROM": _from,
    "COPY": _copy,
    "CMD": _command,
    "ENTRYPOINT": _command,
}


def _is_list(text: str) -> bool:
    try:
        found = json.loads(text)
    except ValueError:
        return False
    return isinstance(found, list) and all(isinstance(each, str) for each in found)


def _is_ignored(source: str, rules: list[str]) -> bool:
    ignored = False
    for rule in rules:
        pattern = rule.removeprefix("!")
        if fnmatch.fnmatch(source, pattern) or source.startswith(pattern + "/"):
            ignored = not rule.startswith("!")
    return ignored


def main() -> None:
    """Build and run, or check."""
    text = (ROOT / "Containerfile").read_text()
    found = list(problems(text))
    if found:
        raise SystemExit("\n".join(found))
    engine = builder()
    if engine is None:
        if hadolint := shutil.which("hadolint"):
            raise SystemExit(subprocess.run([hadolint, str(ROOT / "Containerfile")], check=False).returncode)
        print("NO BUILDER: neither podman nor docker answers; the Containerfile is checked, and not built")
        return
    subprocess.run([engine, "build", "-t", TAG, "-f", "Containerfile", "."], cwd=ROOT, check=True)
    for words in (["--version"], ["map", "formats"], ["plugins"]):
        subprocess.run([engine, "run", "--rm", TAG, *words], check=True, stdout=sys.stderr)
    print(f"{TAG} is built and runs")


if __name__ == "__main__":
    main()
