"""Who may watch and order: names, roles, and hashes of tokens. A token is told once, when it is made."""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from polishd.config.cell import CellConfig
from polishd.files import make_folder, write_atomic
from polishd.model.errors import ConfigError
from polishd.secret import require_private

FILE_NAME = "web-users.json"
MOST_CHARACTERS = 200
"""Of a token that is looked at."""
NAME = r"[\w.-]{1,64}"


class Role(StrEnum):
    """Each may what those before it may."""

    WATCH = "watch"
    OPERATE = "operate"
    ENGINEER = "engineer"

    def may(self, needed: Role) -> bool:
        """Whether that suffices."""
        return list(Role).index(self) >= list(Role).index(needed)


@dataclass(frozen=True, slots=True)
class User:
    """Somebody who has a token."""

    name: str
    role: Role


def users_path(config: CellConfig) -> Path:
    """Where they are kept."""
    return config.state_dir / FILE_NAME if config.web.users is None else config.resolve(config.web.users)


class UserFile:
    """Those of one file. It is read anew at each question: who was removed is out at once."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self._read())

    def __iter__(self) -> Iterator[str]:
        """Their names."""
        return iter(sorted(self._read()))

    def of_token(self, token: str) -> User | None:
        """Whose token it is; all hashes are compared, in constant time each."""
        digest, found = _digest(token[:MOST_CHARACTERS]), None
        for name, facts in self._read().items():
            if hmac.compare_digest(digest, facts["token_sha256"]):
                found = User(name, Role(facts["role"]))
        return found

    def still(self, user: User) -> bool:
        """Whether that user is there with that role."""
        facts = self._read().get(user.name)
        return facts is not None and facts["role"] == user.role

    def add(self, name: str, role: Role) -> str:
        """A new token for that name, in the place of an older one. ConfigError where the name is none."""
        if not re.fullmatch(NAME, name, re.ASCII):
            raise ConfigError(f"{name!r} is no name of a user: up to 64 letters, digits, '.', '_' and '-'")
        token = f"{name}.{secrets.token_urlsafe(32)}"
        self._write({**self._read(), name: {"role": role.value, "token_sha256": _digest(token)}})
        return token

    def remove(self, name: str) -> None:
        """ConfigError where there is none."""
        known = dict(self._read())
        if known.pop(name, None) is None:
            raise ConfigError(f"{self.path}: there is no user {name!r}")
        self._write(known)

    def _read(self) -> Mapping[str, Mapping[str, str]]:
        try:
            require_private(self.path)
            found = json.loads(self.path.read_text(encoding="utf-8"))
            return {str(name): {"role": Role(one["role"]).value, **one} for name, one in found.items()}
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
    """Of 256 random bits no slow hash is needed: nobody guesses them. Text that is no Unicode has a hash, too."""
    return hashlib.sha256(token.encode(errors="surrogatepass")).hexdigest()
