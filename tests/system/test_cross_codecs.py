"""Each driver's codec against its simulator's, written apart from one page: both ways, on vectors and at random."""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from can.interfaces.slcan import slcanBus
from can.interfaces.socketcand.socketcand import (
    convert_ascii_message_to_can_message,
    convert_can_message_to_ascii_message,
)
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ExceptionResponse
from pymodbus.pdu.register_message import (
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
    WriteSingleRegisterRequest,
)

from polishd.api import ExecutedBlock, MapError, SurfaceMap
from polishd.drivers.profile_device import codec
from polishd.drivers.profile_device.drives import reading_of
from polishd.drivers.robot_link import protocol
from polishd.drivers.robot_link.protocol import FrameReader, FrameType, encode
from polishd.drivers.transport import lines as numbered
from polishd.drivers.transport.modbus_link import REFUSALS
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats import metropro as reader
from polishd.process.metrology.conditioning import EARLIEST
from polishd.sim_backends.common import framing as f
from polishd.sim_backends.common import metropro as writer
from polishd.sim_backends.common.can import SlcanHost, SocketcandHost, slcan_frame, slcan_line
from polishd.sim_backends.common.framing import AsciiSlave, CoilRegisters, RtuSlave, body, crc16, line, rtu
from polishd.sim_backends.common.voice_coil import VoiceCoil
from tests.fakes.devices_by_profile import shipped
from tests.vectors import vectors

U8, U16, U32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))
LINES = st.lists(st.binary(max_size=60), max_size=12)
SECONDS = st.floats(0.0, 1e6)
RECORDS = st.lists(
    st.builds(lambda seq, one_s, other_s: (seq, *sorted((one_s, other_s))), U32, SECONDS, SECONDS), max_size=12
)
"""A block ends after it began."""
TEXT = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FFF), max_size=20)
STATUS = st.fixed_dictionaries(
    {
        "state": st.sampled_from(["idle", "held", "running", "done", "fault"]),
        "program_sha256": st.text("0123456789abcdef", min_size=64, max_size=64),
        "accepted": U32,
        "executed": U32,
        "buffer_s": st.floats(0.0, 1e5),
        "stops": U32,
        "boot_id": TEXT,
        "detail": TEXT,
        "time_s": SECONDS,
    }
)


def pieces(data: bytes, cuts: list[int]) -> Iterator[bytes]:
    """Yield the bytes in pieces, as a wire may deliver them."""
    at = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    return (data[a:b] for a, b in pairwise(at))


# the robot link


@pytest.mark.parametrize(("name", "kind"), [("ACCEPTED", FrameType.ACCEPTED), ("EXECUTED", FrameType.EXECUTED)])
def test_link_vectors_from_the_robot(name: str, kind: FrameType) -> None:
    frame = bytes.fromhex(vectors("robot_link")[name])
    payload = frame[8:-4]
    assert f.pack(kind, payload) == encode(kind, payload) == frame
    if kind == FrameType.ACCEPTED:
        assert protocol.accepted(payload) == (9, 512, 2.5)
    else:
        assert f.pack_executed([(7, 1.0, 1.5)]) == frame
        assert protocol.executed(payload) == [ExecutedBlock(7, 1.0, 1.5)]


def test_link_vectors_to_the_robot() -> None:
    page = {name: bytes.fromhex(value) for name, value in vectors("robot_link").items()}
    hello = {"protocol": 1, "role": "writer", "client": "t", "executed_from": 0, "lease": ""}
    assert protocol.command(FrameType.HELLO, hello) == f.pack_json(f.HELLO, hello) == page["HELLO"]
    assert protocol.blocks(7, [b"G1 X1 F60", b"M2"]) == f.pack_blocks(7, [b"G1 X1 F60", b"M2"]) == page["BLOCKS"]


def test_both_number_the_frames_alike() -> None:
    assert {kind.name: int(kind) for kind in FrameType} == {kind.name: getattr(f, kind.name) for kind in FrameType}


@pytest.mark.full
@given(st.lists(st.tuples(U32, LINES), min_size=1, max_size=4), st.lists(U16, max_size=8), st.binary(max_size=9))
def test_blocks_of_the_driver_reach_the_controller(
    sent: list[tuple[int, list[bytes]]], cuts: list[int], dirt: bytes
) -> None:
    splitter = f.Splitter()
    wire = dirt.replace(b"P", b"") + b"".join(protocol.blocks(first, lines) for first, lines in sent)
    found = [frame for piece in pieces(wire, cuts) for frame in splitter.feed(piece)]
    assert [kind for kind, _ in found] == [f.BLOCKS] * len(sent)
    assert [f.unpack_blocks(payload) for _, payload in found] == sent


@given(
    st.sampled_from(
        [FrameType.HELLO, FrameType.LOAD, FrameType.RESUME, FrameType.HOLD, FrameType.ABORT, FrameType.PING]
    ),
    st.dictionaries(TEXT, st.none() | st.integers(-(2**53), 2**53) | TEXT | st.booleans(), max_size=5),
)
def test_commands_of_the_driver_reach_the_controller(kind: FrameType, content: dict[str, Any]) -> None:
    ((found, payload),) = f.Splitter().feed(protocol.command(kind, content))
    assert found == kind
    assert f.unpack_json(payload) == content


@pytest.mark.full
@given(st.lists(RECORDS, min_size=1, max_size=3), st.lists(U16, max_size=8))
def test_records_of_the_controller_reach_the_driver(
    sent: list[list[tuple[int, float, float]]], cuts: list[int]
) -> None:
    link = FrameReader()
    wire = b"".join(map(f.pack_executed, sent))
    found = [frame for piece in pieces(wire, cuts) for frame in link.feed(piece)]
    assert [protocol.executed(frame.payload) for frame in found] == [
        [ExecutedBlock(*one) for one in some] for some in sent
    ]
    assert link.skipped == 0


@given(STATUS, U8)
def test_status_of_the_controller_reaches_the_driver(status: dict[str, Any], kind: int) -> None:
    wire = f.pack_json(f.STATUS, status) + f.pack_json(f.ACK, {"of": kind, "status": status})
    frame, acknowledged = FrameReader().feed(wire)
    progress = protocol.status(frame.payload)
    assert protocol.ack(acknowledged.payload) == protocol.Ack(kind, progress)
    assert {name: getattr(progress, name) for name in status if name != "time_s"} == {
        name: value for name, value in status.items() if name != "time_s"
    }


@pytest.mark.full
@given(RECORDS, st.integers(min_value=0), st.integers(0, 7))
def test_neither_side_acts_on_a_frame_with_one_wrong_bit(
    records: list[tuple[int, float, float]], at: int, bit: int
) -> None:
    wire = bytearray(f.pack_executed(records))
    wire[at % len(wire)] ^= 1 << bit
    good = f.pack_executed([(1, 2.0, 3.0)])
    after = good * 2 + bytes(1 << 10)
    assert f.pack_executed(records) not in [
        encode(FrameType.EXECUTED, one.payload) for one in FrameReader().feed(bytes(wire))
    ]
    ours, theirs = FrameReader().feed(bytes(wire) + after), list(f.Splitter().feed(bytes(wire) + after))
    assert [(one.kind, one.payload) for one in ours] == theirs, "and both find the same frames after it"


# the actuator on Modbus


MODBUS, ASCII = shipped("voice_coil_modbus"), shipped("voice_coil_serial")
(LIVE,) = codec.blocks(MODBUS.registers, MODBUS.polled, 125)
(IDENTITY,) = codec.blocks(MODBUS.registers, MODBUS.identifying, 125)
STATES = ("retracted", "extending", "contact", "retracting", "fault")
SET_POINT = MODBUS.registers["new_set_point"]


def set_point(force_n: float) -> WriteSingleRegisterRequest:
    words = codec.words_for(SET_POINT, "new_set_point", force_n, "high_first", 1)
    return WriteSingleRegisterRequest(address=SET_POINT.address, registers=words, dev_id=1)


def coil() -> VoiceCoil:
    return VoiceCoil(np.random.default_rng(0), lambda *_a, **_k: None, 0.0)


def table(of: VoiceCoil | None = None, boots: int = 3) -> CoilRegisters:
    return CoilRegisters(of or coil(), "polishd", "simulated VC50", "SIM-V1", "1.0", boots)


def asked(request: Any, of: CoilRegisters) -> Any:
    """Send a request of pymodbus to the simulator's slave and return the answer as pymodbus reads it."""
    framer = FramerRTU(DecodePDU(False))
    ((size, answer),) = RtuSlave(1, of.answer).feed(framer.buildFrame(request), 1.0)
    assert size == len(framer.buildFrame(request))
    used, pdu = framer.handleFrame(answer, 1, 0)
    assert used == len(answer)
    return pdu


def test_modbus_vectors_are_what_pymodbus_sends() -> None:
    page = {name: bytes.fromhex(value) for name, value in vectors("voice_coil_modbus").items()}
    framer = FramerRTU(DecodePDU(False))
    assert framer.buildFrame(set_point(12.0)) == page["write_setpoint"]
    live = ReadInputRegistersRequest(address=LIVE.address, count=LIVE.count, dev_id=1)
    assert framer.buildFrame(live) == page["read_inputs"]
    _, answer = framer.handleFrame(page["inputs"], 1, 0)
    values = codec.values_of(MODBUS, LIVE, answer.registers)
    reading = reading_of(MODBUS, values)
    assert (reading.state, reading.force_n, reading.setpoint_n) == ("contact", 11.98, 12.0)
    assert (reading.position_mm, reading.fault, values["beat_echo"]) == (5.0, 0, 7)


@given(unit=st.integers(1, 247), address=U16, value=U16)
def test_modbus_frames_are_the_same_bytes(unit: int, address: int, value: int) -> None:
    framer = FramerRTU(DecodePDU(False))
    write = WriteSingleRegisterRequest(address=address, registers=[value], dev_id=unit)
    assert framer.buildFrame(write) == rtu(unit, struct.pack(">BHH", 6, address, value))
    frame = framer.buildFrame(write)
    assert struct.unpack("<H", frame[-2:])[0] == crc16(frame[:-2])


@given(hundredths=st.integers(0, 5000))
def test_every_set_point_arrives_as_it_was_meant(hundredths: int) -> None:
    actuator = coil()
    assert asked(set_point(hundredths / 100.0), table(actuator)).registers == [hundredths]
    assert actuator.setpoint_n == pytest.approx(hundredths / 100.0, abs=1e-12)


@given(
    force=st.floats(-300.0, 300.0), setpoint=st.integers(0, 5000), position=st.integers(0, 10000),
    faults=st.integers(0, 15), beat=U16,
)  # fmt: skip
def test_what_the_actuator_measures_is_what_the_driver_reads(
    force: float, setpoint: int, position: int, faults: int, beat: int
) -> None:
    actuator = coil()
    actuator.force_n, actuator.setpoint_n, actuator.faults = force, setpoint / 100.0, faults
    actuator.position_um, actuator.engaged, actuator._touching = float(position), True, True
    actuator.feed(beat)
    live = ReadInputRegistersRequest(address=LIVE.address, count=LIVE.count, dev_id=1)
    answer = asked(live, table(actuator))
    assert isinstance(answer, ReadInputRegistersResponse)
    values = codec.values_of(MODBUS, LIVE, answer.registers)
    reading = reading_of(MODBUS, values)
    assert reading.state == STATES[actuator.state]
    assert reading.force_n == pytest.approx(force, abs=0.08), "sign, scale, and the sensor's noise"
    assert reading.setpoint_n == pytest.approx(setpoint / 100.0)
    assert reading.position_mm == pytest.approx(position / 1000)
    assert (reading.fault, values["beat_echo"]) == (faults, beat)


@given(boots=U32)
def test_the_actuators_identity_is_read(boots: int) -> None:
    request = ReadInputRegistersRequest(address=IDENTITY.address, count=IDENTITY.count, dev_id=1)
    answer = asked(request, table(boots=boots))
    identity = codec.identity(MODBUS, codec.values_of(MODBUS, IDENTITY, answer.registers))
    assert (identity.vendor, identity.model, identity.serial) == ("polishd", "simulated VC50", "SIM-V1")
    assert (identity.firmware, identity.boot_id) == ("1.0", str(boots))


@pytest.mark.parametrize(
    ("address", "value", "code"), [(1, 5001, 3), (2, 99, 3), (2, 5001, 3), (0, 2, 3), (4, 0, 2), (900, 1, 2)]
)
def test_refusals_have_words_in_the_driver(address: int, value: int, code: int) -> None:
    answer = asked(WriteSingleRegisterRequest(address=address, registers=[value], dev_id=1), table())
    assert isinstance(answer, ExceptionResponse)
    assert answer.exception_code == code
    assert REFUSALS[code]


# the actuator on a line of text


def test_ascii_vectors() -> None:
    page = {name: value.encode() + b"\r\n" for name, value in vectors("voice_coil_serial").items()}
    assert numbered.encode(7, "F,12.00") == line("7,F,12.00") == page["set_force"]
    assert numbered.encode(8, "ST?") == line("8,ST?") == page["status_request"]
    assert numbered.decode(page["ok"][:-1]) == (7, "OK")
    number, answer = numbered.decode(page["status"][:-1]) or (-1, "")
    assert number == 8
    assert codec.fields_of(ASCII, ASCII.asks["status"], answer)["force"] == 11.98


BODY = st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters="*$"), max_size=90)


@given(U16, BODY)
def test_lines_are_the_same_both_ways(number: int, text: str) -> None:
    ours, theirs = numbered.encode(number, text), line(f"{number},{text}")
    assert ours == theirs
    assert body(ours[:-2]) == f"{number},{text}"
    assert numbered.decode(theirs[:-1]) == (number, text)


@given(U16, BODY, st.integers(min_value=0), st.integers(0, 7))
def test_a_damaged_line_is_read_by_neither(number: int, text: str, at: int, bit: int) -> None:
    wire = bytearray(line(f"{number},{text}")[:-2])
    wire[at % len(wire)] ^= 1 << bit
    read = numbered.decode(bytes(wire))
    assert read is None or read != (number, text)
    assert body(bytes(wire)) != f"{number},{text}"


@given(
    force=st.floats(-60.0, 60.0), setpoint=st.integers(0, 5000), position=st.integers(0, 10000),
    faults=st.integers(0, 15), number=U16,
)  # fmt: skip
def test_the_text_status_is_what_the_driver_reads(
    force: float, setpoint: int, position: int, faults: int, number: int
) -> None:
    actuator = coil()
    actuator.force_n, actuator.setpoint_n, actuator.faults = force, setpoint / 100.0, faults
    actuator.position_um, actuator.engaged, actuator._touching = float(position), True, True
    slave = AsciiSlave(actuator, "polishd,simulated VC50,SIM-V1,1.0,4")
    ((_, answer), (_, who)) = slave.feed(numbered.encode(number, "ST?") + numbered.encode(number, "ID?"), 0.0)
    read = numbered.decode(answer[:-1])
    assert read is not None
    reading = reading_of(ASCII, codec.fields_of(ASCII, ASCII.asks["status"], read[1]))
    assert read[0] == number
    assert reading.state == STATES[actuator.state]
    assert reading.force_n == pytest.approx(force, abs=0.08)
    assert (reading.setpoint_n, reading.position_mm) == pytest.approx((setpoint / 100.0, position / 1000))
    assert reading.fault == faults
    named = numbered.decode(who[:-1])
    assert named is not None
    identity = codec.identity(ASCII, codec.fields_of(ASCII, ASCII.asks["identity"], named[1]))
    assert (identity.model, identity.boot_id) == ("simulated VC50", "4")


@given(hundredths=st.integers(0, 5000))
def test_every_set_point_arrives_as_text_too(hundredths: int) -> None:
    actuator = coil()
    ((_, answer),) = AsciiSlave(actuator, "").feed(numbered.encode(1, f"F,{hundredths / 100.0:.2f}"), 0.0)
    assert numbered.decode(answer[:-1]) == (1, "OK")
    assert actuator.setpoint_n == pytest.approx(hundredths / 100.0, abs=1e-12)


# CAN adapters


FRAMES = st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8))


@pytest.fixture(scope="module")
def adapter() -> Iterator[slcanBus]:
    """Return python-can's slcan bus with its serial line looped back."""
    bus = slcanBus("loop://", bitrate=500000, sleep_after_open=0.0, timeout=0.0)
    bus.serialPortOrig.read(100)
    yield bus
    bus.shutdown()


@given(FRAMES)
def test_slcan_lines_of_the_library_and_of_the_adapter(adapter: slcanBus, frame: tuple[int, bytes]) -> None:
    message = can.Message(arbitration_id=frame[0], data=frame[1], is_extended_id=False)
    adapter.send(message)
    sent = adapter.serialPortOrig.read(100)
    assert slcan_frame(sent[:-1]) == frame
    arrived: list[tuple[int, bytes]] = []
    host = SlcanHost(lambda identifier, data: arrived.append((identifier, data)) or [])
    assert host.feed(b"O\r" + sent) == b"\rz\r"
    assert arrived == [frame]
    adapter.serialPortOrig.write(slcan_line(frame))
    received = adapter.recv(0.0)
    assert received is not None
    assert (received.arbitration_id, bytes(received.data), received.is_extended_id) == (*frame, False)


@given(FRAMES)
def test_socketcand_frames_of_the_library_and_of_the_server(frame: tuple[int, bytes]) -> None:
    arrived: list[tuple[int, bytes]] = []
    server = SocketcandHost(lambda identifier, data: arrived.append((identifier, data)) or [])
    message = can.Message(arbitration_id=frame[0], data=frame[1], is_extended_id=False)
    server.feed(b"< open can0 >< rawmode >" + convert_can_message_to_ascii_message(message).encode())
    assert arrived == [frame]
    received = convert_ascii_message_to_can_message(server.send([frame]).decode())
    assert (received.arbitration_id, bytes(received.data)) == frame


# MetroPro files


def through_a_file(content: bytes) -> SurfaceMap:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.dat"
        path.write_bytes(content)
        return reader.read(path)


HEIGHTS = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    elements=st.floats(-5e4, 5e4) | st.just(float("nan")),
)


def measured(heights: FloatArray) -> FloatArray:
    """Return the map with a value in the last sample: an empty last sample is refused."""
    heights[-1, -1] = 321.0
    return heights


def test_metropro_vector() -> None:
    page = vectors("metropro_dat")
    heights = np.array([[1000.0, -1000.0], [np.nan, 0.0]]) * writer.UNIT_NM
    content = writer.pack(writer.DatMap(heights, 0.5, "DEMO-100", 1700000000, "vector", "sim"))
    assert content[-16:].hex() == page["phase"]
    found = through_a_file(content)
    assert found.sha256 == page["sha256"]
    np.testing.assert_allclose(found.height_nm, heights, rtol=1e-12)
    assert (found.part_id, found.taken_at.timestamp() if found.taken_at else None) == ("DEMO-100", 1700000000)


@pytest.mark.full
@given(
    HEIGHTS, st.floats(0.01, 20.0), st.text("ABCxyz-0189 ", max_size=39),
    st.integers(int(EARLIEST.timestamp()), 2**31 - 1),
    st.tuples(st.integers(0, 500), st.integers(0, 500)),
)  # fmt: skip
def test_what_the_instrument_writes_is_what_is_read(
    heights: FloatArray, pitch: float, part: str, taken: int, origin: tuple[int, int]
) -> None:
    found = through_a_file(writer.pack(writer.DatMap(measured(heights), pitch, part, taken, origin_px=origin)))
    assert found.height_nm.shape == heights.shape
    np.testing.assert_array_equal(np.isnan(found.height_nm), np.isnan(heights), err_msg="holes")
    np.testing.assert_allclose(found.height_nm, heights, atol=0.51 * writer.UNIT_NM, err_msg="sign, scale, row order")
    assert found.pitch_mm == pytest.approx(pitch, rel=1e-6)
    assert found.part_id == part.strip()
    assert found.taken_at is not None
    assert found.taken_at.timestamp() == taken
    assert found.factors["origin_px"] == origin


@pytest.mark.full
@given(
    HEIGHTS, st.sampled_from([0, 1, 2]), st.integers(-2, 2), st.floats(0.25, 2.0), st.floats(4e-7, 1e-6),
    st.floats(0.5, 2.0), st.tuples(st.integers(0, 5), st.integers(0, 5), st.integers(0, 2)),
)  # fmt: skip
def test_files_of_other_instruments_are_read_alike(
    heights: FloatArray,
    resolution: int,
    sign: int,
    scale: float,
    wavelength_m: float,
    obliquity: float,
    intensity: tuple[int, int, int],
) -> None:
    content = bytearray(writer.pack(writer.DatMap(measured(heights), 0.5, "P")))
    struct.pack_into(">HHH", content, 52, *intensity)
    struct.pack_into(">i", content, 60, 2 * int(np.prod(intensity)))
    struct.pack_into(">ff", content, 164, scale, wavelength_m)
    struct.pack_into(">f", content, 176, obliquity)
    struct.pack_into(">h", content, 218, resolution)
    struct.pack_into(">h", content, 232, sign)
    content[writer.HEADER : writer.HEADER] = b"\x7f" * (2 * int(np.prod(intensity)))
    ours, theirs = through_a_file(bytes(content)), writer.unpack(bytes(content))
    np.testing.assert_allclose(ours.height_nm, theirs.height_nm, rtol=1e-12)
    assert ours.height_nm[-1, -1] * 321.0 * (-1 if sign else 1) > 0


@pytest.mark.full
@given(HEIGHTS, st.integers(min_value=0))
def test_a_torn_file_is_read_by_neither(heights: FloatArray, size: int) -> None:
    content = writer.pack(writer.DatMap(measured(heights), 0.5, "P"))
    torn = content[: size % len(content)]
    with pytest.raises(MapError):
        through_a_file(torn)
    with pytest.raises(MapError):
        writer.unpack(torn)
