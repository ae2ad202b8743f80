"""The physics and the mathematics: pure functions on arrays. No I/O, no asyncio, no logging."""
