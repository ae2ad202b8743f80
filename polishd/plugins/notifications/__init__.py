"""Ways to reach a person: the notifier types ``email``, ``webhook`` and ``command`` (docs/notifications.md)."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import NotifierType, hookimpl
from polishd.plugins.notifications.command import Command, CommandOptions
from polishd.plugins.notifications.mail import Mail, MailOptions
from polishd.plugins.notifications.webhook import Webhook, WebhookOptions

POLISHD_API = 1


@hookimpl
def polishd_notifiers() -> Sequence[NotifierType]:
    """``email``, ``webhook`` and ``command``."""
    return [
        NotifierType("email", MailOptions, Mail),
        NotifierType("webhook", WebhookOptions, Webhook),
        NotifierType("command", CommandOptions, Command),
    ]
