"""Dialect profiles: what a controller's program text means, as data. The shipped ones are ``dialects/*.toml``."""

from __future__ import annotations

import difflib
import functools
import re
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from polishd.api import ConfigError, ProgramError
from polishd.config.toml_loader import TomlSource, load_toml, validated
from polishd.plugins.rnc_robot.gcode.dialect import DwellWord, GcodeDialect
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile

__all__ = ["DEFAULT", "DIALECTS", "LANGUAGES", "AnyDialect", "DwellWord", "GcodeDialect", "dialect"]

FOLDER = Path(__file__).with_name("dialects")
DIALECTS = (
    "rs274", "fanuc", "haas", "siemens", "siemens-iso", "twincat-nci", "twincat-cnc", "grbl", "weihong", "codesys",
    "rapid", "krl", "fanuc-tp", "urscript", "inform", "val3", "heidenhain", "melfa-basic", "kawasaki-as",
)  # fmt: skip
LANGUAGES = frozenset(DIALECTS[DIALECTS.index("rapid") :])
"""Of those, the robots' own: profiles of templates."""
DEFAULT = "rs274"
AnyDialect = GcodeDialect | LanguageProfile


def dialect(name_or_path: str | Path) -> AnyDialect:
    """The shipped profile of that name, or the one in that TOML file. ConfigError names file, line and key."""
    text = str(name_or_path)
    if not text.endswith(".toml"):
        if text not in DIALECTS:
            raise ConfigError(_unknown(text))
        return _shipped(text)
    return _of_file(Path(name_or_path))


def _unknown(name: str) -> str:
    near = difflib.get_close_matches(name, DIALECTS, 1)
    hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(DIALECTS)}."
    return f"dialect {name!r} is not known: {hint} Use a known one, or the path of a .toml"


@functools.cache
def _shipped(name: str) -> AnyDialect:
    return _of_file(FOLDER / f"{name}.toml")


def _of_file(path: Path) -> AnyDialect:
    content, sources = _content(path, ())
    source = TomlSource(sources[-1].file, sources[-1].text, included=sources)
    if content.get("kind") == "template":
        return validated(LanguageProfile, content, source)
    return validated(GcodeDialect, content, source)


def _content(path: Path, below: tuple[Path, ...]) -> tuple[dict[str, Any], tuple[TomlSource, ...]]:
    """The file's tables laid over those it ``extends``; and the sources of all these files, this one last."""
    content, source = load_toml(path)
    base = content.pop("extends", None)
    if base is None:
        return content, (source,)
    if not isinstance(base, str):
        problem = "is no text; name a shipped dialect, or a .toml beside this file"
        raise ConfigError(source.error(("extends",), problem))
    parent = FOLDER / f"{base}.toml" if base in DIALECTS else path.parent / base
    if parent.resolve() in (path.resolve(), *below):
        problem = f"{base!r} extends this file again, in a circle; remove one of these keys"
        raise ConfigError(source.error(("extends",), problem))
    if not parent.is_file():
        missing = f"{base}: cannot be read: there is no such file; name a shipped dialect, or a .toml beside this file"
        raise ConfigError(source.error(("extends",), missing if base.endswith(".toml") else _unknown(base)))
    under, sources = _content(parent, (*below, path.resolve()))
    return _laid_over(under, content), (*sources, source)


def _laid_over(base: dict[str, Any], top: dict[str, Any]) -> dict[str, Any]:
    """Tables are merged key by key; everything else is replaced. Keys of ``top`` come last: an error names those."""
    merged = dict(base)
    for key, value in top.items():
        old = merged.pop(key, None)
        merged[key] = _laid_over(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged


# Dialect of a program, by its content and the ending of its name.

HEAD_BYTES = 1 << 20
"""What is looked at of a program."""
LINES = 400
"""Of which the first line that is a sign of a language decides."""


@dataclass(frozen=True, slots=True)
class Language:
    """A language of programs, and what only its programs have."""

    title: str
    dialect: str
    """Shipped for it; empty: data that stand beside a program."""
    endings: tuple[str, ...]
    sign: re.Pattern[bytes]
    """At the start of a line."""
    program: str = ""
    """Of such data: the ending of the program."""


def _sign(text: bytes, flags: int = re.IGNORECASE) -> re.Pattern[bytes]:
    return re.compile(rb"[ \t]*(?:" + text + rb")", flags)


KRL = (
    rb"&(?:ACCESS|REL|PARAM)\b|(?:GLOBAL[ \t]+)?DEF[ \t]+\w+[ \t]*\([^)]*\)(?![ \t]*:)|;FOLD\b|"
    rb"\$(?:VEL|APO|ACC|TOOL|BASE)\b|S?(?:LIN|PTP)[ \t]+[\w{$]"
)
RAPID = (
    rb"MODULE[ \t]+\w+|(?:LOCAL[ \t]+)?(?:CONST|PERS|VAR|TASK)[ \t]+\w+[ \t]+\w+[ \t]*(?::=|\{)|"
    rb"Move(?:L|J|C|AbsJ)[ \t]+[\w\[]|%%%[ \t]*\r?$"
)
URSCRIPT = rb"def[ \t]+\w+\([^)]*\)[ \t]*:|(?:move[ljcp]|set_tcp|servo[jc])\("
HEIDENHAIN = rb"(?:\d+[ \t]+)?(?:BEGIN PGM|TOOL CALL|BLK FORM|CYCL DEF)\b"
KNOWN = (
    Language("KUKA KRL", "krl", (".src", ".sub"), _sign(KRL)),
    Language("ABB RAPID", "rapid", (".mod", ".modx", ".sysx"), _sign(RAPID)),
    Language("FANUC TP", "fanuc-tp", (".ls",), _sign(rb"/(?:PROG|ATTR|APPL|MN|POS)\b")),
    Language("URScript", "urscript", (".script", ".urscript"), _sign(URSCRIPT, 0)),
    Language("Yaskawa INFORM", "inform", (".jbi",), _sign(rb"/JOB\b|//(?:NAME|POS|INST)\b|MOV[LJC][ \t]+[CP]\d")),
    Language("Heidenhain dialogue", "heidenhain", (".h",), _sign(HEIDENHAIN)),
    Language("data of a Staubli VAL3 application", "", (".pjx", ".dtx"), _sign(rb"<Database\b|<Project\b"), ".pgx"),
    Language("Staubli VAL3", "val3", (".pgx",), _sign(rb"<Programs?\b|<Code\b")),
    Language("MELFA-BASIC", "melfa-basic", (".prg",), _sign(rb"(?:\d+[ \t]+)?(?:Mvs|Mov|Dly|Ovrd|JOvrd)[ \t]+[\w(]")),
    Language("Kawasaki AS", "kawasaki-as", (".as", ".pg"), _sign(rb"\.(?:PROGRAM|TRANS|NETCONF)\b")),
)
SIEMENS = _sign(rb";\$PATH=|%_N_")
SIEMENS_ENDINGS = (".mpf", ".spf")
SIEMENS_ISO = re.compile(rb"(?:^|\s)G0*291(?!\d)", re.IGNORECASE)
O_NUMBER = re.compile(rb"^[ \t]*[Oo:]\d{1,8}[ \t]*(?:\(|\r?$)", re.MULTILINE)
# Atomic: the first G4 of a line decides, and a long line is gone over once
DWELL = re.compile(rb"^(?>[^(;\n]*?G0?4(?!\d))[^(;\n]*?[PXU][ \t]*+[\d.]", re.MULTILINE | re.IGNORECASE)
O_DIALECTS = ("fanuc", "haas", DEFAULT)


@dataclass(frozen=True, slots=True)
class DialectDetection:
    """The dialect that a program is in, and why."""

    dialect: str
    why: str


def detect(head: bytes, name: str) -> DialectDetection:
    """The dialect of a program by the beginning of its text and its name.

    Raises:
        ProgramError: it is in a language that polishd does not read, or several dialects fit; it says what to do.
    """
    found = language(head, name)
    if found is not None:
        known, line = found
        where = f"{name}:{line}" if line else name
        if not known.dialect:
            raise ProgramError(
                f"{where}: the file looks like {known.title}, which are no program. To do: name the {known.program} "
                "program beside it; polishd reads the two together."
            )
        by = f"line {line} of its text" if line else "the ending of its name"
        return DialectDetection(known.dialect, f"{known.title} by {by}")
    lines = head.splitlines()[:LINES]
    if name.lower().endswith(SIEMENS_ENDINGS) or any(SIEMENS.match(line) for line in lines):
        iso = SIEMENS_ISO.search(head) is not None
        return DialectDetection(
            "siemens-iso" if iso else "siemens", f"Sinumerik {'with G291 ' if iso else ''}by name or header"
        )
    numbered = O_NUMBER.search(head)
    dwell = DWELL.search(head)
    if numbered is not None and dwell is not None:
        line = head.count(b"\n", 0, dwell.start()) + 1
        flags = " or ".join(f"--dialect {one}" for one in O_DIALECTS)
        raise ProgramError(
            f"{name}:{line}: {', '.join(O_DIALECTS)} fit a program with an O number, and read the time of this dwell "
            f"in different units. To do: which controller is it for? Say {flags}."
        )
    return DialectDetection(DEFAULT, "G-code without the mark of a dialect: assumed")


def language(head: bytes, name: str) -> tuple[Language, int] | None:
    """The language that a program is in, and the line that says so, 0 where only its name does; None for G-code.

    The text decides; the name, only where no line of it is a G-code block.
    """
    for number, line in enumerate(head.lstrip(b"\xef\xbb\xbf").splitlines()[:LINES], 1):
        for known in KNOWN:
            if known.sign.match(line):
                return known, number
    ending = PurePath(name).suffix.lower()
    if not _G_CODE.search(head):
        return next(((known, 0) for known in KNOWN if ending in known.endings), None)
    return None


_G_CODE = re.compile(rb"^[ \t]*(?:/\d?[ \t]*)?(?:N\d+[ \t]*)?[GM]\d", re.MULTILINE | re.IGNORECASE)


def require_language(profile: AnyDialect, head: bytes, name: str) -> None:
    """ProgramError where the text is of another language than the dialect: it would be misread."""
    found = language(head, name)
    if found is None or found[1] == 0:
        if isinstance(profile, GcodeDialect) or profile.name not in LANGUAGES or not _G_CODE.search(head):
            return
        raise ProgramError(
            f"{name}: not {_title(profile.name)}: the file looks like G-code. To do: use the dialect of its controller "
            f'(--dialect {DEFAULT}, or program.format = "{DEFAULT}" in a cell).'
        )
    known, line = found
    if profile.name == known.dialect or not (isinstance(profile, GcodeDialect) or profile.name in LANGUAGES):
        return
    what = "G-code" if isinstance(profile, GcodeDialect) else _title(profile.name)
    advice = (
        f'use --dialect {known.dialect} (program.format = "{known.dialect}" in a cell)'
        if known.dialect
        else f"name the {known.program} program beside it; polishd reads the two together"
    )
    raise ProgramError(f"{name}:{line}: not {what}: the file looks like {known.title}. To do: {advice}.")


def _title(dialect: str) -> str:
    return next(known.title for known in KNOWN if known.dialect == dialect)
