"""What an evaluation says of a campaign with a limit."""

from dataclasses import replace

import pytest
from made_evaluations import made_run

from tuner.evaluation.flying import EvaluationRun
from tuner.problem.objective import Objective
from tuner.report.comparison.page import comparison_context, leading_verdict
from tuner.report.comparison.verdicts import LimitAsked

IMAGES = Objective("costs.images", "minimise")
F = Objective("observable.f_score_48mm")


def run(tuned: float = 97.0) -> EvaluationRun:
    made = made_run({"tuned": tuned, "hyb-h": 97.0}, noise=0.1)
    records = [
        replace(r, outcome=replace(r.outcome, costs={**r.outcome.costs, "images": 26.0}))
        if r.strategy == "tuned"
        else r
        for r in made.records
    ]
    return replace(made, records=records)


def test_photographs_are_exact_and_the_quality_has_the_interval() -> None:
    said = leading_verdict(run(), "hyb-h", IMAGES.metric, None, LimitAsked(IMAGES, F, 102.0)).splitlines()
    assert said[0] == "Photographs: 26 in place of 32 of Hyb-H, 6 saved."
    assert said[1].startswith("Quality kept within 1.0 points") and "95 % interval" in said[1]
    assert "kept on 3 of 4 rocks (75 %, 95 % interval 30 to 95 %)" in said[2]


@pytest.mark.parametrize(("tuned", "begins"), [(90.0, "Quality lost by more than"), (99.0, "Quality gained")])
def test_the_margin_decides_what_is_said_of_quality(tuned: float, begins: str) -> None:
    asked = LimitAsked(IMAGES, F, 98.0)
    assert leading_verdict(run(tuned), "hyb-h", IMAGES.metric, None, asked).splitlines()[1].startswith(begins)


def test_the_page_shows_photographs_and_limit_as_rows() -> None:
    facts = comparison_context(run(), metric=IMAGES.metric, asked=LimitAsked(IMAGES, F, 102.0))
    names = [row["name"] for row in facts["tables"][0]["rows"] if not row["group"]]
    cells = [c["text"] for row in facts["tables"][0]["rows"][1:2] for c in row["cells"]]
    assert cells == ["26.0", "32.0"]
    assert names[:2] == ["Photographs ↓", "Limit kept ↑ (% of rocks)"]
    assert facts["sentences"][0]["text"].startswith("Photographs: 26 in place of 32")
