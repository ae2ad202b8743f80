"""The loaded program on its way in: each block is read, checked and hashed before it is accepted."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from polishd.config.simulator import SimRobotSection
from polishd.model.errors import ProgramError
from polishd.model.surface import BoolArray
from polishd.sim_backends.robot.rnc import Pose, Reader, SimProgramBlock

Reach = Callable[[list[SimProgramBlock]], BoolArray]
"""Which of these blocks end where the robot can be, (n,)."""


@dataclass(slots=True)
class Intake:
    """Nothing after a refused block is accepted, and no last block of a program that is not the one announced."""

    config: SimRobotSection
    reach: Reach
    blocks: int
    blocks_sha256: str
    pose: Pose
    asked_from: int = -1
    """Block that RESEND has asked for."""
    _refusal: tuple[str, str] | None = None
    _reader: Reader = field(init=False)
    _hash: Any = field(default_factory=hashlib.sha256)

    def __post_init__(self) -> None:
        """Modal state begins anew with each program."""
        self._reader = Reader(self.pose)

    def refusal(self) -> tuple[str, str] | None:
        """Code and text, once a block was refused."""
        return self._refusal

    def take(self, first: int, lines: list[bytes]) -> list[SimProgramBlock]:
        """The blocks that are accepted of these, the first of which is the one expected."""
        blocks: list[SimProgramBlock] = []
        for seq, line in enumerate(lines, first):
            try:
                block = self._reader.read(line)
            except ProgramError as error:
                self._refuse(seq, "syntax", str(error))
                break
            if outside := self._outside(block):
                self._refuse(seq, "limits", outside)
                break
            blocks.append(block)
        can = self.reach(blocks)
        if not can.all():
            del blocks[int(can.argmin()) :]
            self._refuse(first + len(blocks), "limits", "out of the robot's reach")
        self._hash.update(b"".join(line + b"\n" for line in lines[: len(blocks)]))
        if first + len(blocks) == self.blocks and self._hash.hexdigest() != self.blocks_sha256:
            blocks.pop()
            self._refuse(self.blocks - 1, "hash", "with it these are not the blocks that LOAD announced")
        return blocks

    def _refuse(self, seq: int, code: str, text: str) -> None:
        self._refusal = code, f"block {seq}: {text}"

    def _outside(self, block: SimProgramBlock) -> str:
        limits = self.config
        ranges = (limits.x_mm, limits.y_mm, limits.z_mm, limits.a_deg)
        for axis, value, (low, high) in zip("XYZA", block.end, ranges, strict=False):
            if not low <= value <= high:
                return f"{axis} {value:g} is outside {low:g} to {high:g}"
        return ""
