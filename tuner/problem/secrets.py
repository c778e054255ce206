"""Passwords of ledgers stay out of settings, pages and messages."""

from __future__ import annotations

import urllib.parse

from nbv.errors import UserError

PASSWORD_VARIABLE = "GATETUNE_STORAGE_PASSWORD"


def require_no_password(storage: str | None) -> None:
    """Raise `UserError`, without showing it, where a storage's URL holds a password: settings are kept and shown."""
    if storage is None or "://" not in storage:
        return
    # As SQLAlchemy reads it, to which / ? and # before the first @ are part of a password.
    place = storage.partition("://")[2]
    user, at, _ = place.partition("@")
    names = [name.lower() for name, _ in urllib.parse.parse_qsl(place.partition("?")[2])]
    in_query = any("pass" in name and name != "passfile" for name in names)
    if in_query or (at and user.partition(":")[2] and not place.startswith("/")):
        raise UserError(
            f"the storage's URL holds a password, and settings are kept and shown: leave it out and set {PASSWORD_VARIABLE} "
            "in the environment, also for a resume"
        )
