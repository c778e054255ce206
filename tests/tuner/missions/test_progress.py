"""What a mission in flight is doing, as who waits for it reads it."""

from __future__ import annotations

from pathlib import Path

from tuner.missions.progress import Progress, progress_of


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
