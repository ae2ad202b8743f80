"""The device type ``watched_folder``: an interferometer that leaves its maps in a folder."""

from __future__ import annotations

import asyncio
import errno
import json
import logging
import os
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field

from polishd.api import (
    DeviceContext,
    DeviceIdentity,
    DeviceStatus,
    DeviceType,
    LinkError,
    MapError,
    MapRefusal,
    StaleMap,
    SurfaceError,
    SurfaceMap,
    WrongPart,
)
from polishd.model.instrument import Instrument
from polishd.plugins.interferometer import map_files
from polishd.plugins.interferometer.formats.common import is_level
from polishd.plugins.interferometer.map_files import DeliveredMap, FileIdentity, MapRequest, TakenMaps, heights_digest
from polishd.process.metrology.instrument import require_profile
from polishd.util.address_claims import Claim, claim, folder_key
from polishd.util.files import named_path, write_atomic

# Whether a map that is whole is the one that is waited for: of this part, new, in order, and plausible.

LATEST_S = 2.0**35
"""Some file systems can date a file later than datetime can hold; that is a thousand years from now."""


@dataclass(frozen=True, slots=True)
class MapAcceptanceRules:
    """What every map is held against."""

    part_id: str
    accept_without_part_id: bool
    clock_tolerance_s: float
    instrument: Instrument | None


def source_of(surface: SurfaceMap) -> str:
    """Part and instrument: times are in order only among maps of the same."""
    return f"{surface.part_id} | {surface.instrument}"


def require_plausible(surface: SurfaceMap, rules: MapAcceptanceRules) -> None:
    """WrongPart where it shows another part.

    MapError where all its heights are equal, and where the profile, or none, cannot be applied to it.
    """
    if not surface.part_id and not rules.accept_without_part_id:
        raise WrongPart(f"it does not say whose map it is; the part is {rules.part_id!r}")
    if surface.part_id and surface.part_id != rules.part_id:
        raise WrongPart(f"it shows part {surface.part_id!r}, the part is {rules.part_id!r}")
    if is_level(surface.height_nm):
        raise MapError("all its heights are equal: nothing was measured")
    require_profile(surface, rules.instrument)  # the daemon applies it, a refusal is ours


def require_new(
    surface: SurfaceMap, seen: tuple[Path, FileIdentity], ask: MapRequest, taken: TakenMaps, rules: MapAcceptanceRules
) -> None:
    """StaleMap, in words for: duplicate, out of order, stale. A name with the token of the ask is new in any case.

    WrongPart where it names no part, and has the heights of a map that was taken for another one.
    """
    path, identity = seen
    if surface.sha256 == ask.after or surface.sha256 in taken:
        raise StaleMap(f"duplicate: the same content was taken before (sha256 {surface.sha256[:12]}…)")
    if not surface.part_id and (other := taken.other_part(heights_digest(surface), rules.part_id)):
        raise WrongPart(
            f"it does not say whose map it is, and has the heights of a map that was taken for part {other!r}; the "
            f"part is {rules.part_id!r}"
        )
    if ask.token in path.name:
        return
    nevertheless = (
        f". If that is a clock's mistake and the map is the one to use, move it back as {path.stem}-{ask.token}"
        f"{path.suffix} while it is waited for; else measure again"
    )
    measured, last = surface.measured_at, taken.last(source_of(surface))
    if measured is not None and last is not None and measured < last:
        raise StaleMap(
            f"out of order: measured at {measured.isoformat()}, before the last map that was taken, of "
            f"{last.isoformat()}, both by the instrument's clock{nevertheless}"
        )
    if ask.since is None:
        return
    tolerance = timedelta(seconds=rules.clock_tolerance_s)
    written = datetime.fromtimestamp(min(max(identity.mtime_ns / 1e9, 0), LATEST_S), UTC)
    at, how = (measured, "measured") if measured else (written, "its header has no date that counts; written")
    if at < ask.since - tolerance:
        raise StaleMap(
            f"stale: {how} at {at.isoformat()}, before it was asked for at {ask.since.isoformat()} by the folder's "
            f"clock{nevertheless}"
        )
    if ask.present.get(path.name) == identity and abs(written - ask.since) > tolerance:
        raise StaleMap(f"stale: it lay there when the map was asked for, at {ask.since.isoformat()}{nevertheless}")


T = TypeVar("T")

TORN_AFTER = 10
"""An unreadable file may still grow: it is refused only after so many times ``stable_s`` without a change."""
MOST_TIMES = 3
"""A claimed map that the journal never names is handed on again after a restart, so often in all."""
PERMANENT = {
    errno.EXDEV, errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.EROFS, errno.EINVAL, errno.ENAMETOOLONG, errno.ELOOP,
}  # fmt: skip
"""What waiting does not mend. All else may pass: a share that is away, a file that is locked, a full disk."""

LOOK_S, READ_S = 0.5, 1.0
"""Longest that one poll looks at names, and begins to read files, s: what is left comes with the next polls."""
CROWDED = 1000
"""With more files than that in the folder ``status`` says that they delay a map."""
ANSWER_S = 2.0
"""Longest that ``status`` waits for the file system, s."""
WITHDRAW_S = 1.0
"""Longest that the end of a wait is held up by the request that it takes back, s."""
SILENT_S = 10.0
"""Time without an answer after which a file system counts as silent, s."""

log = logging.getLogger(__name__)

ConfigPath = Annotated[Path, Field(strict=False)]
Seconds = Annotated[float, Field(gt=0, le=86_400, allow_inf_nan=False)]


class FolderOptions(BaseModel):
    """Keys of ``[metrology] type = "watched_folder"``."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, defer_build=True)

    folder: ConfigPath
    """Where maps appear. Relative to the config file's folder."""
    request_file: ConfigPath | None = None
    """Written to request a map from the instrument; relative to ``folder``. None: no request is written."""
    poll_s: Seconds = 0.25
    """How often the folder is looked into."""
    stable_polls: Annotated[int, Field(ge=2, le=1000)] = 3
    """A file is read once it has not changed for so many polls, ... [1]"""
    stable_s: Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)] = 2.0
    """... and so long: taken ``stable_s`` + ``poll_s`` after its last byte, and the time that reading takes. 2 s and
    more on a network share."""
    timeout_s: Seconds = 3600.0
    """How long to wait for a map."""
    clock_tolerance_s: Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)] = 2.0
    """How far the instrument's clock may lag behind the folder's; files hold whole seconds only."""
    accept_without_part_id: bool = False
    """Accept files that do not name their part. A map of the last part without a date, or measured again after the
    request, is then taken for this part's (docs/how-to/maps-folder.md): name maps where you can."""
    claimed_dir: ConfigPath = Path("taken")
    """Where taken maps are kept, under their sha256; relative to ``folder``, same file system."""
    refused_dir: ConfigPath = Path("quarantine")
    """Where refused files are kept, each with a ``.reason.txt``; relative to ``folder``, same file system."""


@dataclass(slots=True)
class MapWait:
    """One wait for a map."""

    after: str | None
    settled: map_files.SettledFiles
    ask: MapRequest | None = None
    requested: bool = False
    refused: list[str] = field(default_factory=list)
    refusals: list[MapRefusal] = field(default_factory=list)
    """Not reported yet."""
    another_part: bool = False
    """A map of another part came."""
    trouble: str = ""
    """What keeps the folder from being served now."""
    listing: map_files.FolderListing | None = None
    crowded: bool = False
    """It was said that the folder holds too many files."""


class FolderThread:
    """Runs what touches the folder, one call at a time, in a thread that nothing waits for at the end.

    A share that hangs takes this thread and no other one: not the event loop, and none of those that journal and health
    need. While a call hangs, no further one begins. The thread begins with the first call and serves all later ones:
    one that began where memory is out could keep the loop waiting for it.
    """

    def __init__(self) -> None:
        self._call: asyncio.Future[Any] | None = None
        self._began_s = 0.0
        self._work: queue.SimpleQueue[Callable[[], None] | None] | None = None

    @property
    def busy_s(self) -> float:
        """For how long the call that is under way has been so, s; 0 where none is."""
        return 0.0 if self._call is None or self._call.done() else time.monotonic() - self._began_s

    async def run(self, work: Callable[..., T], *arguments: Any, within_s: float = SILENT_S) -> T:
        """Return what ``work`` returns. TimeoutError where that, or the call before it, takes longer."""
        end_s = time.monotonic() + within_s
        while self._call is not None and not self._call.done():
            await self._ended(self._call, end_s)
        loop, context = asyncio.get_running_loop(), copy_context()
        call: asyncio.Future[T] = loop.create_future()
        call.add_done_callback(lambda done: done.cancelled() or done.exception())  # also after the wait has ended
        self._call, self._began_s = call, time.monotonic()

        def tell(result: T | None, error: BaseException | None) -> None:
            if error is None:
                call.set_result(cast(T, result))
            else:
                call.set_exception(error)

        def act() -> None:
            result, error = None, None
            try:
                result = context.run(work, *arguments)
            except BaseException as raised:  # noqa: BLE001 - it is raised where the call is awaited
                error = raised
            with suppress(RuntimeError):  # the loop has ended meanwhile
                loop.call_soon_threadsafe(tell, result, error)

        self.begin().put(act)
        await self._ended(call, end_s)
        return call.result()

    def end(self) -> None:
        """Let the thread end after its call; a later call begins another one."""
        if self._work is not None:
            self._work.put(None)
            self._work = None

    def begin(self) -> queue.SimpleQueue[Callable[[], None] | None]:
        """Begin the thread, if none serves; what it is to do."""
        if self._work is None:
            self._work = queue.SimpleQueue()
            threading.Thread(target=_serve, args=(self._work,), name="maps folder", daemon=True).start()
        return self._work

    @staticmethod
    async def _ended(call: asyncio.Future[Any], end_s: float) -> None:
        done, _ = await asyncio.wait({call}, timeout=max(end_s - time.monotonic(), 0.0))
        if not done:
            raise TimeoutError


def _serve(work: queue.SimpleQueue[Callable[[], None] | None]) -> None:
    while (act := work.get()) is not None:
        act()
        del act  # it holds what the call was given


class WatchedFolder:
    """Metrology by files. Each content is given once; what is refused is kept, with its reason."""

    def __init__(self, options: FolderOptions, context: DeviceContext) -> None:
        self._options = options
        self._readers = context.readers
        self._rules = MapAcceptanceRules(
            context.part_id, options.accept_without_part_id, options.clock_tolerance_s, instrument=context.instrument
        )
        self._folder = named_path(context.base_dir, options.folder)
        self._claimed = self._folder / options.claimed_dir
        self._refused = self._folder / options.refused_dir
        self._request = self._folder / options.request_file if options.request_file else None
        self._taken: TakenMaps | None = None
        self._record = context.state_dir / "maps_taken.json"
        self._polling = threading.Lock()
        self._thread, self._ends = FolderThread(), FolderThread()
        self._waits = 0
        self._trouble = ""
        self._listener: Callable[[MapRefusal], None] | None = None
        self._address_claim = Claim()

    def on_refusal(self, listener: Callable[[MapRefusal], None] | None) -> None:
        """Report each refused map to it."""
        self._listener = listener

    async def open(self) -> None:
        """Check the folder and read which maps were taken before.

        LinkError where the folder cannot be used; DeviceClaimed where another program takes maps from it.
        """
        await self.close()
        self._ends.begin()
        try:
            problem = await self._thread.run(self._problem)
            if problem:
                raise LinkError(f"{problem}. To do: make it, mount it, or correct [metrology] folder.")
            self._address_claim = await self._thread.run(self._claim_folder)
            await self._thread.run(self._load)
        except TimeoutError:
            raise LinkError(f"{self._silent(SILENT_S)}. To do: check the mount and its server.") from None

    def _claim_folder(self) -> Claim:
        return claim([folder_key(self._folder)], str(self._folder))

    async def close(self) -> None:
        """Another program may take maps from the folder now."""
        self._address_claim.release()
        self._thread.end()
        self._ends.end()

    async def identify(self) -> DeviceIdentity:
        """The folder. Which instrument writes into it, each map says itself."""
        return DeviceIdentity(vendor="", model="watched folder", serial=str(self._folder), firmware="")

    async def status(self) -> DeviceStatus:
        """Ready where the folder is there, can be written to, and has room; always safe."""
        busy_s = self._thread.busy_s
        try:
            problem = await self._thread.run(self._problem, within_s=ANSWER_S) if not busy_s else ""
        except TimeoutError:
            problem = self._silent(ANSWER_S)
        if busy_s > SILENT_S:
            problem = self._silent(busy_s)
        state = "absent" if problem else "in trouble" if self._trouble else "watching"
        return DeviceStatus(ready=state == "watching", safe=True, state=state, detail=problem or self._trouble)

    async def make_safe(self) -> None:
        """An instrument that only looks is always safe."""

    async def next_map(self, after: str | None) -> SurfaceMap:
        """Ask for a map and wait for it. SurfaceError, naming what was refused, when none came in time.

        A map that was claimed for the same ``after`` and not handed on by this process (it was killed in between, or
        the wait was cancelled) comes first.
        """
        options = self._options
        wait = MapWait(after, map_files.SettledFiles(options.stable_polls, options.stable_s))
        start_s = time.monotonic()
        self._waits += 1
        try:
            while (now_s := time.monotonic()) - start_s < options.timeout_s:
                # The last look may end later than the wait: a folder is not silent because the wait is over.
                answer_s = max(start_s + options.timeout_s - now_s, ANSWER_S)
                try:
                    found = await self._thread.run(self._poll, wait, now_s, within_s=min(SILENT_S, answer_s))
                except TimeoutError:  # a map that is claimed after this comes first with the next poll
                    self._notice(wait, self._silent(self._thread.busy_s))
                    continue
                while wait.refusals:
                    refusal = wait.refusals.pop(0)
                    if self._listener is not None:
                        self._listener(refusal)
                if found is not None:
                    self._load().handed(found.sha256)
                    return found
                end_s = time.monotonic()
                rest_s = wait.settled.rest_s(end_s, options.poll_s)
                await asyncio.sleep(max(rest_s, end_s - now_s))  # a crowded folder takes half of a processor at most
        finally:
            self._waits -= 1
            if self._request is not None:
                with suppress(TimeoutError):  # it is done when the file system answers again
                    await self._ends.run(self._withdraw, within_s=WITHDRAW_S)
        reason = "; ".join([*wait.refused, *([wait.trouble] if wait.trouble else [])]) or "no file came"
        kind = WrongPart if wait.another_part else SurfaceError
        raise kind(
            f"{self._folder}: no map of part {self._rules.part_id!r} in {options.timeout_s:g} s: {reason}. "
            f"To do: check the instrument{f' and {self._refused}' if wait.refused else ''}."
        )

    def _withdraw(self) -> None:
        """Delete a request that was not served, so that it is not served after the wait."""
        with self._polling, suppress(OSError):
            if self._request is not None and self._waits == 0:
                self._request.unlink(missing_ok=True)

    def _silent(self, silent_s: float) -> str:
        return f"{self._folder}: the file system has not answered for {silent_s:.0f} s"

    def _notice(self, wait: MapWait, trouble: str) -> None:
        """Keep the trouble for ``status``; log it once a wait."""
        if not wait.trouble:
            log.warning("%s", trouble)
        wait.trouble = self._trouble = trouble

    def _problem(self) -> str:
        try:
            if not self._folder.is_dir():
                return f"{self._folder}: there is no such folder"
        except OSError as error:  # a share that went stale
            return f"{self._folder}: {error.strerror}"
        if not os.access(self._folder, os.R_OK | os.W_OK | os.X_OK):
            return f"{self._folder}: the folder cannot be read and written to"
        return ""

    def _load(self) -> TakenMaps:
        if self._taken is None:
            taken = TakenMaps(self._record, self._claimed)
            taken.load()
            self._taken = taken
        return self._taken

    def _poll(self, wait: MapWait, now_s: float) -> SurfaceMap | None:
        """Scan the folder once: claim the first trusted map; quarantine and note refused files.

        A cancelled wait leaves its last poll running; the lock makes the next poll wait for it.
        """
        with self._polling:
            wait.trouble = ""
            try:
                ask = self._asked(wait)
                return self._claimed_before(wait, ask) or self._scan(wait, ask, now_s)
            except OSError as error:
                wait.trouble = f"{error.filename or self._folder}: {error.strerror or error}"
                if error.errno in PERMANENT:
                    raise SurfaceError(
                        f"{self._folder}: maps cannot be moved to {self._claimed} or {self._refused}, or be recorded "
                        f"in {self._record}: {wait.trouble}. To do: the first three must be folders on one file "
                        "system, with room and the right to write."
                    ) from error
                return None
            finally:
                self._trouble = wait.trouble

    def _asked(self, wait: MapWait) -> MapRequest:
        """The request; unchanged where no map was taken since. The request file is written last."""
        if wait.ask is None:
            taken, part = self._load(), self._rules.part_id
            unnamed = self._options.accept_without_part_id and taken.any  # one of the last part's may lie there
            demanding = self._request is not None or wait.after is not None or unnamed
            wait.ask = taken.ask(wait.after, part)
            if wait.ask is None:
                if (other := taken.asked_for_other(part)) is not None and other.after == wait.after:
                    self._put_away_claimed(other, wait)
                since = map_files.clock_of(self._folder) if demanding else None
                present = {path.name: seen for path, seen in self._candidates().items()} if demanding else {}
                wait.ask = taken.begin(wait.after, since, present, part)
        return wait.ask

    def _demand(self, wait: MapWait, ask: MapRequest) -> None:
        if self._request is None or wait.requested:
            return
        request = {"part": self._rules.part_id, "after": ask.after, "token": ask.token}
        request["asked_at"] = ask.since.isoformat() if ask.since else None
        if self._folder.is_dir() and not self._request.parent.is_dir():
            raise SurfaceError(f"{self._request}: the request cannot be written: its folder is not there")
        write_atomic(self._request, json.dumps(request, indent=1).encode() + b"\n")
        wait.requested = True

    def _candidates(self) -> dict[Path, map_files.FileIdentity]:
        return map_files.candidates(self._folder, [self._request] if self._request else [])

    def _claimed_before(self, wait: MapWait, ask: MapRequest) -> SurfaceMap | None:
        """A map that was claimed and not delivered: the daemon was killed, or the share lost the answer."""
        for given in self._load().pending(ask):
            path = self._claimed / given.claimed
            if not map_files.is_unchanged(path, given.sha256, self._folder / given.name):
                continue
            try:
                if given.times >= MOST_TIMES:
                    raise MapError(f"it was handed on {given.times} times and never journalled: the log says why")
                surface = map_files.read_map(path, self._readers)
                require_plausible(surface, self._rules)
            except SurfaceError as error:
                self._put_away(path, error, wait)
                continue
            self._load().hand_on(ask, given)
            return surface
        return None

    def _put_away_claimed(self, other: MapRequest, wait: MapWait) -> None:
        """Refuse files that were claimed for another part and never delivered, whatever they state."""
        for given in self._load().pending(other):
            path = self._claimed / given.claimed
            if not map_files.is_unchanged(path, given.sha256, self._folder / given.name):
                continue
            try:
                require_plausible(map_files.read_map(path, self._readers), self._rules)
                raise WrongPart(f"it was claimed for part {other.part!r}, the part is {self._rules.part_id!r}")
            except SurfaceError as error:
                self._put_away(path, error, wait)

    def _scan(self, wait: MapWait, ask: MapRequest, now_s: float) -> SurfaceMap | None:
        """Claim the trusted map that was measured first."""
        self._demand(wait, ask)
        if wait.listing is None:
            wait.listing = map_files.FolderListing(self._folder, [self._request] if self._request else [])
        found, others = wait.listing.look(LOOK_S)
        best: tuple[tuple[float, int, str], Path, SurfaceMap] | None = None
        rested = wait.settled.poll(found, now_s, others)
        began_s, reads = time.monotonic(), 0
        for path in rested:
            if reads and time.monotonic() - began_s > READ_S:
                break
            reads += 1
            surface = self._judged(path, found[path], wait, ask, now_s)
            if surface is not None:
                at = surface.measured_at
                seen = found[path]
                key = (at.timestamp() if at else seen.mtime_ns / 1e9, seen.mtime_ns, path.name)
                best = min(filter(None, (best, (key, path, surface))), key=lambda one: one[0])
        self._say_crowded(wait, unread=len(rested) - reads)
        return self._claim(best[1], found[best[1]], best[2], ask) if best else None

    def _say_crowded(self, wait: MapWait, unread: int) -> None:
        """Warn that files which are not maps delay the map."""
        count = len(wait.listing or ())
        if not unread and count <= CROWDED:
            return
        warning = (
            f"{self._folder}: holds {count} files, which delay a map: they are read a few at a time, the newest first. "
            "Move files that are no maps out of it"
        )
        wait.trouble = wait.trouble or warning
        if not wait.crowded:
            log.warning("%s", warning)
        wait.crowded = True

    def _judged(
        self, path: Path, seen: map_files.FileIdentity, wait: MapWait, ask: MapRequest, now_s: float
    ) -> SurfaceMap | None:
        """The map if it is acceptable; None where it is refused or not complete yet."""
        try:
            surface = map_files.read_map(path, self._readers)
        except MapError as error:
            torn_s = TORN_AFTER * max(self._options.stable_s, self._options.poll_s)
            wait.settled.put_off(path, now_s)
            if wait.settled.quiet_s(path, now_s) >= torn_s and map_files.identity(path) == seen:
                self._put_away(path, error, wait)
            return None
        except OSError as error:
            wait.settled.put_off(path, now_s)
            wait.trouble = f"{path}: {error.strerror or error}"
            return None
        if map_files.identity(path) != seen:
            return None  # it was written to while it was read
        try:
            require_plausible(surface, self._rules)
            require_new(surface, (path, seen), ask, self._load(), self._rules)
            if os.path.lexists(self._target(path, surface)):
                raise StaleMap(f"duplicate: the same content lies in {self._claimed} (sha256 {surface.sha256[:12]}…)")
        except SurfaceError as error:
            self._put_away(path, error, wait)
            return None
        return surface

    def _target(self, path: Path, surface: SurfaceMap) -> Path:
        return self._claimed / f"{surface.sha256}{path.suffix}"

    def _claim(
        self, path: Path, seen: map_files.FileIdentity, surface: SurfaceMap, ask: MapRequest
    ) -> SurfaceMap | None:
        target, taken = self._target(path, surface), self._load()
        given = DeliveredMap(
            sha256=surface.sha256,
            name=path.name,
            claimed=target.name,
            source=source_of(surface),
            measured=surface.measured_at,
            heights=heights_digest(surface),
        )
        taken.give(ask, given)
        if not map_files.claim_file(path, seen, target, surface.sha256):
            return None
        taken.hand_on(ask, given)
        return replace(surface, path=target)

    def _put_away(self, path: Path, error: SurfaceError, wait: MapWait) -> None:
        why = str(error).removeprefix(f"{path}: ")
        reason = f"{path.name}: {type(error).__name__}: {why}"
        why = why.removeprefix(f"{path.name}: ")
        kept: Path | None = None
        try:
            kept = map_files.quarantine_file(path, self._refused, reason)
        except OSError as problem:
            wait.trouble = f"{path} cannot be moved to {self._refused}: {problem.strerror or problem}"
            reason += f" (and it cannot be moved to {self._refused}: {problem.strerror or problem})"
        wait.another_part = wait.another_part or isinstance(error, WrongPart)
        if reason not in wait.refused:
            wait.refused.append(reason)
            todo = _advice(error, self._rules)
            wait.refusals.append(MapRefusal(path.name, type(error).__name__, why, todo, str(kept or "")))


def _advice(error: SurfaceError, rules: MapAcceptanceRules) -> str:
    match error:
        case WrongPart() if rules.accept_without_part_id:
            return f"Mount part {rules.part_id!r} and measure it. Keep files of other parts out of the folder."
        case WrongPart():
            return (
                f"Measure part {rules.part_id!r} and export it under that name; where the instrument names no part, "
                "set metrology.accept_without_part_id = true."
            )
        case StaleMap():
            return "Measure again: the map is older than the request, or was taken before."
        case _:
            return "Correct what the reason names, then measure and export again."


WATCHED_FOLDER = DeviceType(
    "watched_folder", "metrology", FolderOptions, WatchedFolder, simulated_by="interferometer", substitute={}
)
