"""The device type ``watched_folder``: an interferometer that leaves its maps in a folder."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from polishd.api import (
    BadMap,
    DeviceContext,
    DeviceStatus,
    DeviceType,
    Identity,
    LinkError,
    StaleMap,
    SurfaceError,
    SurfaceMap,
    SurfaceReader,
    WrongPart,
)
from polishd.plugins.interferometer import files
from polishd.plugins.interferometer.settled import Settled
from polishd.plugins.interferometer.taken import Taken

TORN_AFTER = 10
"""An unreadable file may still grow: it is refused only after so many times ``stable_s`` without a change."""

ConfigPath = Annotated[Path, Field(strict=False)]
Seconds = Annotated[float, Field(gt=0, le=86_400, allow_inf_nan=False)]


class FolderOptions(BaseModel):
    """Keys of ``[metrology] type = "watched_folder"``."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    folder: ConfigPath
    """Where maps appear. Relative to the config file's folder."""
    request_file: ConfigPath | None = None
    """Written to ask the instrument for a map; relative to ``folder``. None: nobody listens."""
    poll_s: Seconds = 0.5
    stable_polls: Annotated[int, Field(ge=2, le=1000)] = 3
    stable_s: Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)] = 2.0
    """A file is read once it has not changed for so many polls and so long."""
    timeout_s: Seconds = 3600.0
    """How long to wait for a map."""
    clock_tolerance_s: Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)] = 2.0
    """How far the instrument's clock may lag behind ours; files hold whole seconds only."""
    accept_unnamed: bool = False
    """Accept files that do not say whose map they hold."""
    claimed: ConfigPath = Path("taken")
    """Where taken maps are kept, under their sha256; relative to ``folder``, same file system."""
    refused: ConfigPath = Path("quarantine")
    """Where refused files are kept, each with a ``.reason.txt``; relative to ``folder``, same file system."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What a map is judged by."""

    after: str | None
    since: datetime | None
    """Maps measured earlier are stale; None where no pass has been run and nobody was asked."""


class WatchedFolder:
    """Metrology by files. Each content is given once; what is refused is kept, with its reason."""

    def __init__(self, options: FolderOptions, context: DeviceContext) -> None:
        self._options = options
        self._part_id = context.part_id
        self._readers: Sequence[SurfaceReader] = context.readers
        self._folder = context.base_dir / options.folder
        self._claimed = self._folder / options.claimed
        self._refused = self._folder / options.refused
        self._request = self._folder / options.request_file if options.request_file else None
        self._taken = Taken(context.state_dir / "maps_taken.json")

    async def open(self) -> None:
        """Check the folder and read which maps were taken before. LinkError where the folder cannot be used."""
        problem = await asyncio.to_thread(self._problem)
        if problem:
            raise LinkError(f"{problem}. To do: make it, mount it, or correct [metrology] folder.")
        await asyncio.to_thread(self._taken.load, self._claimed)

    async def close(self) -> None:
        """Nothing is held open."""

    async def identify(self) -> Identity:
        """The folder. Which instrument writes into it, each map says itself."""
        return Identity(vendor="", model="watched folder", serial=str(self._folder), firmware="")

    async def status(self) -> DeviceStatus:
        """Ready where the folder is there and can be written to; always safe."""
        problem = await asyncio.to_thread(self._problem)
        return DeviceStatus(ready=not problem, safe=True, state="absent" if problem else "watching", detail=problem)

    async def make_safe(self) -> None:
        """An instrument that only looks is always safe."""

    async def next_map(self, after: str | None) -> SurfaceMap:
        """Ask for a map and wait for it. SurfaceError, naming what was refused, when none came in time."""
        options = self._options
        asked = await asyncio.to_thread(self._ask, after)
        settled = Settled(options.stable_polls, options.stable_s)
        refused: list[str] = []
        start_s = time.monotonic()
        try:
            while (now_s := time.monotonic()) - start_s < options.timeout_s:
                found = await asyncio.to_thread(self._poll, settled, asked, now_s, refused)
                if found is not None:
                    return found
                await asyncio.sleep(options.poll_s)
        finally:
            self._withdraw()
        told = "; ".join(refused) or "no file came"
        raise SurfaceError(
            f"{self._folder}: no map of part {self._part_id!r} in {options.timeout_s:g} s: {told}. "
            f"To do: look at the instrument{f' and into {self._refused}' if refused else ''}, then resume."
        )

    def _problem(self) -> str:
        if not self._folder.is_dir():
            return f"{self._folder}: there is no such folder"
        if not os.access(self._folder, os.R_OK | os.W_OK | os.X_OK):
            return f"{self._folder}: the folder cannot be read and written to"
        return ""

    def _ask(self, after: str | None) -> Asked:
        now = datetime.now(UTC)
        if self._request is not None:
            request = {"part": self._part_id, "asked_at": now.isoformat(), "after": after}
            try:
                files.write_json(self._request, request)
            except OSError as error:
                raise SurfaceError(f"{self._request}: the request cannot be written: {error.strerror}") from error
        return Asked(after, now if self._request is not None or after is not None else None)

    def _withdraw(self) -> None:
        """A request that nobody took must not be served when nobody waits for its map."""
        if self._request is not None:
            with suppress(OSError):
                self._request.unlink(missing_ok=True)

    def _poll(self, settled: Settled, asked: Asked, now_s: float, refused: list[str]) -> SurfaceMap | None:
        """One full scan: the first trusted map, claimed; what is refused is put away and noted."""
        try:
            found = files.candidates(self._folder, [self._request] if self._request else [])
        except OSError:
            return None  # a share that is away for a while; the timeout ends this
        for path in settled.poll(found, now_s):
            try:
                surface = files.read_map(path, self._readers)
            except BadMap as error:
                if settled.quiet_s(path, now_s) >= self._torn_s:
                    self._put_away(path, error, refused)
                continue
            if files.identity(path) != found[path]:
                continue  # it was written to while it was read
            try:
                self._judge(surface, found[path], asked)
            except SurfaceError as error:
                self._put_away(path, error, refused)
                continue
            claimed = self._claim(path, found[path], surface.sha256)
            if claimed is not None:
                return replace(surface, path=claimed)
        return None

    @property
    def _torn_s(self) -> float:
        return TORN_AFTER * max(self._options.stable_s, self._options.poll_s)

    def _claim(self, path: Path, seen: files.Identity, sha256: str) -> Path | None:
        try:
            claimed = files.claim(path, seen, self._claimed, sha256)
            if claimed is not None:
                self._taken.add(sha256)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise SurfaceError(
                f"{path}: cannot be moved to {self._claimed} and recorded: {error.strerror}. "
                "To do: both must be on one file system, with room and the right to write."
            ) from error
        return claimed

    def _judge(self, surface: SurfaceMap, seen: files.Identity, asked: Asked) -> None:
        if surface.sha256 == asked.after or surface.sha256 in self._taken:
            raise StaleMap(f"the same content was taken before (sha256 {surface.sha256[:12]}…)")
        if not surface.part_id and not self._options.accept_unnamed:
            raise WrongPart(f"it does not say whose map it is; the part is {self._part_id!r}")
        if surface.part_id and surface.part_id != self._part_id:
            raise WrongPart(f"it shows part {surface.part_id!r}, the part is {self._part_id!r}")
        measured = surface.taken_at or datetime.fromtimestamp(seen.mtime_ns / 1e9, UTC)
        tolerance = timedelta(seconds=self._options.clock_tolerance_s)
        if asked.since is not None and measured < asked.since - tolerance:
            raise StaleMap(f"measured at {measured.isoformat()}, before it was asked for at {asked.since.isoformat()}")
        if surface.pitch_mm is None:
            raise BadMap("it has no lateral scale: such a map cannot drive polishing")

    def _put_away(self, path: Path, error: SurfaceError, refused: list[str]) -> None:
        reason = f"{path.name}: {type(error).__name__}: {str(error).removeprefix(f'{path}: ')}"
        try:
            files.quarantine(path, self._refused, reason)
        except OSError as problem:
            reason += f" (and it cannot be moved to {self._refused}: {problem.strerror})"
        if reason not in refused:
            refused.append(reason)


WATCHED_FOLDER = DeviceType(name="watched_folder", port="metrology", options=FolderOptions, build=WatchedFolder)
