"""Passwords of ledgers stay out of settings, pages and messages."""

from __future__ import annotations

import urllib.parse

from nbv.errors import UserError

PASSWORD_VARIABLE = "GATETUNE_STORAGE_PASSWORD"


def require_no_password(storage: str | None) -> None:
    """`UserError`, which does not show it, where a storage's URL holds a password: settings are kept and shown."""
    if storage is None or "://" not in storage:
        return
    try:
        parts = urllib.parse.urlsplit(storage)
        found = parts.password or any("pass" in k.lower() for k, _ in urllib.parse.parse_qsl(parts.query))
    except ValueError:
        found = "@" in storage
    if found:
        raise UserError(
            f"the storage's URL holds a password, and settings are kept and shown: leave it out and set {PASSWORD_VARIABLE} "
            "in the environment, also for a resume"
        )
