"""A slot: the ports, numbers and folders that no other running mission has."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from nbv.cache import digest, home
from nbv.errors import MissionFailure
from tuner.missions.external.mission_file import MissionFile

_POLL_S = 0.05


@dataclass(frozen=True)
class Slot:
    """Number of the slot, and what it owns by name."""

    number: int
    resources: Mapping[str, int | str]

    def environment(self) -> dict[str, str]:
        """The resources as environment variables of the same names."""
        return {name: str(value) for name, value in self.resources.items()}


def slots_of(mission: MissionFile) -> Path:
    """Where this machine's campaigns agree on who has which ports, numbers and folders of a mission."""
    return home() / "slots" / f"{mission.name}-{digest([socket.gethostname(), str(mission.path)])[:12]}"


@contextlib.contextmanager
def take_slot(mission: MissionFile, root: Path, wait_s: float) -> Iterator[Slot]:
    """The first free slot under ``root``, for as long as the context lasts.

    A slot is a locked file: it becomes free when its owner ends, however that comes about.

    Raises
    ------
    MissionFailure
        ``no_slot``: all are taken for longer than ``wait_s``.
    """
    root.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + wait_s
    while True:
        for number in range(mission.at_once):
            # Not inherited by the mission's processes: one that outlives its mission would keep the slot.
            handle = os.open(root / f"slot-{number}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(handle)
                continue
            try:
                yield _slot(mission, root, number)
            finally:
                os.close(handle)
            return
        if time.monotonic() > deadline:
            raise MissionFailure(
                "no_slot",
                f"all {mission.at_once} slots of {mission.name} are taken; raise at_once or lower --workers",
            )
        time.sleep(_POLL_S)


def _slot(mission: MissionFile, root: Path, number: int) -> Slot:
    owned: dict[str, int | str] = {}
    for name, resource in mission.resources.items():
        if resource.kind == "folder":
            folder = (root / f"slot-{number}" / name).resolve()
            folder.mkdir(parents=True, exist_ok=True)
            owned[name] = str(folder)
        else:
            owned[name] = resource.of(number)
    return Slot(number, owned)
