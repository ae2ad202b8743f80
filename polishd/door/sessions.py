"""Who asks: by the cookie of a browser that has signed in, or by the token of a program."""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass
from urllib.parse import urlsplit

from starlette.requests import Request

from polishd.door.limits import LoginLockout
from polishd.door.users import User, UserFile, named_by

COOKIE = "polishd"
MOST_SESSIONS = 1000


@dataclass(frozen=True, slots=True)
class HttpSession:
    """A browser that has signed in, or a program that brings its token with each request."""

    user: User
    csrf: str = ""
    """What a page must send along with whatever changes something; empty: of a program, which no other site can use."""


class SessionStore:
    """Those of this process: with its end all are out."""

    def __init__(self, users: UserFile) -> None:
        self._users, self.lockout = users, LoginLockout()
        self._of_cookie: dict[str, HttpSession] = {}

    def of(self, request: Request, *, exempt: bool = False) -> HttpSession | None:
        """Whose request it is; ``exempt``: a token is looked at also from where too many wrong ones came."""
        bearer = request.headers.get("authorization", "")
        if bearer[:7].lower() == "bearer ":
            user = self.user_of(bearer[7:].strip(), address_of(request), exempt=exempt)
            return None if user is None else HttpSession(user)
        session = self._of_cookie.get(request.cookies.get(COOKIE, ""))
        if session is None or not self._users.still(session.user):
            return None
        return session

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

    def begin(self, user: User) -> tuple[str, HttpSession]:
        """A new one, and its cookie's value."""
        cookie, session = secrets.token_urlsafe(32), HttpSession(user, secrets.token_urlsafe(32))
        self._of_cookie[cookie] = session
        while len(self._of_cookie) > MOST_SESSIONS:
            del self._of_cookie[next(iter(self._of_cookie))]
        return cookie, session

    def end(self, request: Request) -> None:
        """That of this browser."""
        self._of_cookie.pop(request.cookies.get(COOKIE, ""), None)


def address_of(request: Request) -> str:
    """Where it comes from; no header is believed on that."""
    return "" if request.client is None else request.client.host


def forged(request: Request, session: HttpSession) -> str:
    """Why a request that changes something is not of our own page; empty where it is, or of a program."""
    if foreign_origin(request):
        return "it comes from another site's page"
    if session.csrf and not hmac.compare_digest(
        request.headers.get("x-csrf-token", "").encode(), session.csrf.encode()
    ):
        return "x-csrf-token is missing or wrong; GET /api/session tells it"
    return ""


def foreign_origin(request: Request) -> bool:
    """A page of another site asks."""
    origin = request.headers.get("origin")
    if origin is None:
        return request.headers.get("sec-fetch-site", "same-origin") not in {"same-origin", "none"}
    return urlsplit(origin).netloc.lower() != request.headers.get("host", "").lower()
