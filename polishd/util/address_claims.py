"""Claims on device addresses: one program on this computer at a device, whatever its state folder or user.

A claim is an flock on a file named by a hash of the address. The kernel drops it when its process ends, however it
ends. It is held per process: several devices of one cell may share an endpoint. It guards against mistakes between
programs of ours, not against a local user who means harm.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import socket
import stat
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from ipaddress import IPv6Address, ip_address
from pathlib import Path

from polishd.model.errors import DeviceClaimed, LinkError

FOLDERS = (Path("/run/lock"), Path("/dev/shm"))  # noqa: S108 - shared between users by intent
"""A claim is taken below each of these that can be written: two users who can write different ones still meet."""
LOOPBACK = "localhost"
PTY_MAJORS = range(136, 144)
LONGEST_NAME = 200
"""Characters of a holder's command or cell in a message."""
TRIES = 20


def tcp_keys(host: str, resolved: Iterable[str], port: int, part: str = "") -> set[str]:
    """Normalized names of a TCP endpoint, one for each IP address; ``part`` distinguishes endpoints behind one port."""
    hosts = {_normalized(one) for one in resolved} or {host.lower().rstrip(".")}
    return {f"tcp:{one}:{port}" + (f"/{part}" if part else "") for one in hosts}


def serial_key(path: Path) -> str:
    """Normalized name of a serial port: the same for each path and link that leads to it."""
    try:
        found = path.stat()
    except OSError:
        return f"serial:{os.path.realpath(path)}"
    if not stat.S_ISCHR(found.st_mode):
        return f"serial:{os.path.realpath(path)}"
    number = f"{os.major(found.st_rdev)}:{os.minor(found.st_rdev)}"
    if os.major(found.st_rdev) not in PTY_MAJORS:
        return f"serial:{number}"
    # Pseudo-terminals of two containers share their numbers, and so do two that follow each other: without the time
    # it was made, a claim that outlives its terminal for a moment refused the next one.
    return f"serial:{number}@{found.st_dev}/{found.st_ctime_ns}"


def folder_key(path: Path) -> str:
    """Normalized name of a folder that a device is reached through."""
    try:
        found = path.stat()
    except OSError:
        return f"folder:{os.path.realpath(path)}"
    return f"folder:{found.st_dev}:{found.st_ino}"


@dataclass(eq=False, slots=True)
class Claim:
    """Right of this process to use an address, until ``release``."""

    keys: frozenset[str] = frozenset()

    def release(self) -> None:
        """Give it back; idempotent. Other claims of this process on the same address stay."""
        with _mutex:
            keys, self.keys = self.keys, frozenset()
            for key in keys:
                _release(key)


@dataclass(eq=False, slots=True)
class KeptClaims:
    """Claims of a cell from its opening to its closing: kept although connections break and are made anew."""

    cell: str = ""
    """Name of the cell, for the message to another program."""
    command: str = ""
    """The program, where its command line does not say it."""
    _kept: set[str] = field(default_factory=set)
    _closed: bool = True

    @contextmanager
    def keeping(self) -> Iterator[None]:
        """Keep the claims that are taken in the block, and by tasks that begin in it."""
        self._closed = False
        token = _keeper.set(self)
        try:
            yield
        finally:
            _keeper.reset(token)

    def release(self) -> None:
        """Give all of them back; idempotent."""
        with _mutex:
            self._closed = True
            kept, self._kept = self._kept, set()
            for key in kept:
                _release(key)

    def keep(self, keys: Iterable[str]) -> None:
        """Keep claims that were taken just now; none after ``release``."""
        if not self._closed:
            for key in set(keys) - self._kept:
                self._kept.add(key)
                _locks[key].users += 1


@dataclass(slots=True)
class _Lock:
    files: list[tuple[int, Path]]
    users: int = 0


_mutex = threading.RLock()
_locks: dict[str, _Lock] = {}
_keeper: ContextVar[KeptClaims | None] = ContextVar("keeper", default=None)


def claim(keys: Iterable[str], name: str) -> Claim:
    """Claim an address by its normalized names. ``name`` is how messages call it.

    Raises:
        DeviceClaimed: another process has it. The message names that process and its cell.
        LinkError: no folder for claims can be written.
    """
    taken: list[str] = []
    with _mutex:
        try:
            for key in sorted(set(keys)):
                if key not in _locks:
                    _locks[key] = _Lock(_lock_files(key, name))
                _locks[key].users += 1
                taken.append(key)
        except BaseException:
            for key in taken:
                _release(key)
            raise
        if (keeper := _keeper.get()) is not None:
            keeper.keep(taken)
    return Claim(frozenset(taken))


def _release(key: str) -> None:
    lock = _locks[key]
    lock.users -= 1
    if lock.users <= 0:
        del _locks[key]
        _unlock(lock.files)


def _lock_files(key: str, name: str) -> list[tuple[int, Path]]:
    file_name = hashlib.sha256(key.encode()).hexdigest()[:32]
    locked: list[tuple[int, Path]] = []
    why = "no folder"
    for folder in _folders():
        try:
            locked.append((_lock_file(folder / file_name), folder / file_name))
        except BlockingIOError as busy:
            _unlock(locked)
            raise DeviceClaimed(
                f"{name}: another program uses this device: {_told(busy)}. Stop that program first. "
                "Nothing was sent to the device."
            ) from None
        except OSError as error:
            why = str(error)
    if not locked:
        raise LinkError(
            f"{name}: the address cannot be claimed on this computer: {why}. "
            f"Make {FOLDERS[-1]} or {tempfile.gettempdir()} writable."
        )
    return locked


def _folders() -> list[Path]:
    found = list(filter(None, map(_shared, FOLDERS)))
    return found or list(filter(None, [_shared(Path(tempfile.gettempdir()))]))


def _shared(parent: Path) -> Path | None:
    """Our folder in there, which all users may write; None where it cannot be used."""
    folder = parent / "polishd"
    try:
        with contextlib.suppress(FileExistsError):
            folder.mkdir()
            folder.chmod(0o1777)
        if not stat.S_ISDIR(folder.lstat().st_mode):
            return None
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


def _lock_file(path: Path) -> int:
    """Lock it and write who we are. BlockingIOError says who holds it; a file that was removed meanwhile is none."""
    for _ in range(TRIES):
        handle = _opened(path)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(handle, path):
                _write_holder(handle)
                return handle
        except BlockingIOError:
            holder = os.pread(handle, 4096, 0)
            os.close(handle)
            raise BlockingIOError(errno.EWOULDBLOCK, holder.decode("utf-8", "replace")) from None
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)
    raise OSError(f"{path} is removed again and again")


def _opened(path: Path) -> int:
    """Open the file, which another user may own: such a one in a shared folder is not opened by ``O_CREAT``."""
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW
    for _ in range(TRIES):
        with contextlib.suppress(FileNotFoundError):
            return os.open(path, flags)
        with contextlib.suppress(FileExistsError):
            handle = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
            os.fchmod(handle, 0o666)
            return handle
    raise OSError(f"{path} comes and goes")


def _is_at(handle: int, path: Path) -> bool:
    try:
        there = path.lstat()
    except FileNotFoundError:
        return False
    own = os.fstat(handle)
    return (own.st_dev, own.st_ino) == (there.st_dev, there.st_ino)


def _write_holder(handle: int) -> None:
    """A disk that is full takes the claim, and not who has it."""
    keeper = _keeper.get() or KeptClaims()
    holder = {"pid": os.getpid(), "command": keeper.command or _own_command(), "cell": keeper.cell}
    with contextlib.suppress(OSError):
        os.ftruncate(handle, 0)
        os.pwrite(handle, json.dumps(holder).encode(), 0)


def _unlock(files: Iterable[tuple[int, Path]]) -> None:
    for handle, path in files:
        with contextlib.suppress(OSError):  # in a shared folder only its owner may remove it
            path.unlink()
        os.close(handle)


def _own_command() -> str:
    """Return program and verb, without options, which may hold secrets."""
    program = Path(sys.argv[0] if sys.argv else "")
    name = program.parent.name if program.suffix == ".py" else program.name
    words = [name or "python"]
    for word in sys.argv[1:]:
        if word.startswith("-"):
            break
        words.append(word)
    return " ".join(words)


def _told(busy: OSError) -> str:
    """``pid 4711 (polishd run cell.toml), cell 'demo'``, of a file that anybody may have written."""
    try:
        holder = json.loads(busy.strerror or "")
        pid, command, cell = (str(holder.get(key, "")) for key in ("pid", "command", "cell"))
    except (ValueError, AttributeError):
        return "its process did not say who it is (lslocks names it)"
    shown = "".join(char if char.isprintable() else "?" for char in command)[:LONGEST_NAME]
    of_cell = f", cell {cell[:LONGEST_NAME]!r}" if cell else ""
    return f"pid {pid[:10]} ({shown}){of_cell}" if pid.isdigit() else f"{shown}{of_cell}"


def _normalized(host: str) -> str:
    """An IP address; all addresses of this computer itself are one, but for those of 127/8 that are not 127.0.0.1."""
    try:
        found = ip_address(host.partition("%")[0])
    except ValueError:
        return host.lower().rstrip(".")
    if isinstance(found, IPv6Address) and found.ipv4_mapped is not None:
        found = found.ipv4_mapped
    if found.is_loopback:
        return LOOPBACK if str(found) in ("127.0.0.1", "::1") else str(found)
    return LOOPBACK if found.is_unspecified or _is_own(str(found), v6=found.version == 6) else str(found)


def _is_own(address: str, *, v6: bool) -> bool:
    """One of this computer's own: only such a one can be bound."""
    try:
        with socket.socket(socket.AF_INET6 if v6 else socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((address, 0))
    except OSError:
        return False
    return True


def _forget() -> None:
    """A forked child has no claims: they would outlive the parent that took them."""
    for lock in _locks.values():
        for handle, _ in lock.files:
            with contextlib.suppress(OSError):
                os.close(handle)
    _locks.clear()


os.register_at_fork(after_in_child=_forget)
