"""EDS files: the shipped one, real ones' habits, and broken ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.api import ConfigError, DeviceRefused, ProtocolError
from polishd.drivers.cia402 import protocol
from polishd.drivers.cia402.protocol import Address, abort_text, emergency_text, read_dictionary
from polishd.sim_backends.cia402.device import I8, I16, I32, OBJECTS, RANGES, U8, U16, U32
from tests.fakes.cia402 import EDS

TEXT = EDS.read_text()


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str | bytes], Path]:
    def write(text: str | bytes) -> Path:
        path = tmp_path / "drive.eds"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def test_the_shipped_file_describes_the_simulated_drive() -> None:
    dictionary = read_dictionary(EDS, 5)
    sizes = {U8: (1, False), U16: (2, False), U32: (4, False), I8: (1, True), I16: (2, True), I32: (4, True)}
    for key, (kind, writable, value) in OBJECTS.items():
        entry = dictionary[Address(*key)]
        assert ((entry.size, entry.signed), entry.writable) == (sizes[kind], writable), key
        assert entry.readable
        assert entry.default in {None, value}
        if key in RANGES:
            assert (entry.low, entry.high) == RANGES[key]


def test_numbers_are_coded_by_their_type() -> None:
    dictionary = read_dictionary(EDS, 5)
    assert dictionary.encode(protocol.TARGET_TORQUE, -2) == b"\xfe\xff"
    assert dictionary.decode(protocol.TORQUE, b"\xfe\xff", sized=True) == -2
    assert dictionary.decode(protocol.STATUS_WORD, b"\x37\x02\x99\x99", sized=False) == 0x237
    for data in (b"", b"\x37", b"\x37\x02\x00", b"\x37\x02\x00\x00"):
        with pytest.raises(ProtocolError, match="6041h"):
            dictionary.decode(protocol.STATUS_WORD, data, sized=True)
    with pytest.raises(DeviceRefused, match=r"6071h .* holds -1500 to 1500, not 1501"):
        dictionary.encode(protocol.TARGET_TORQUE, 1501)
    with pytest.raises(DeviceRefused, match="60FFh"):
        dictionary.encode(protocol.TARGET_VELOCITY, 1 << 31)


def test_makers_files_in_windows_latin_and_with_byte_order_marks(written: Callable[[str | bytes], Path]) -> None:
    latin = TEXT.replace("VendorName=polishd", "VendorName=Müller Antriebe").encode("cp1252")
    for data in (latin, b"\xef\xbb\xbf" + TEXT.encode(), TEXT.replace("\n", "\r\n").encode()):
        assert protocol.STATUS_WORD in read_dictionary(written(data), 5)


def test_limits_that_are_none_and_objects_that_makers_leave_out(written: Callable[[str | bytes], Path]) -> None:
    unlimited = TEXT.replace("LowLimit=0xFA24\nHighLimit=1500", "LowLimit=0\nHighLimit=0")
    assert unlimited != TEXT
    entry = read_dictionary(written(unlimited), 5)[protocol.TARGET_TORQUE]
    assert (entry.low, entry.high) == (-(1 << 15), (1 << 15) - 1)
    empty = TEXT.replace("LowLimit=0xFA24\nHighLimit=1500", "LowLimit=\nHighLimit=\nDefaultValue=")
    assert read_dictionary(written(empty.replace("DefaultValue=\nDefaultValue=0", "DefaultValue=")), 5)


def test_what_is_missing_is_reported_with_its_place(written: Callable[[str | bytes], Path]) -> None:
    path = written(TEXT.replace("[60FF]", "[5FFF]"))
    with pytest.raises(ConfigError, match=r"drive.eds: object 60FFh is missing"):
        read_dictionary(path, 5).require(read=[], write=[protocol.TARGET_VELOCITY])
    line = TEXT.splitlines().index("[6077]") + 1
    with pytest.raises(ConfigError, match=rf"drive.eds:{line}: 6077h \(Torque actual value\) cannot be written"):
        read_dictionary(EDS, 5).require(read=[], write=[protocol.TORQUE])
    blind = written(TEXT.replace("AccessType=rw", "AccessType=wo"))
    with pytest.raises(ConfigError, match=r"6040h .* cannot be read"):
        read_dictionary(blind, 5).require(read=[protocol.CONTROL_WORD], write=[protocol.CONTROL_WORD])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[DeviceInfo", "DeviceInfo"),
        ("[DeviceInfo]\nno key", "parsing errors"),
        ("[DeviceInfo]\n[6040]\nParameterName=Controlword\n", "DataType"),
        (TEXT.replace("DataType=0x0006", "DataType=six"), "six"),
        (TEXT + "\n[6040]\nParameterName=again\n", "6040"),
        (TEXT + "\n[7000sub1]\nParameterName=of nothing\n", "7000|28672"),
    ],
)
def test_broken_files_are_config_errors_in_one_line(
    written: Callable[[str | bytes], Path], text: str, message: str
) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        read_dictionary(written(text), 5)
    assert str(caught.value).startswith(f"{written(text)}: is not an EDS file")
    assert "\n" not in str(caught.value)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none.eds: cannot be read: No such file"):
        read_dictionary(tmp_path / "none.eds", 5)


@settings(max_examples=25)
@given(st.data())
def test_damaged_files_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    lines = TEXT.splitlines()
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(lines) - 1))
        lines[at] = data.draw(
            st.sampled_from(["", "[", "=", "[6041]", lines[at][:3], lines[at].replace("=", "=x"), "a"])
        )
    path = tmp_path_factory.getbasetemp() / "damaged.eds"
    path.write_text("\n".join(lines))
    try:
        dictionary = read_dictionary(path, 5)
        dictionary.require(read=[protocol.STATUS_WORD], write=[protocol.CONTROL_WORD])
    except ConfigError as error:
        assert str(path) in str(error)  # noqa: PT017 - it may as well be read


def test_codes_have_words() -> None:
    assert emergency_text(0x8130) == "watchdog: no heartbeat of the controller"
    assert emergency_text(0x2310) == "current"
    assert emergency_text(0x0001) != ""
    assert abort_text(0x06090030) == "value range of parameter exceeded"
    assert abort_text(1) == "unknown reason"
