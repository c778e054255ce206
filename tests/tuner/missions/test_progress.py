"""What a mission in flight is doing, as who waits for it reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from nbv.config import preset
from nbv.errors import MissionFailure
from tuner.missions import run_job
from tuner.missions.job import RESULT_FILE, MissionJob
from tuner.missions.progress import PROGRESS_FILE, Progress, log_of, progress_of


def test_the_line_follows_the_mission(tmp_path: Path) -> None:
    progress, said = Progress(tmp_path), []
    for event, facts in (
        ("start", {"seeds": 2, "budget": 3}),
        ("seed", {"index": 0}),
        ("seed", {"index": 1}),
        ("seed-model", {}),
        ("capture", {"iteration": 0}),
        ("dense", {}),
        ("metrics", {}),
    ):
        progress(event, facts)
        said.append(progress_of(tmp_path))
    assert said == ["scene", "photograph 1/2", "seed model", "view 1/3", "view 2/3", "dense cloud", "errors"]
    progress.end()
    assert progress_of(tmp_path) == ""


def test_it_is_gone_when_the_mission_is_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []

    def fidelity(*arguments: Any, log: Progress, **options: Any) -> None:
        log("dense", {})
        seen.append(progress_of(tmp_path))
        raise MissionFailure("lost", "on purpose")

    monkeypatch.setattr(run_job, "mission_function", lambda name: fidelity)
    job = MissionJob("1", preset("campaign"), "slab", 0, tmp_path)
    assert run_job.run_job(job.to_dict()) == run_job.EXIT_FAILED
    assert seen == ["dense cloud"]
    assert not (tmp_path / PROGRESS_FILE).exists() and (tmp_path / RESULT_FILE).is_file()


def test_missions_that_are_not_ours_have_none(tmp_path: Path) -> None:
    assert log_of("external", tmp_path) is None and log_of("geometric", tmp_path) is None
