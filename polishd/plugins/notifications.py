"""The notifier types ``email``, ``webhook`` and ``command`` (docs/how-to/notifications.md)."""

from __future__ import annotations

import json
import os
import shutil
import signal
import smtplib
import ssl
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from email.message import EmailMessage
from email.utils import format_datetime
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import SplitResult, urlsplit

from pydantic import AfterValidator, Field, model_validator

from polishd.api import (
    ConfigError,
    LinkError,
    Notification,
    NotifierType,
    SecretPlace,
    Severity,
    hookimpl,
    read_secret,
    redact_secrets,
)
from polishd.config.fields import ConfigSection
from polishd.util.files import named_path

# A shop's command: it reads a notification as JSON from standard input.

OUTPUT_BYTES = 500
"""Length of the quoted end of its standard error."""


class CommandOptions(ConfigSection):
    """Keys of ``[notify.NAME]`` with ``type = "command"``."""

    argv: Annotated[list[str], Field(min_length=1)]
    """The program and its arguments, without a shell. It starts in the folder of the cell's file, to which a program
    with a slash in its name is relative."""
    timeout_s: Annotated[float, Field(gt=0, le=50)] = 30.0
    """Longest run time; then the command and its child processes are killed."""


class Command:
    """Run the command; any exit code but 0 is a failure."""

    def __init__(self, options: CommandOptions, base_dir: Path) -> None:
        program = options.argv[0]
        path = str(named_path(base_dir, program)) if "/" in program else program
        found = shutil.which(path)
        if found is None:
            raise ConfigError(f"{program!r}: no such executable program; correct argv")
        self._argv = [found, *options.argv[1:]]
        self._within_s, self._base_dir = options.timeout_s, base_dir

    def __call__(self, notification: Notification) -> None:
        """Run the command to its end; LinkError where it fails or is killed.

        Files, not pipes: a command that does not read, or leaves a child running, cannot block the notifier.
        """
        with tempfile.TemporaryFile() as stdin, tempfile.TemporaryFile() as stderr:
            stdin.write(json.dumps(notification.facts()).encode() + b"\n")
            stdin.seek(0)
            process = subprocess.Popen(
                self._argv, stdin=stdin, stdout=subprocess.DEVNULL, stderr=stderr, cwd=self._base_dir, process_group=0
            )
            try:
                code = process.wait(self._within_s)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                raise LinkError(f"{self._argv[0]}: was killed after {self._within_s:g} s") from None
            if code:
                stderr.seek(max(stderr.seek(0, os.SEEK_END) - OUTPUT_BYTES, 0))
                output = " ".join(stderr.read().decode("utf-8", "replace").split())
                raise LinkError(f"{self._argv[0]}: ended with {code}: {output}".rstrip(": "))


# Shared by mail and webhooks: timeout of a step, trusted authorities, and hosts that may get a secret unencrypted.

STEP_S = 15.0
"""Timeout of a connection or of one command, s."""
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
"""Hosts to which a secret may go unencrypted: this computer."""


def _trust_context(ca_file: str | None, base_dir: Path) -> ssl.SSLContext:
    """TLS context that trusts the system's authorities, or those of that file. ConfigError, which quotes the file."""
    try:
        return ssl.create_default_context(cafile=None if ca_file is None else named_path(base_dir, ca_file))
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"{ca_file!r}: cannot be read: {error}; name a file of certificates (PEM)") from error


# E-mail, handed to an SMTP server.

PORTS = {"starttls": 587, "tls": 465, "none": 25}


def _address(text: str) -> str:
    name, at, host = text.rpartition("@")
    if not (name and at and host) or not text.isprintable() or set(" ,;<>") & set(text):
        raise ValueError(f"{text!r} is no address; write it as ada@example.org")
    return text


Address = Annotated[str, AfterValidator(_address)]


class MailOptions(ConfigSection):
    """Keys of ``[notify.NAME]`` with ``type = "email"``."""

    host: Annotated[str, Field(min_length=1)]
    """The SMTP server that takes the mail."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """Its port; left out: 587 for `starttls`, 465 for `tls`, 25 for `none`. [1]"""
    security: Literal["starttls", "tls", "none"] = "starttls"
    """Encryption of the connection; the server needs a trusted certificate."""
    ca_file: str | None = None
    """Certificates to trust instead of the system's, PEM: for a company's own server."""
    user: str | None = None
    """User name; left out: no login."""
    password: SecretPlace | None = None
    """Location of the password: `file:NAME` or `env:VARIABLE`, never the password."""
    sender: Address
    """The sender's address."""
    to: Annotated[list[Address], Field(min_length=1)]
    """The recipients' addresses."""

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        if (self.user is None) != (self.password is None):
            raise ValueError("password: goes with user, and user with it; write both or none")
        if self.password and self.security == "none" and self.host not in LOOPBACK:
            raise ValueError('security: a password is not sent in the clear; use "starttls" or "tls"')
        return self


class Mail:
    """Send a notification to all addresses, and after a failure to the remaining ones."""

    def __init__(self, options: MailOptions, base_dir: Path) -> None:
        self._options, self._base_dir = options, base_dir
        self._port = options.port or PORTS[options.security]
        self._context = _trust_context(options.ca_file, base_dir)
        self._missed: dict[str, list[str]] = {}
        """Addresses that a notification did not reach, by its id, where it reached others."""
        if options.password:
            read_secret(options.password, base_dir)

    def __call__(self, notification: Notification) -> None:
        """Send it to the server; LinkError where the server refuses a recipient."""
        to = self._missed.get(notification.id, self._options.to)
        where = f"{self._options.host}:{self._port}"
        try:
            refused = self._handed(self._mail(notification), to)
        except smtplib.SMTPRecipientsRefused as error:
            refused = error.recipients
        except smtplib.SMTPResponseException as error:
            raise LinkError(f"{where}: answered {_answer(error.smtp_code, error.smtp_error)}") from None
        except (OSError, smtplib.SMTPException, ValueError) as error:
            raise LinkError(f"{where}: {error}") from None
        if refused:
            self._missed[notification.id] = list(refused)
            who = "; ".join(f"{address}: {_answer(*why)}" for address, why in refused.items())
            raise LinkError(f"{where}: refused {who}")
        self._missed.pop(notification.id, None)

    def _handed(self, mail: EmailMessage, to: list[str]) -> dict[str, tuple[int, bytes]]:
        """Send the mail and return the refused recipients."""
        smtp = self._connected()
        try:
            refused = smtp.send_message(mail, self._options.sender, to)
            with suppress(OSError, smtplib.SMTPException):  # the server has accepted the mail
                smtp.quit()
            return refused
        finally:
            smtp.close()

    def _connected(self) -> smtplib.SMTP:
        options = self._options
        if options.security == "tls":
            smtp: smtplib.SMTP = smtplib.SMTP_SSL(options.host, self._port, timeout=STEP_S, context=self._context)
        else:
            smtp = smtplib.SMTP(options.host, self._port, timeout=STEP_S)
        try:
            if options.security == "starttls":
                smtp.starttls(context=self._context)
            if options.user and options.password:
                self._log_in(smtp, options.user, read_secret(options.password, self._base_dir))
        except BaseException:
            smtp.close()
            raise
        return smtp

    def _log_in(self, smtp: smtplib.SMTP, user: str, password: str) -> None:
        try:
            smtp.login(user, password)
        except UnicodeEncodeError:
            raise LinkError("smtplib logs in with ASCII only; choose another password") from None
        except smtplib.SMTPResponseException as error:  # some servers repeat the password
            said = redact_secrets(_answer(error.smtp_code, error.smtp_error), password)
            raise LinkError(f"{self._options.host}:{self._port}: login as {user!r} refused: {said}") from None

    def _mail(self, notification: Notification) -> EmailMessage:
        mail = EmailMessage()
        mail["From"] = self._options.sender
        mail["To"] = ", ".join(self._options.to)
        mail["Subject"] = notification.title
        mail["Date"] = format_datetime(datetime.fromisoformat(notification.at))
        mail["Message-ID"] = f"<{notification.id}@polishd>"
        mail["Auto-Submitted"] = "auto-generated"  # no absence notes
        if notification.severity is Severity.ALARM:
            mail["Importance"] = "high"
            mail["X-Priority"] = "1"
        mail.set_content(notification.text)
        return mail


def _answer(code: int, text: bytes | str) -> str:
    said = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    return " ".join(f"{code} {said}".split())


# A webhook: HTTP POST to a program or a chat.

NTFY_PRIORITY: Mapping[Severity, str] = {Severity.INFO: "2", Severity.WARNING: "4", Severity.ALARM: "5"}
REPLY_BYTES = 200
"""Length of the quoted part of a refusal."""


def _url_or_place(text: str) -> str:
    """Check a URL; messages do not repeat it, since it may be secret."""
    if not text.startswith(("file:", "env:")):
        _parsed(text)
    return text


def _parsed(url: str) -> SplitResult:
    wrong = 'is no URL; write it as "https://host/path", or its location: "file:NAME", "env:VARIABLE"'
    try:
        parts = urlsplit(url)
        whole = parts.scheme in {"http", "https"} and parts.hostname and parts.port != 0
    except ValueError:
        raise ValueError(wrong) from None
    if not whole or not url.isascii() or not url.isprintable() or " " in url:
        raise ValueError(wrong)
    if parts.username or parts.password:
        raise ValueError('a config must not contain a password; use token = "file:NAME"')
    return parts


class WebhookOptions(ConfigSection):
    """Keys of ``[notify.NAME]`` with ``type = "webhook"``."""

    url: Annotated[str, AfterValidator(_url_or_place)]
    """URL to post to, or its location, `file:NAME` or `env:VARIABLE`: the address of a chat's hook is a secret."""
    format: Literal["json", "slack", "ntfy"] = "json"
    """Content: all fields of a notification; `{"text": ...}` for Slack, Mattermost and Rocket.Chat; or plain text,
    title and priority for ntfy."""
    token: SecretPlace | None = None
    """Location of the token for `Authorization: Bearer`: `file:NAME` or `env:VARIABLE`."""
    ca_file: str | None = None
    """Certificates to trust instead of the system's, PEM: for a company's own server."""


class Webhook:
    """Post a notification; any answer but 200 to 299 is a failure. No proxy, no redirection."""

    def __init__(self, options: WebhookOptions, base_dir: Path) -> None:
        self._options, self._base_dir = options, base_dir
        self._context = _trust_context(options.ca_file, base_dir)
        self._address()
        if options.token:
            read_secret(options.token, base_dir)

    def __call__(self, notification: Notification) -> None:
        """Post it; LinkError, which names the host only, where the server does not accept it."""
        parts = self._address()
        token = read_secret(self._options.token, self._base_dir) if self._options.token else ""
        path = parts._replace(scheme="", netloc="", fragment="").geturl() or "/"
        headers, body = self._content(notification)
        headers |= {"Authorization": f"Bearer {token}"} if token else {}
        try:
            self._post(parts, path, headers, body)
        except (OSError, HTTPException, ValueError) as error:
            secrets = (token, *(part for part in (parts.path, parts.query) if len(part) > 1))
            raise LinkError(redact_secrets(f"{parts.scheme}://{parts.netloc}: {error}", *secrets)) from None

    def _address(self) -> SplitResult:
        """The URL. ConfigError, which quotes the key's value where that is a location."""
        url = self._options.url
        try:
            parts = _parsed(read_secret(url, self._base_dir) if url.startswith(("file:", "env:")) else url)
        except ValueError as error:
            raise ConfigError(f"{url!r}: the value there {error}") from None
        if self._options.token and parts.scheme == "http" and parts.hostname not in LOOPBACK:
            raise ConfigError(f"{self._options.token!r}: a token needs encryption; use an https:// address")
        return parts

    def _content(self, notification: Notification) -> tuple[dict[str, str], bytes]:
        match self._options.format:
            case "ntfy":
                title = notification.title.encode("ascii", "replace").decode()
                headers = {"Title": title, "Priority": NTFY_PRIORITY[notification.severity]}
                return headers, notification.text.encode()
            case "slack":
                facts = {"text": f"*{notification.title}*\n{notification.text}"}
            case _:
                facts = notification.facts()
        return {"Content-Type": "application/json"}, json.dumps(facts).encode()

    def _post(self, parts: SplitResult, path: str, headers: Mapping[str, str], body: bytes) -> None:
        host = str(parts.hostname)
        if parts.scheme == "https":
            connection: HTTPConnection = HTTPSConnection(host, parts.port, timeout=STEP_S, context=self._context)
        else:
            connection = HTTPConnection(host, parts.port, timeout=STEP_S)
        try:
            connection.request("POST", path, body, dict(headers))
            with connection.getresponse() as answer:
                said = " ".join(answer.read(REPLY_BYTES).decode("utf-8", "replace").split())
            if not 200 <= answer.status <= 299:
                raise HTTPException(f"answered {answer.status} {answer.reason}: {said}".rstrip(": "))
        finally:
            connection.close()


POLISHD_API = 1


@hookimpl
def polishd_notifiers() -> Sequence[NotifierType]:
    """``email``, ``webhook`` and ``command``."""
    return [
        NotifierType("email", MailOptions, Mail),
        NotifierType("webhook", WebhookOptions, Webhook),
        NotifierType("command", CommandOptions, Command),
    ]
