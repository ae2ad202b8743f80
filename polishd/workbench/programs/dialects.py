"""``polishd program dialects``: what each shipped profile says about time."""

from __future__ import annotations

from typing import Any

from polishd.plugins.rnc_robot.dialect import DIALECTS, AnyDialect, DwellWord, GcodeDialect, dialect
from polishd.plugins.rnc_robot.languages import LanguageProfile
from polishd.show.tables import emit, record_table

_COLUMNS = ("dialect", "for", "dwell", "new dwells", "quantum, s", "time in F", "lines at most")


def dialects_verb(*, as_json: bool) -> None:
    """All shipped dialects, as a table or as JSON."""
    answers = [dialect_answer(dialect(name)) for name in DIALECTS]
    emit({"dialects": answers}, as_json=as_json, table=lambda: record_table("dialects", _COLUMNS, map(_row, answers)))


def dialect_answer(profile: AnyDialect) -> dict[str, Any]:
    """What a profile says about time, as JSON holds it; null: it has none, or no limit."""
    return {
        "name": profile.name,
        "kind": profile.kind,
        **dict.fromkeys(("title", "dwell", "written", "quantum_s", "finest_s", "resolution_s", "feed", "inverse")),
        "most_lines": None,
        **(_of_nc(profile) if isinstance(profile, GcodeDialect) else _of_language(profile)),
    }


def _of_language(profile: LanguageProfile) -> dict[str, Any]:
    return {
        "title": profile.summary,
        "dwell": [*profile.statements.dwell, *profile.statements.dwell_in_position],
        "quantum_s": profile.dwell.quantum_s,
        "finest_s": profile.dwell.quantum_s,
        "most_lines": profile.line_limit or None,
    }


def _of_nc(profile: GcodeDialect) -> dict[str, Any]:
    dwell = profile.dwell
    words = {letter: _unit(word) for letter, word in dwell.words.items()}
    return {
        "title": profile.title,
        "dwell": [f"{letter} {unit}" for letter, unit in words.items() if unit],
        "written": dwell.written,
        "quantum_s": 10.0**-dwell.decimals,
        "finest_s": 10.0**-dwell.most_decimals,
        "resolution_s": dwell.resolution_s or None,
        "feed": profile.feed.unit,
        "inverse": None if profile.feed.g93 == "refuse" else profile.feed.g93,
    }


def _unit(word: DwellWord) -> str:
    """Unit of a dwell word, in words; empty where it is refused either way."""
    if word.whole == word.decimal:
        return "" if word.whole == "refuse" else word.whole
    ways = ((word.whole, "without a point"), (word.decimal, "with a point"))
    return ", ".join(f"{unit} {way}" for unit, way in ways if unit != "refuse")


def _row(answer: dict[str, Any]) -> tuple[str, ...]:
    inverse = answer["inverse"]
    feed = f"{answer['feed']}" + (f"; G93 {inverse}" if inverse else "") if answer["feed"] else "no"
    return (
        answer["name"],
        answer["title"],
        "\n".join(answer["dwell"]),
        answer["written"] or "as the program has them",
        _quantum(answer),
        feed,
        str(answer["most_lines"] or "any"),
    )


def _quantum(answer: dict[str, Any]) -> str:
    """Of new numbers, how fine the program's own may be, and what the controller makes of it."""
    found = f"{answer['quantum_s']:g}"
    if answer["finest_s"] < answer["quantum_s"]:
        found += f", to {answer['finest_s']:g}"
    return found + (f" (runs {answer['resolution_s']:g})" if answer["resolution_s"] else "")
