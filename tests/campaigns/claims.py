"""Compare the figures of README and docs with their data, and list those measured on other sources: ``make claims``.

``docs/data/claims.jsonl`` has a JSON object a line:

- ``claim``: name; ``page``: file with the text; ``command``: what measures it, empty where that is not known.
- ``text``: sentence part with ``{key}`` for each figure; ``figure``: the figures as they are printed. Or ``section``:
  the target that writes the part of the page between its marks; ``figure`` is then the hash of that part.
- ``scope``: folders whose Python files the figure depends on; ``of``: their hash when it was measured, empty where
  unknown.
- ``machine``, ``date``.
- ``same``: empty, or what showed that its figures are the same on later sources (``tests.campaigns.same_jobs``).

The rows of a campaign (``docs/data``) have hashes of their own; ``rows`` names the campaign that counts them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from polishd.util.files import write_atomic
from tests.campaigns import result_files
from tests.campaigns.codecs import results as codecs
from tests.campaigns.faults import kept as faults
from tests.campaigns.pits import kept as pits

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "docs" / "data" / "claims.jsonl"

CAMPAIGNS: dict[str, Callable[[], Iterator[bool]]] = {
    "faults": lambda: (row["of"] == faults.of_case(row["link"]) for row in faults.Kept().cases()),
    "losses": lambda: (row["of"] == faults.of_case(row["link"]) for row in faults.Kept().losses()),
    "pits": lambda: (row["of"] == pits.of_case(row["link"]) for row in pits.Kept().rows()),
    "replies": lambda: (row["of"] == codecs.DRIVERS[row["driver"]].of for row in codecs.Results().rows()),
}
"""Campaigns whose rows have hashes of their own: for each row, whether it was measured on the present sources."""

MEASURED = re.compile(r"\d CPU s(?:econds)?\b|\d s of CPU|\d times as fast|\b\d[\d,]* (?:of [\d,]+ )?(?:jobs|plants)\b")
"""Hand-written lines that look like a measured figure: each must contain the text of a claim."""
PAGES = ("README.md", "docs/explanation")


@dataclass(frozen=True, slots=True)
class Claim:
    """A statement of README or docs with the figures that it was written from."""

    claim: str
    page: str
    scope: tuple[str, ...]
    command: str = ""
    text: str = ""
    section: str = ""
    rows: tuple[str, ...] = ()
    figure: dict[str, str] = field(default_factory=dict)
    of: str = ""
    machine: str = ""
    date: str = ""
    same: str = ""

    @property
    def printed(self) -> str:
        """The text with its figures. KeyError where a figure is missing."""
        return self.text.format_map(self.figure)

    def is_fresh(self, root: Path = ROOT) -> bool:
        """Whether it was measured on the present sources."""
        return bool(self.of) and self.of == result_files.sources(self.scope, root)

    def differences(self, root: Path = ROOT) -> list[str]:
        """Return what is wrong with the record, or differs between page and data."""
        at = f"docs/data/claims.jsonl: {self.claim}"
        if not (root / self.page).is_file():
            return [f"{at}: there is no {self.page}. Correct its page."]
        found = [
            f"{at}: scope {name} is no folder. Name folders of the package or of tests."
            for name in self.scope
            if not (root / name).is_dir()
        ]
        if bool(self.text) == bool(self.section):
            return [*found, f"{at}: give either text or section."]
        page = (root / self.page).read_text()
        if self.section:
            if section_hash(page, self.section) != self.figure.get("sha256"):
                found.append(
                    f"{self.page}: the part written by {self.section} differs from the data. "
                    f"Run make claims ARGS='--record {self.claim}' after a measurement, or restore the page."
                )
            return found
        try:
            printed = self.printed
        except (KeyError, ValueError, IndexError) as error:
            return [*found, f"{at}: {error} of its text is no figure. Add the figure."]
        if _plain(printed) not in _plain(page):
            found.append(f"{self.page}: it does not contain {printed!r} ({self.claim}). Change the page or the data.")
        return found


def section_hash(page: str, section: str) -> str | None:
    """Hash of the part of a page that a target writes; None where the page has no such marks."""
    found = re.search(rf"<!-- written by {re.escape(section)} -->\n(.*?)<!-- end of ", page, re.DOTALL)
    return None if found is None else hashlib.sha256(found[1].encode()).hexdigest()[:12]


def read(path: Path = DATA) -> list[Claim]:
    """Return the claims. ValueError with file and line where one cannot be read, or where a name is there twice."""
    claims: dict[str, Claim] = {}
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        try:
            row = json.loads(line)
            one = Claim(**{**row, "scope": tuple(row["scope"]), "rows": tuple(row.get("rows", ()))})
        except (ValueError, TypeError, KeyError) as error:
            raise ValueError(f"{path.name}:{number}: {error}. Correct this line.") from error
        if one.claim in claims:
            raise ValueError(f"{path.name}:{number}: {one.claim} is there twice. Remove one.")
        claims[one.claim] = one
    return list(claims.values())


def write(claims: Sequence[Claim], path: Path = DATA) -> None:
    """Write all claims."""
    rows = ({key: value for key, value in asdict(one).items() if value or key in {"of", "scope"}} for one in claims)
    write_atomic(path, "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows).encode())


def uncovered(claims: Sequence[Claim], root: Path = ROOT) -> list[str]:
    """Return the hand-written lines that look like a measured figure and contain no claim's text."""
    found = []
    for name in PAGES:
        for path in [root / name] if name.endswith(".md") else sorted((root / name).glob("*.md")):
            page = str(path.relative_to(root))
            texts = [_plain(one.printed) for one in claims if one.page == page and one.text]
            for number, line in enumerate(path.read_text().splitlines(), start=1):
                plain = _plain(line)
                if MEASURED.search(line) and not any(text in plain or plain in text for text in texts):
                    found.append(
                        f"{page}:{number}: a measured figure without a claim. Add it to docs/data/claims.jsonl."
                    )
    return found


def machine() -> str:
    """Processor, cores and Python of this computer."""
    names = re.findall(r"^model name\s*: (.*)$", _text("/proc/cpuinfo"), re.MULTILINE) or [platform.machine()]
    return f"{names[0]}, {os.cpu_count()} cores, Python {platform.python_version()}"


def record(claims: Sequence[Claim], name: str, figures: dict[str, str], root: Path = ROOT) -> list[Claim]:
    """Return the claims with that one measured today on the present sources; its page gets the new figures.

    ValueError where there is no such claim or figure, or where the page has another text: then nothing is written.
    """
    found = [one for one in claims if one.claim == name]
    if not found:
        raise ValueError(f"there is no claim {name}. Use one of {', '.join(one.claim for one in claims)}.")
    old = found[0]
    if unknown := figures.keys() - old.figure.keys():
        raise ValueError(f"{name} has no figure {', '.join(sorted(unknown))}. Use {', '.join(old.figure)}.")
    path = root / old.page
    page = path.read_text()
    new = replace(
        old,
        figure={**old.figure, **figures},
        of=result_files.sources(old.scope, root),
        machine=machine(),
        date=result_files.today(),
        same="",
    )
    if old.section:
        if (content := section_hash(page, old.section)) is None:
            raise ValueError(f"{old.page} has no part written by {old.section}. Add its marks.")
        new = replace(new, figure={"sha256": content})
    elif old.printed != new.printed:
        if old.printed not in page:
            raise ValueError(f"{old.page} does not contain {old.printed!r} on one line. Change the page by hand.")
        write_atomic(path, page.replace(old.printed, new.printed).encode())
    return [new if one is old else one for one in claims]


def _plain(text: str) -> str:
    return " ".join(text.split())


def _text(path: str) -> str:
    return Path(path).read_text() if Path(path).exists() else ""


def _state(claim: Claim) -> str:
    """``fresh`` or ``stale``; of rows with hashes of their own how many are fresh."""
    if not claim.rows:
        return ("fresh, compared" if claim.same else "fresh") if claim.is_fresh() else "stale"
    fresh = [one for name in claim.rows for one in CAMPAIGNS[name]()]
    return f"{'fresh' if all(fresh) else 'stale'} ({sum(fresh)} of {len(fresh)} rows)"


def main(args: Sequence[str] | None = None) -> int:
    """List the claims; exit status 1 where the text of a page differs from the data."""
    parse = argparse.ArgumentParser(prog="make claims", description=__doc__)
    parse.add_argument("--record", metavar="CLAIM", help="it was measured now, on these sources")
    parse.add_argument("figures", nargs="*", metavar="KEY=FIGURE", help="with --record: its new figures, as printed")
    parse.add_argument("--stale", action="store_true", help="list only those that are not fresh")
    parse.add_argument("--json", action="store_true", help="print a JSON object a claim")
    options = parse.parse_args(args)
    try:
        claims = read()
        if options.record:
            figures = dict(one.partition("=")[::2] for one in options.figures)
            claims = record(claims, options.record, figures)
            write(claims)
    except ValueError as error:
        print(f"make claims: {error}", file=sys.stderr)
        return 2
    states = {one.claim: _state(one) for one in claims}
    shown = [one for one in claims if not options.stale or not states[one.claim].startswith("fresh")]
    if options.json:
        for one in shown:
            print(json.dumps({**asdict(one), "state": states[one.claim]}, ensure_ascii=False))
    else:
        wide = max((len(one.claim) for one in shown), default=0)
        for one in shown:
            print(
                f"{one.claim:{wide}}  {states[one.claim]:26}  {one.date or 'no date':10}  {one.page}  ({one.command})"
            )
        fresh = sum(state.startswith("fresh") for state in states.values())
        print(f"{len(claims)} claims: {fresh} fresh, {len(claims) - fresh} measured on other sources")
    wrong = [difference for one in claims for difference in one.differences()] + uncovered(claims)
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
