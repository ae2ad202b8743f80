"""E-mail, handed to an SMTP server."""

from __future__ import annotations

import smtplib
from contextlib import suppress
from datetime import datetime
from email.message import EmailMessage
from email.utils import format_datetime
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from polishd.api import LinkError, Notification, SecretPlace, Severity, hide, read_secret
from polishd.config.values import ConfigSection
from polishd.plugins.notifications.tls import LOOPBACK, STEP_S, trusting

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
    """How the connection is kept private; the server must have a certificate that is trusted."""
    ca_file: str | None = None
    """Certificates to trust instead of the system's, PEM: for a server of the house."""
    user: str | None = None
    """Who logs in; left out: nobody does."""
    password: SecretPlace | None = None
    """Where the password is kept: `file:NAME` or `env:VARIABLE`, never what it is."""
    sender: Address
    """The address that it comes from."""
    to: Annotated[list[Address], Field(min_length=1)]
    """Whom it goes to."""

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        if (self.user is None) != (self.password is None):
            raise ValueError("password: goes with user, and user with it; write both or none")
        if self.password and self.security == "none" and self.host not in LOOPBACK:
            raise ValueError('security: a password is not sent in the clear; use "starttls" or "tls"')
        return self


class Mail:
    """Sends a notification to all addresses, and after a failure to those that it has not reached."""

    def __init__(self, options: MailOptions, base_dir: Path) -> None:
        self._options, self._base_dir = options, base_dir
        self._port = options.port or PORTS[options.security]
        self._context = trusting(options.ca_file, base_dir)
        self._missed: dict[str, list[str]] = {}
        """Whom a notification did not reach, by its id, where it reached others."""
        if options.password:
            read_secret(options.password, base_dir)

    def __call__(self, notification: Notification) -> None:
        """Hand it to the server; LinkError where that does not take it for everybody."""
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
        """Who was refused, of those whom the server could have taken it for."""
        smtp = self._connected()
        try:
            refused = smtp.send_message(mail, self._options.sender, to)
            with suppress(OSError, smtplib.SMTPException):  # it is taken; how they part does not matter
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
        except smtplib.SMTPResponseException as error:  # some servers repeat what they were told
            said = hide(_answer(error.smtp_code, error.smtp_error), password)
            raise LinkError(f"{self._options.host}:{self._port}: login as {user!r} refused: {said}") from None

    def _mail(self, notification: Notification) -> EmailMessage:
        mail = EmailMessage()
        mail["From"] = self._options.sender
        mail["To"] = ", ".join(self._options.to)
        mail["Subject"] = notification.title
        mail["Date"] = format_datetime(datetime.fromisoformat(notification.at))
        mail["Message-ID"] = f"<{notification.id}@polishd>"
        mail["Auto-Submitted"] = "auto-generated"  # nobody's absence is answered
        if notification.severity is Severity.ALARM:
            mail["Importance"] = "high"
            mail["X-Priority"] = "1"
        mail.set_content(notification.text)
        return mail


def _answer(code: int, text: bytes | str) -> str:
    said = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    return " ".join(f"{code} {said}".split())
