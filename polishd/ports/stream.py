"""An ordered stream of bytes: TCP, serial line or pseudo-terminal."""

from typing import Protocol


class ByteStream(Protocol):
    """Reads and writes raise LinkError when the link is dead; a message is never assumed to be one read."""

    async def read(self, at_most: int, within_s: float) -> bytes:
        """At least one byte, or LinkError after ``within_s`` seconds of silence or at end of file."""
        ...

    async def write(self, data: bytes) -> None:
        """Hand over all bytes, or LinkError."""
        ...

    async def close(self) -> None:
        """Idempotent."""
        ...
