"""The campaign page's figures of the model with their titles, captions and descriptions."""

from __future__ import annotations

from pathlib import Path

from tuner.recommendation.recommendation import Recommendation
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.campaign.model_figures import calibration_figure, map_figure
from tuner.report.labels import parameter_label
from tuner.report.style import Illustration, embed


def model_illustrations(facts: CampaignFacts, best: Recommendation, figures: Path) -> list[Illustration]:
    """A map of two parameters, and leave-one-out predictions."""
    out = []
    surface = map_figure(facts)
    if surface is not None:
        found = facts.surface
        assert found is not None
        names = f"{parameter_label(found.x.path).name} and {parameter_label(found.y.path).name}"
        others = facts.settings.space.dimension > 2
        out.append(
            embed(
                surface,
                "map",
                f"Two maps over {names}: what the model believes and how unsure it is, with missions, default and recommendation.",
                f"What the model believes of {facts.label.full} (left) and its standard deviation (right) over {names}"
                + (
                    ", the other parameters as recommended; missions are projected onto the plane."
                    if others
                    else "."
                ),
                figures,
                form="png",
                title="Map of two parameters",
            )
        )
    if best.observations >= 2:
        check = best.leave_one_out
        out.append(
            embed(
                calibration_figure(facts),
                "calibration",
                "Scatter plot of leave-one-out predictions against measured outcomes with 95 % bars and the diagonal.",
                f"Every successful mission predicted from all the others, hyperparameters kept. "
                f"{100 * check['coverage_95']:.0f} % of {best.observations:.0f} missions lie inside their 95 % interval "
                f"(nominal: 95 %); the residuals’ standard deviation is {check['z_sd']:.2f} predicted ones (ideal: 1).",
                figures,
                form="png",
                title="Calibration",
            )
        )
    return out


def trend_text(facts: CampaignFacts) -> str:
    """A clause on the surrogate's linear trend; empty without one."""
    return ", beside a linear trend" if facts.model is not None and facts.model.settings.trend else ""
