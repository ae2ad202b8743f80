"""Users who may watch and give orders: names, roles, and hashes of tokens. A token is shown once, when it is made."""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from urllib.parse import urlsplit

from starlette.requests import Request

from polishd.config.cell import CellConfig
from polishd.model.errors import ConfigError
from polishd.util.files import make_folder, require_private, write_atomic
from polishd.web.http.server import LoginLockout

FILE_NAME = "web-users.json"
MOST_CHARACTERS = 200
"""Longest token that is checked."""
NAME = r"[\w.-]{1,64}"


class Role(StrEnum):
    """Roles in rising order; each has the rights of those before it."""

    WATCH = "watch"
    OPERATE = "operate"
    ENGINEER = "engineer"

    def may(self, needed: Role) -> bool:
        """Whether the role has these rights."""
        return list(Role).index(self) >= list(Role).index(needed)


@dataclass(frozen=True, slots=True)
class User:
    """A user with a token."""

    name: str
    role: Role
    token_sha256: str = field(default="", repr=False, compare=False)


def users_path(config: CellConfig) -> Path:
    """Path of the users' file."""
    return config.state_dir / FILE_NAME if config.web.users is None else config.resolve(config.web.users)


class UserFile:
    """Users of one file, which is looked at at each request, so that a removed user has no access at once."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._cache: tuple[tuple[int, ...], Mapping[str, Mapping[str, str]]] | None = None
        """Signature and users of the file as it was last read: each message of an event stream asks for them."""

    def __bool__(self) -> bool:
        """Whether there are users."""
        return bool(self._read())

    def __iter__(self) -> Iterator[str]:
        """Names of the users."""
        return iter(sorted(self._read()))

    def of_token(self, token: str) -> User | None:
        """User of a token; all hashes are compared, in constant time each."""
        digest, found = _digest(token[:MOST_CHARACTERS]), None
        for name, facts in self._read().items():
            if hmac.compare_digest(digest, facts["token_sha256"]):
                found = User(name, Role(facts["role"]), digest)
        return found

    def is_valid(self, user: User) -> bool:
        """Return whether this user still has this role and this token: a new token ends sessions of the older one."""
        facts = self._read().get(user.name)
        return facts is not None and (facts["role"], facts["token_sha256"]) == (user.role, user.token_sha256)

    def add(self, name: str, role: Role) -> str:
        """Make a new token for a name, in place of an older one. ConfigError for an invalid name."""
        if not re.fullmatch(NAME, name, re.ASCII):
            raise ConfigError(f"{name!r} is no name of a user. Use up to 64 letters, digits, '.', '_' and '-'")
        token = f"{name}.{secrets.token_urlsafe(32)}"
        self._write({**self._read(), name: {"role": role.value, "token_sha256": _digest(token)}})
        return token

    def remove(self, name: str) -> None:
        """Remove a user. ConfigError where there is none."""
        users = dict(self._read())
        if users.pop(name, None) is None:
            todo = f"Name one of {', '.join(users)}" if users else "There is nothing to remove: check the file"
            raise ConfigError(f"{self.path}: there is no user {name!r}. {todo}")
        self._write(users)

    def _read(self) -> Mapping[str, Mapping[str, str]]:
        try:
            stat = self.path.stat()
            signature = (stat.st_ino, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_size, stat.st_mode, stat.st_uid)
            if self._cache is None or self._cache[0] != signature:
                require_private(self.path)
                found = json.loads(self.path.read_text(encoding="utf-8"))
                users = {
                    str(name): {"role": Role(one["role"]).value, "token_sha256": str(one["token_sha256"])}
                    for name, one in found.items()
                }
                self._cache = signature, users
            return self._cache[1]
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise ConfigError(
                f"{self.path}: cannot be read ({type(error).__name__}); mend it, or move it away"
            ) from None

    def _write(self, users: Mapping[str, Mapping[str, str]]) -> None:
        make_folder(self.path.parent)
        write_atomic(self.path, json.dumps(users, indent=1).encode() + b"\n", mode=0o600)


def named_by(token: str) -> str:
    """Return the user whom a token names; of one that names none, a short hash in the place of a name."""
    name, _, _ = token.rpartition(".")
    return name if re.fullmatch(NAME, name, re.ASCII) else f"#{_digest(token[:MOST_CHARACTERS])[:16]}"


def _digest(token: str) -> str:
    """Hash of a token. 256 random bits cannot be guessed, so a fast hash is safe. Invalid Unicode has a hash, too."""
    return hashlib.sha256(token.encode(errors="surrogatepass")).hexdigest()


# Identification by the cookie of a signed-in browser, or by the token of a program.

COOKIE = "polishd"
MOST_SESSIONS = 1000


@dataclass(frozen=True, slots=True)
class HttpSession:
    """A signed-in browser, or a program that sends its token with each request."""

    user: User
    csrf: str = ""
    """Token that a page must send with each change; empty for a program, which another site cannot use."""
    cookie: str = field(default="", repr=False)
    """Value of the browser's cookie; empty for a program."""


class SessionStore:
    """Sessions of this process; its end ends all."""

    def __init__(self, users: UserFile) -> None:
        self._users, self.lockout = users, LoginLockout()
        self._of_cookie: dict[str, HttpSession] = {}

    def of(self, request: Request, *, exempt: bool = False) -> HttpSession | None:
        """Session of a request; ``exempt``: check a token also from an address with too many wrong ones."""
        bearer = request.headers.get("authorization", "")
        if bearer[:7].lower() == "bearer ":
            user = self.user_of(bearer[7:].strip(), address_of(request), exempt=exempt)
            return None if user is None else HttpSession(user)
        session = self._of_cookie.get(request.cookies.get(COOKIE, ""))
        return session if session is not None and self.is_open(session) else None

    def is_open(self, session: HttpSession) -> bool:
        """Return whether a session is still valid: it was not signed out, and its user has the same role and token."""
        return (not session.cookie or session.cookie in self._of_cookie) and self._users.is_valid(session.user)

    def user_of(self, token: str, address: str, *, exempt: bool = False) -> User | None:
        """Return whose token it is; a wrong one counts against the user that it names, at the address it came from."""
        user = self._users.of_token(token)
        if user is None:
            self.lockout.wrong(address, named_by(token))
            return None
        if self._locked(user, token, address) and not exempt:
            return None
        self.lockout.right(address, user.name)
        return user

    def locked(self, token: str, address: str) -> bool:
        """Return whether that token is not taken at that address now, right or wrong."""
        return self._locked(self._users.of_token(token), token, address)

    def bucket(self, token: str, address: str) -> str:
        """Return to whose rate a request with that token counts: its user's, or its address's."""
        user = self._users.of_token(token)
        return f"address {address}" if user is None else f"user {user.name}"

    def _locked(self, user: User | None, token: str, address: str) -> bool:
        if user is None:
            return self.lockout.locked(address, named_by(token))
        return not self.lockout.knows(address, user.name) and self.lockout.locked(address, user.name)

    def begin(self, user: User) -> HttpSession:
        """Begin a session of a browser, and return it."""
        session = HttpSession(user, csrf=secrets.token_urlsafe(32), cookie=secrets.token_urlsafe(32))
        self._of_cookie[session.cookie] = session
        while len(self._of_cookie) > MOST_SESSIONS:
            del self._of_cookie[next(iter(self._of_cookie))]
        return session

    def end(self, request: Request) -> None:
        """End the session of this browser."""
        self._of_cookie.pop(request.cookies.get(COOKIE, ""), None)


def address_of(request: Request) -> str:
    """Address of the request; headers are not trusted for it."""
    return "" if request.client is None else request.client.host


def forged(request: Request, session: HttpSession) -> str:
    """Reason why a changing request is not from this page; empty where it is, or for a program."""
    if foreign_origin(request):
        return "it comes from another site's page"
    if session.csrf and not hmac.compare_digest(
        request.headers.get("x-csrf-token", "").encode(), session.csrf.encode()
    ):
        return "x-csrf-token is missing or wrong; get it from GET /api/session"
    return ""


def foreign_origin(request: Request) -> bool:
    """Whether a page of another site sends the request."""
    origin = request.headers.get("origin")
    if origin is None:
        return request.headers.get("sec-fetch-site", "same-origin") not in {"same-origin", "none"}
    return urlsplit(origin).netloc.lower() != request.headers.get("host", "").lower()
