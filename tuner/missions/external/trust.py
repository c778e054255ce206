"""Whose program a run directory may run: one that the command line names, or that of a campaign begun here.

A run directory may come from anybody, and names a mission file. What the user began, or named on the command line, is
noted outside it, under ``GATETUNE_HOME``, by the campaign's identity.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

from nbv.cache import home
from nbv.errors import UserError
from nbv.mission.run_directory import write_atomic
from nbv.safe_files import read_json
from tuner.missions.external.mission_file import MissionFile


def trust(identity: str, mission: MissionFile) -> None:
    """Note that the user wants the campaign to run this mission's program as it is now."""
    path = _note(identity)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, json.dumps([str(mission.path), mission.sha256, mission.program]))
    except OSError as error:
        raise UserError(
            f"cannot write {path}: {error.strerror}; set GATETUNE_HOME to a writable folder"
        ) from error


def require_trusted(identity: str, mission: MissionFile, *, program: bool) -> None:
    """Raise `UserError` where the campaign was not begun here with this mission file, and this ``program`` if asked."""
    try:
        known = read_json(_note(identity))
    except UserError:
        known = None
    why = ""
    if not isinstance(known, list) or known[:2] != [str(mission.path), mission.sha256]:
        why = f"the campaign was not begun here and asks to run the program of {mission.path}"
    elif program and known[2:] != [mission.program]:
        why = f"the program of {mission.path} changed since the campaign flew it"
    if why:
        raise UserError(f"{why}; if you trust it, name it: --mission {mission.path}")


def _note(identity: str) -> Path:
    if not re.fullmatch(r"[0-9a-f]{1,64}", identity):
        raise UserError(f"{identity!r} is no campaign's identity; restore campaign.yaml")
    return home() / "trusted" / f"{identity}.json"
