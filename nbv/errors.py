"""The two ways in which a run may end badly, kept apart on purpose."""

from __future__ import annotations


class UserError(Exception):
    """A mistake that the user can correct.

    The message is one line that names the thing and the remedy. The command line prints it without a
    traceback and exits with code 2; nothing has been overwritten when it is raised.
    """


class MissionFailure(Exception):
    """A mission that cannot go on (no seed model, a collapsed model, an empty dense cloud, ...).

    The mission loop turns it into a recorded ``failed`` result; a campaign goes on. ``reason`` is a short, stable code in snake_case
    such as ``"seed_model_failed"``, ``message`` one line for a person.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason
        self.message = message
