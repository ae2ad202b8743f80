"""Small valid files of interferometer formats as bytes, made without the readers, which tests change or damage.

Each holds the same map, ``HEIGHT_NM``: 6 rows x 8 columns, asymmetric, two samples missing.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import h5py
import numpy as np

from polishd.model.surface import FloatArray

ROWS, COLUMNS = 6, 8
PITCH_MM = 0.25
WAVELENGTH_M = 632.8e-9
TAKEN_S = 1_700_000_000
PART = "DEMO-100"
MISSING_COUNT = 2147483640


def height_nm() -> FloatArray:
    """Return the map that every example contains."""
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    height: FloatArray = 40.0 + 5.0 * column - 9.0 * row + 30.0 * ((row == 1) & (column == 2))
    height[0, 0] = height[5, 1] = np.nan
    return height


HEIGHT_NM = height_nm()
_FIELDS: dict[str, tuple[int, str]] = {
    "magic": (0, "4s"), "format": (4, "h"), "length": (6, "i"), "ac": (52, "3H"), "origin": (64, "2h"),
    "size": (68, "2H"), "bytes": (72, "i"), "time": (76, "i"), "scale": (164, "f"), "wavelength": (168, "f"),
    "obliquity": (176, "f"), "camera_res": (184, "f"), "resolution": (218, "h"), "sign": (232, "h"),
    "part": (258, "40s"), "serial": (320, "40s"), "fiducials": (428, "h14f"),
}  # fmt: skip


def counts_of(height: FloatArray, nm: float) -> Any:
    """Return the heights as integers of ``nm`` each, with missing ones as Zygo writes them."""
    return np.where(np.isnan(height), MISSING_COUNT, np.rint(np.nan_to_num(height) / nm)).astype(np.int64)


def metropro(height: FloatArray = HEIGHT_NM, **fields: Any) -> bytes:
    """A MetroPro ``.dat``; ``fields`` override the header's, and the counts follow them."""
    rows, columns = height.shape
    length = 4096 if fields.get("magic") == b"\x88\x1b\x03\x71" else 834
    values: dict[str, Any] = {
        "magic": b"\x88\x1b\x03\x6f", "format": 1, "length": length, "ac": (0, 0, 0), "size": (columns, rows),
        "bytes": 4 * rows * columns, "time": TAKEN_S, "scale": 0.5, "wavelength": WAVELENGTH_M, "obliquity": 1.0,
        "camera_res": PITCH_MM / 1e3, "resolution": 2, "part": PART.encode(), "serial": PART.encode(),
    } | fields  # fmt: skip
    header = bytearray(length)
    for name, value in values.items():
        offset, code = _FIELDS[name]
        struct.pack_into(f">{code}", header, offset, *(value if isinstance(value, tuple) else (value,)))
    nm = values["scale"] * float(np.float32(values["wavelength"])) * values["obliquity"] * 1e9
    nm *= (-1 if values.get("sign") else 1) / (4096, 32768, 131072)[values["resolution"]]
    width, tall, buckets = values["ac"]
    phase: bytes = counts_of(height, nm).astype(">i4").tobytes()
    intensity = b"\x07" * int(2 * width * tall * buckets)
    return bytes(header) + intensity + phase


GUID = "{1CE20D93-8A91-4847-9CEF-B83B2F42271E}"
MEASUREMENT = "{09244224-74DD-4E34-BC45-39F039673A6A}"
ABOUT = "{846C2331-6472-411F-9024-179B928C018D}"
FRINGE_NM = 0.5 * WAVELENGTH_M * 1e9
NO_DATA = 1.7976931348623157e308
_ASCII = h5py.string_dtype("ascii")
CONVERTER = np.dtype([("Category", _ASCII), ("BaseUnit", _ASCII), ("Parameters", h5py.vlen_dtype(np.float64))])


def converter(category: str, unit: str, *parameters: float) -> Any:
    """Return a converter as Mx writes it."""
    return np.array([(category, unit, np.array(parameters, dtype=np.float64))], dtype=CONVERTER)


def datx(
    height: FloatArray = HEIGHT_NM,
    *,
    nm: float = FRINGE_NM,
    change: Callable[[h5py.File, h5py.Dataset], None] | None = None,
    links: Sequence[tuple[str, str, str]] | None = None,
    **how: Any,
) -> bytes:
    """A ``.datx`` in fringes; ``change`` may do anything to it; ``how`` goes to create_dataset."""
    held = io.BytesIO()
    table = links if links is not None else [
        ("Root", "Attributes", "/Attributes/System"), ("Root", "Measurement", MEASUREMENT),
        (MEASUREMENT, "Attributes", f"/Attributes/{ABOUT}"), (MEASUREMENT, "Surface", GUID),
        (GUID, "Path", f"/Data/Surface/{GUID}"),
    ]  # fmt: skip
    with h5py.File(held, "w") as file:
        names = [(name, _ASCII) for name in ("Source", "Link", "Destination")]
        file["MetaData"] = np.array(table, dtype=names)
        samples = np.where(np.isnan(height), NO_DATA, height / nm)
        data = file.create_dataset(f"/Data/Surface/{GUID}", data=samples, **how)
        lateral = converter("LateralCat", "Pixels", 0.0, PITCH_MM / 1e3, 0.0, 0.0)
        for name, value in {
            "Unit": np.array(["Fringes"], dtype=_ASCII), "No Data": np.array([NO_DATA]),
            "Wavelength": np.array([WAVELENGTH_M]), "Interferometric Scale Factor": np.array([0.5]),
            "Obliquity Factor": np.array([1.0]), "X Converter": lateral, "Y Converter": lateral,
            "Z Converter": converter("HeightCat", "Fringes", 0.0, WAVELENGTH_M, 0.5, 1.0),
        }.items():  # fmt: skip
            data.attrs[name] = value
        about = file.create_group(f"/Attributes/{ABOUT}")
        stamp = [("time", "<i8"), ("millitm", "<u2"), ("timezone", "<i2"), ("dstflag", "<i2")]
        prefix = "Data Context.Data Attributes"
        about.attrs[f"{prefix}.Part Serial Number"] = np.array([PART], dtype=_ASCII)
        about.attrs[f"{prefix}.System Type"] = np.array(["GPI"], dtype=_ASCII)
        about.attrs[f"{prefix}.System Serial Number"] = np.array(["651365"], dtype=_ASCII)
        about.attrs[f"{prefix}.Time Stamp"] = np.array([(TAKEN_S, 0, 60, 0)], dtype=stamp)
        if change:
            change(file, data)
    return held.getvalue()


def fourd(
    height: FloatArray = HEIGHT_NM,
    *,
    wedge: str | None = "0.5",
    change: Callable[[h5py.File, h5py.Dataset], None] | None = None,
    **how: Any,
) -> bytes:
    """A 4D ``.h5`` in waves of the wavefront; ``change`` may do anything to it."""
    held = io.BytesIO()
    with h5py.File(held, "w") as file:
        nm = WAVELENGTH_M * 1e9 * float(wedge or 1.0)
        samples = np.where(np.isnan(height), 9e37, height / nm).astype(np.float32)
        data = file.create_dataset("/measurement0/genraw/data", data=samples, **how)
        for name, text in {
            "wavelength": "632.8 nm", "xpix": f"{PITCH_MM} mm", "ypix": f"{PITCH_MM} mm", "fiducials": "",
        }.items():  # fmt: skip
            data.parent.attrs[name] = np.bytes_(text)
        if wedge is not None:
            data.parent.attrs["wedge"] = np.bytes_(wedge)
        if change:
            change(file, data)
    return held.getvalue()


def foursight(height: FloatArray = HEIGHT_NM, **attributes: str) -> bytes:
    """A 4D ``.h5`` as 4Sight writes it: no ``ypix``, but ``aspect``; a date, and the head's serial number."""
    words = {"xpix": f"{PITCH_MM} mm", "aspect": "1.0", "date": "Thu Mar 14 10:22:33 2019", "head_serial": "20714"}

    def change(_: h5py.File, data: h5py.Dataset) -> None:
        del data.parent.attrs["ypix"]
        for name, text in (words | attributes).items():
            data.parent.attrs[name] = np.bytes_(text)

    return fourd(height, change=change)


def zygo_header(kind: str, shape: tuple[int, ...], **line: str) -> str:
    """Return the 14 lines of the header; ``line`` replaces the one with its number ("line8")."""
    rows, columns = shape
    lines = {
        1: f"Zygo {kind} Data File - Format {2 if kind == 'ASCII' else 1}", 2: '1 8 3 5 "Thu Jan 01 00:00:00 1970"',
        3: "0 0 3 2 1 255", 4: f"12 7 {columns} {rows}", 5: '"part #5 of the comment"', 6: f'"{PART}"', 7: '"M1"',
        8: f"0 0.5 6.328e-07 0 1 0 {PITCH_MM / 1e3:.9g} {TAKEN_S}", 9: '640 480 4 0 651365 0 "sim 4in"',
        10: "0 0 1 33 0 0 0.1 60.4 2 50", 11: "1 0 20 1 0 0 0 0 0", 12: '0 ""', 13: "1 0", 14: '"1.0"',
    }  # fmt: skip
    lines |= {int(name.removeprefix("line")): text for name, text in line.items()}
    return "\n".join(lines[number] for number in sorted(lines)) + "\n#\n"


ASCII_NM = 0.5 * WAVELENGTH_M * 1e9 / 32768


def zygo_ascii(
    height: FloatArray = HEIGHT_NM, *, nm: float = ASCII_NM, wrap: int = 10, lines: Mapping[str, str] = {}, **line: str
) -> bytes:
    """A Zygo ASCII file with an intensity block; ``nm`` a count must fit the header's lines."""
    counts = [str(count) for count in counts_of(height, nm).ravel()]
    phase = "\n".join(" ".join(counts[at : at + wrap]) for at in range(0, len(counts), wrap))
    return (zygo_header("ASCII", height.shape, **lines, **line) + f"1 2 3\n4 5 6\n#\n{phase}\n#\n").encode("latin-1")


def zygo_xyz(height: FloatArray = HEIGHT_NM, *, corner: tuple[int, int] = (12, 7), **line: str) -> bytes:
    """A Zygo XYZ file, in um; ``corner`` is the first point's column and row."""
    rows, columns = height.shape
    points = [
        f"{column + corner[0]} {row + corner[1]} "
        + ("No Data" if np.isnan(height[row, column]) else f"{height[row, column] / 1e3:.9f}")
        for row in range(rows)
        for column in range(columns)
    ]
    return (zygo_header("XYZ", height.shape, **line) + "\n".join(points) + "\n#\n").encode("latin-1")


def codev(
    height: FloatArray = HEIGHT_NM, *, words: str = "SUR WVL 0.6328 SSZ 65536 NDA -32768", nda: int = -32768,
    wrap: int = 10, um: float = 0.6328, ssz: float = 65536.0,
) -> bytes:  # fmt: skip
    """A CODE V grid; ``words`` follow the size, and ``um``, ``ssz`` and ``nda`` must fit them."""
    rows, columns = height.shape
    values = np.where(np.isnan(height), nda, np.rint(np.nan_to_num(height) / (um * 1e3 / ssz))).astype(np.int64)
    text = [str(value) for value in values.ravel()]
    body = "\n".join(" ".join(text[at : at + wrap]) for at in range(0, len(text), wrap))
    return f"! a comment\na title\nGRD {columns} {rows} {words}\n{body}\n".encode()


EXAMPLES: dict[str, Callable[[], bytes]] = {
    "metropro": metropro, "datx": datx, "zygo_ascii": zygo_ascii, "zygo_xyz": zygo_xyz, "4d": fourd, "codev": codev,
}  # fmt: skip
"""A valid file of each format, by the reader's name."""
