"""Simulate a serial receiver with other settings than the sender: it samples the levels at its own rate."""

from __future__ import annotations

from polishd.drivers.transport.address import SerialLine


def sampled(data: bytes, sent: SerialLine, by: SerialLine, *, drops_broken: bool) -> bytes:
    """Return the bytes that a receiver with settings ``by`` reads of ``data``, sent with ``sent`` without pauses.

    A character whose parity or stop bit is wrong is dropped, or kept, as a computer's port does that is not to check.
    """
    levels = [level for byte in data for level in _levels(byte, sent)] + [1] * (12 * sent.baud // by.baud + 12)
    found, at_s, end_s = bytearray(), 0.0, len(levels) / sent.baud

    def level(after_bits: float) -> int:
        place = int((at_s + after_bits / by.baud) * sent.baud)
        return levels[place] if place < len(levels) else 1

    while at_s < end_s:
        if level(0.0):  # no start bit yet
            at_s += 0.25 / by.baud
            continue
        bits = [level(1.5 + bit) for bit in range(8)]
        checked = [level(9.5)] if by.parity != "none" else []
        sound = _parity(bits, by) == checked and level(9.5 + len(checked)) == 1
        if sound or not drops_broken:
            found.append(sum(bit << place for place, bit in enumerate(bits)))
        at_s += (9.75 + len(checked)) / by.baud
    return bytes(found)


def _levels(byte: int, line: SerialLine) -> list[int]:
    """Return the levels: start bit, data from the lowest bit on, parity, stop bits."""
    bits = [byte >> place & 1 for place in range(8)]
    return [0, *bits, *_parity(bits, line), *[1] * line.stop_bits]


def _parity(bits: list[int], line: SerialLine) -> list[int]:
    return [] if line.parity == "none" else [sum(bits) % 2 ^ (line.parity == "odd")]
