"""``gatetune evaluate`` of a campaign whose objective is a cost."""

from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from nbv.config import preset
from tuner.commands.comparison import ComparisonProgress
from tuner.evaluation.flying import EvaluationEvent
from tuner.missions.job import MissionJob


def test_a_mission_tells_its_cost(tmp_path: Path) -> None:
    console = Console(record=True, width=120)
    with Progress(console=console) as bar:
        show = ComparisonProgress(bar, "costs.images")
        job = MissionJob("tuned/a", preset("campaign"), "slab", 0, tmp_path / "a")
        trial = job.trial(status="ok", measured_then={"costs": {"images": 26.0}})
        show(EvaluationEvent("finished", 1.0, 1, 1, job, trial))
    assert "26.00" in console.export_text()
