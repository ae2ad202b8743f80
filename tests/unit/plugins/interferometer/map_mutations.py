"""Damage a file: flipped bits, cuts, holes, splices, other numbers in text and fields, also inside archives."""

from __future__ import annotations

import hashlib
import re
import struct
import zipfile
from collections.abc import Callable

import numpy as np

from tests.unit.plugins.interferometer.map_files_other import unzipped, zipped

INTEGERS = (0, 1, 2, 7, 127, 128, 255, 256, 32767, 32768, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63, 2**64 - 1)
REALS = (0.0, -0.0, 1.0, -1.0, 1e-300, 1e300, 1e38, -1.7976931348623157e308, float("nan"), float("inf"))
TEXTS = (b"0", b"-1", b"1e999", b"nan", b"inf", b"99999999999999999999", b"2147483648", b"0x10", b"", b"1,5", b"\xff")
NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")

Rng = np.random.Generator
Mutation = Callable[[bytearray, Rng], None]


def flip_bits(content: bytearray, rng: Rng) -> None:
    """Flip one to eight bits."""
    for at in rng.integers(0, len(content), rng.integers(1, 9)):
        content[at] ^= 1 << int(rng.integers(8))


def truncate(content: bytearray, rng: Rng) -> None:
    """Cut the end off."""
    del content[int(rng.integers(len(content))) :]


def blank(content: bytearray, rng: Rng) -> None:
    """Fill a block with zeros or ones."""
    start, end = _block(content, rng)
    content[start:end] = bytes([int(rng.choice([0, 255]))]) * (end - start)


def splice(content: bytearray, rng: Rng) -> None:
    """Copy a block of the file over, or insert it into, another position."""
    start, end = _block(content, rng)
    at = int(rng.integers(len(content)))
    content[at : at + int(rng.integers(2)) * (end - start)] = content[start:end]


def remove(content: bytearray, rng: Rng) -> None:
    """Remove a block."""
    start, end = _block(content, rng)
    del content[start:end]


def set_field(content: bytearray, rng: Rng) -> None:
    """Overwrite a position, mostly in the header, with an integer or a real of random width and byte order."""
    near = min(len(content), 1024) if rng.integers(4) else len(content)
    at = int(rng.integers(near))
    order = "<>"[int(rng.integers(2))]
    if rng.integers(3):
        width = int(rng.choice([1, 2, 4, 8]))
        value = INTEGERS[int(rng.integers(len(INTEGERS)))] % 2 ** (8 * width)
        field = value.to_bytes(width, "little" if order == "<" else "big")
    else:
        kind, most = (("d", np.inf), ("f", 3e38))[int(rng.integers(2))]
        field = struct.pack(order + kind, np.clip(REALS[int(rng.integers(len(REALS)))], -most, most))
    content[at : at + len(field)] = field


def set_number(content: bytearray, rng: Rng) -> None:
    """Replace a number in text with another one."""
    found = list(NUMBER.finditer(content, 0, 4096))
    if not found:
        set_field(content, rng)
        return
    place = found[int(rng.integers(len(found)))]
    content[place.start() : place.end()] = TEXTS[int(rng.integers(len(TEXTS)))]


MUTATIONS: tuple[Mutation, ...] = (flip_bits, truncate, blank, splice, remove, set_field, set_field, set_number)


def mutated(content: bytes, rng: Rng) -> bytes:
    """Return the content with one to three kinds of damage; of an archive mostly a member is damaged."""
    if content.startswith(b"PK") and rng.integers(3):
        return _mutated_member(content, rng)
    broken = bytearray(content)
    for _ in range(int(rng.choice([1, 1, 2, 3]))):
        if broken:
            MUTATIONS[int(rng.integers(len(MUTATIONS)))](broken, rng)
    return bytes(broken)


def _mutated_member(content: bytes, rng: Rng) -> bytes:
    """Return an archive with a damaged member and correct checksums; in half of the cases the MD5 sums match, too."""
    members = unzipped(content)
    name = list(members)[int(rng.integers(len(members)))]
    old = members[name]
    members[name] = mutated(old, rng) if old else b""
    if rng.integers(2) and "main.xml" in members:
        sums = {hashlib.md5(old).hexdigest(): hashlib.md5(members[name]).hexdigest()}
        for was, now in sums.items():
            members["main.xml"] = members["main.xml"].replace(was.encode(), now.encode())
        members.pop("md5checksum.hex", None)
    return zipped(members, zipfile.ZIP_STORED)


def _block(content: bytearray, rng: Rng) -> tuple[int, int]:
    start = int(rng.integers(len(content)))
    return start, min(len(content), start + int(rng.integers(1, 64)))
