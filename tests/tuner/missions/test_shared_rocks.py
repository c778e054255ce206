"""Rocks are read once per campaign, and never by a mission's server before a mission has read them."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import trimesh

from nbv.config import preset
from nbv.rocks.catalogue import forget_loaded
from tuner.missions.executors import LocalProcessExecutor
from tuner.missions.job import MissionJob, Trial

FIDELITY = "geometric"


def write_ball(path: Path, radius: float = 1.0, squeeze: float = 1.0) -> Path:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    ball.vertices[:, 0] *= squeeze
    ball.export(path)
    return path


@pytest.fixture(autouse=True)
def nothing_in_memory() -> None:
    forget_loaded()


@pytest.mark.slow
def test_later_missions_share_the_rock_that_the_first_read(tmp_path: Path) -> None:
    """The same file name and time with another content shows where a mission has its rock from."""
    ball = write_ball(tmp_path / "ball.ply")
    stamp = ball.stat().st_mtime_ns

    def fly(executor: LocalProcessExecutor, number: int) -> Trial:
        executor.submit(
            MissionJob(
                f"{number:04d}", preset("campaign"), str(ball), 0, tmp_path / str(number), fidelity=FIDELITY
            )
        )
        return next(o for _ in range(120) for o in executor.wait_any(1.0))

    def rock_sha256(number: int) -> str:
        sha256: str = json.loads((tmp_path / str(number) / "mission.json").read_text())["provenance"][
            "rock_sha256"
        ]
        return sha256

    with LocalProcessExecutor(1) as executor:
        first = fly(executor, 0)
        fly(executor, 1)  # the server has the rock before it starts this one
        write_ball(ball, squeeze=0.8)
        os.utime(ball, ns=(stamp, stamp))
        third = fly(executor, 2)
        os.utime(ball, ns=(stamp + 10**9, stamp + 10**9))
        fourth = fly(executor, 3)  # a file that says it has changed is read again
    assert first.status == third.status == fourth.status == "ok"
    assert rock_sha256(2) == rock_sha256(0) != rock_sha256(3)
    assert third.metrics == first.metrics
