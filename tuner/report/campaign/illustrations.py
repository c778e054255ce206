"""The campaign page's figures with their titles, captions and descriptions."""

from __future__ import annotations

from pathlib import Path

from tuner.recommendation.recommendation import Recommendation
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.campaign.figures import history_figure, running_recommendation_figure, time_figure
from tuner.report.campaign.model_figures import (
    calibration_figure,
    map_figure,
    relevance_figure,
    slices_figure,
)
from tuner.report.labels import parameter_label
from tuner.report.style import Illustration, embed


def compute_time(facts: CampaignFacts, figures: Path) -> list[Illustration]:
    """Where the missions' time went; nothing where no mission says."""
    spent = time_figure(facts)
    if spent is None:
        return []
    return [
        embed(
            spent,
            "compute_time",
            "Bar chart of compute time by stage of a mission.",
            "Wall-clock time of all missions by stage, as each mission measured it.",
            figures,
            title="Compute time",
        )
    ]


def history(facts: CampaignFacts, figures: Path) -> Illustration:
    """Every mission's outcome, by rock."""
    st = facts.status
    return embed(
        history_figure(facts),
        "missions",
        f"Scatter plot of {facts.label.name} over {st.finished} missions, one colour and marker per rock; "
        f"{st.failed} failed missions are crosses at the bottom.",
        f"{facts.label.full} of every mission by rock. The shaded missions are the initial design (the {facts.default_name} "
        "first); after it the sampler proposes. Rocks differ in difficulty, so heights compare within a rock only. "
        "Circled: missions of the recommended configuration. Crosses at the bottom: failed missions, which have no value.",
        figures,
        title="Outcome of every mission",
    )


def running_recommendation(facts: CampaignFacts, figures: Path) -> Illustration:
    """What would have been recommended on the way, and what is now believed of it."""
    return embed(
        running_recommendation_figure(facts),
        "running_recommendation",
        "Line plot of the recommended configuration's posterior mean at several moments of the campaign, with 95 % bars.",
        "Quality of the recommendation as missions came in: the recommendation was recomputed from the first n missions "
        "alone. Circles: what the model believed then; squares: what the model of all missions says about the same "
        f"configuration. Dashed: the {facts.default_name} under the model of all missions.",
        figures,
        title="Running recommendation",
    )


def model_illustrations(facts: CampaignFacts, best: Recommendation, figures: Path) -> list[Illustration]:
    """The surrogate: slices, a map, which parameters matter, leave-one-out predictions."""
    label = facts.label
    out = [
        embed(
            slices_figure(facts),
            "slices",
            f"One panel per parameter: posterior mean of {label.name} with its 95 % band along the parameter.",
            f"Posterior of {label.full}, mean over the training rocks, along one parameter at a time, the others as "
            "recommended. Dots are missions with their rock’s difference taken out; the fainter, the farther the mission "
            "lies from the slice in the other parameters. A flat line within its band: no influence detected.",
            figures,
            title="Slices through the recommendation",
        )
    ]
    surface = map_figure(facts)
    if surface is not None:
        found = facts.surface()
        assert found is not None
        names = f"{parameter_label(found.x.path).name} and {parameter_label(found.y.path).name}"
        others = facts.settings.space.dimension > 2
        out.append(
            embed(
                surface,
                "map",
                f"Two maps over {names}: posterior mean and posterior standard deviation, with missions, default and recommendation.",
                f"Posterior mean (left) and its standard deviation (right) over {names}"
                + (
                    ", the other parameters as recommended; missions are projected onto the plane."
                    if others
                    else "."
                ),
                figures,
                title="Map of two parameters",
            )
        )
    out.append(
        embed(
            relevance_figure(facts),
            "relevance",
            "Bar chart of each parameter's influence on the posterior mean with its length scale.",
            "How far the posterior mean moves along each slice above, and the length scale ℓ in units of the searched "
            f"range: long means {'no more than the linear trend' if trend_text(facts) else 'unimportant'}.",
            figures,
            title="Which parameters matter",
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
                title="Calibration",
            )
        )
    return out


def trend_text(facts: CampaignFacts) -> str:
    """A clause on the surrogate's linear trend; empty without one."""
    return ", beside a linear trend" if facts.model is not None and facts.model.settings.trend else ""
