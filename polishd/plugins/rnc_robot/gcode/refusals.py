"""Why a line is refused, in words: where the scanner says only that it knows no such thing, the dialect says why."""

from __future__ import annotations

import contextlib
import re
import unicodedata

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.gcode import kernels as c
from polishd.plugins.rnc_robot.gcode.dialect import GcodeDialect, TextRules

_WITHOUT = "have it posted again without variables, expressions and loops"
_CHARACTERS = {
    "#": ("# variables and commands are not read", _WITHOUT),
    "[": ("expressions are not read", _WITHOUT),
    "=": ("assignments (=) are not read", _WITHOUT),
    "<": ("named variables and sub-programs are not read", _WITHOUT),
    "$": ("$: variables, loops and controller settings are not read", "take it out"),
    "(": ("parentheses are no comment in this dialect", "take it out"),
    ")": ("a ) without its (", "mend the comment"),
    "/": ("block delete inside a block", "delete the block or its /"),
    "*": ("checksums are not read", "have it posted again without checksums"),
    "%": ("% is not alone on its line", "put it on a separate line"),
    ":": ("labels (:) and sub-programs are not read", _WITHOUT),
    ",": ("a comma (,) is no decimal point", "write a point"),
}
_ALLOWED = bytes({9, 10, 13, 26, *range(32, 127), *range(128, 256)})


def refuse(name: str, number: int, line: bytes, reason: str, advice: str) -> ProgramError:
    """The error that names the line, what is wrong with it, and what to do."""
    shown = line.decode("ascii", "backslashreplace").strip()
    shown = shown if len(shown) <= 80 else shown[:77] + "..."
    return ProgramError(f'{name}, line {number}: {reason}: "{shown}". To do: {advice}.')


def refuse_byte_order_mark(text: bytes, name: str) -> None:
    """Refuse what an editor saved as UTF-8 with a mark, or as UTF-16: a controller takes neither for a program."""
    if text.startswith((b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff")):
        raise ProgramError(f"{name}: it starts with a byte order mark. To do: save it as plain ASCII text.")


def refuse_binary(text: bytes, name: str, lines: int, rules: TextRules) -> None:
    """Refuse what is no text in LF or CRLF lines, and characters that a controller acts on wherever they stand."""
    if not lines and not text.strip():
        raise ProgramError(f"{name}: the file is empty. To do: fetch it again.")
    if not lines:
        refuse_byte_order_mark(text, name)
    control = text.translate(None, _ALLOWED)
    if control:
        number = lines + text.count(b"\n", 0, text.index(control[:1])) + 1
        raise ProgramError(
            f"{name}, line {number}: byte {control[0]:#04x}: this is no text. To do: check which file this is."
        )
    if rules.realtime:
        acted_on = text.translate(None, bytes(set(range(128)) - set(rules.realtime.encode("ascii"))))
        if acted_on:
            raise ProgramError(
                f"{name}, line {lines + text.count(10, 0, text.index(acted_on[0])) + 1}: byte {acted_on[0]:#04x}: the "
                "controller acts on it at once, even in a comment. To do: take it out."
            )
    if rules.commands and b"," in text:
        _refuse_commands(text, name, lines, rules.commands)
    if b"\r" in text and text.count(b"\r") != text.count(b"\r\n"):
        raise ProgramError(f"{name}: carriage returns without line feeds. To do: save it with LF or CRLF line ends.")


def _refuse_commands(text: bytes, name: str, lines: int, commands: list[str]) -> None:
    words = "|".join(re.escape(word) for word in commands).encode("ascii")
    found = re.search(rb"[;(][ \t]*(?:" + words + rb")[ \t]*,", text, re.IGNORECASE)
    if found is not None:
        number = text.count(b"\n", 0, found.start()) + 1
        line = text.split(b"\n", number)[number - 1]
        raise refuse(name, lines + number, line, "a comment that the controller runs", "take it out")


def explain_refusal(
    error: ProgramError, dialect: GcodeDialect, name: str, lines: list[bytes], at: list[int]
) -> ProgramError:
    """The scanner's refusal with file, line (the last of ``lines``: its piece until there) and the dialect's reason."""
    line = lines[-1].removesuffix(b"\r")
    begin = sum(len(each) + 1 for each in lines[:-1])
    reason, advice = error.args
    if not advice:
        shown = line.decode("latin-1")
        reason, advice = _why(reason, dialect, shown, max(at[c.COLUMN] - begin, 0), at[c.CODE])
    elif reason.startswith(("stands twice", "the axis")):
        reason = f"{_letter(at[c.CODE])} {reason}"
    return refuse(name, at[c.LINE], line, reason.replace("the axis", _letter(at[c.CODE])), advice)


def _why(reason: str, dialect: GcodeDialect, line: str, column: int, code: int) -> tuple[str, str]:
    out = "take it out, or have it posted without it"
    if reason.startswith("the G code"):
        number = f"{code / 10:g}"
        because = dialect.refused_g.get(number, "is not known")
        return (f"G{number} {because}" if because.startswith("is ") else f"G{number}: {because}"), out
    if reason.startswith("the M code"):
        return f"M{code} is not known", out
    if reason.startswith("the word is not known"):
        letter = _letter(code)
        return dialect.refused_words.get(letter, f"the word {letter} is not known"), out
    if reason.startswith("a dwell without"):
        words = ", ".join(
            word for word, unit in dialect.dwell.words.items() if {unit.whole, unit.decimal} != {"refuse"}
        )
        return f"G4 without its time ({words})", f"write the time as {dialect.dwell.written}"
    if reason.startswith("the dwell's time"):
        return _why_no_time(dialect, _letter(code))
    return _why_no_word(reason, dialect, line, column)


def _why_no_time(dialect: GcodeDialect, letter: str) -> tuple[str, str]:
    advice = f"write the time as {dialect.dwell.written}"
    unit = dialect.dwell.words.get(letter)
    usable = unit is not None and (unit.whole, unit.decimal) != ("refuse", "refuse")
    if letter in dialect.dwell.refused and not usable:
        return f"G4 with {letter}: {dialect.dwell.refused[letter]}", f"{advice}, in a separate block"
    if unit is not None and unit.whole == "refuse" and unit.decimal != "refuse":
        return f"{letter} without a decimal point: seconds or milliseconds, by machine parameter", "write a point"
    if unit is not None and unit.decimal == "refuse" and unit.whole != "refuse":
        return f"{letter} counts in {unit.whole} and takes no decimal point here", "write a whole number"
    return f"G4 with {letter}: a time in another dialect", advice


def _why_no_word(reason: str, dialect: GcodeDialect, line: str, column: int) -> tuple[str, str]:
    word = re.match(r"[A-Za-z_]*", line[column:])
    name = word.group() if word else ""
    rest = line[column + 1 :].lstrip(" \t+-=")
    letter = name[:1].upper()
    if rest[:1] in ("#", "[", "<", "$") and len(name) == 1:
        return _CHARACTERS[rest[0]]
    if letter in dialect.refused_words and ":" not in line and (letter in "ORL" or not name[1:]):
        return dialect.refused_words[letter], "take it out, or have it posted without it"
    if re.match(r"\w+\s*:", line[column:]):
        return _CHARACTERS[":"]
    if not name:
        at = line[column : column + 1]
        unknown = f"column {column + 1} holds {_named(line[column:])}, which is no word"
        return _CHARACTERS.get(at, (unknown, "remove it"))
    if len(name) > 1 and name.upper() != name[0].upper() and not re.match(r"[A-Za-z_]+\s*[-+.\d]", line[column:]):
        return f"the word {name} is not known", "take it out, or have it posted without it"
    if reason.startswith("is a word without"):
        return f"{name if len(name) > 1 else letter} without a number", "correct the word, or take it out"
    return f"the word {letter} is not known", "take it out, or have it posted without it"


def _named(rest: str) -> str:
    """Name the first character of the rest of a line in Latin-1. Beyond ASCII some look like others: by their names."""
    if rest[:1].isascii():
        return repr(rest[:1])
    for count in (2, 3, 4):
        with contextlib.suppress(UnicodeDecodeError):
            character = rest[:count].encode("latin-1").decode()
            return f"U+{ord(character):04X} ({unicodedata.name(character, 'without a name').lower()})"
    return f"the byte 0x{ord(rest[0]):02x}"


def _letter(code: int) -> str:
    return chr(65 + code) if code < c.BARE else "a number without a letter" if code == c.BARE else "the name"
