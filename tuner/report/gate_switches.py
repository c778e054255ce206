"""How often the gate switched in a campaign, what had no effect, and what would make it switch."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from nbv.errors import UserError
from nbv.mission.result import IterationRecord, MissionResult
from tuner.campaign.campaign import Campaign
from tuner.missions.job import Trial
from tuner.problem.search_space import builtin
from tuner.report.labels import parameter_label


def traces_of(campaign: Campaign, trials: Sequence[Trial]) -> list[tuple[Trial, list[IterationRecord]]]:
    """Return the trials with what their planners chose, those without a planned view left out."""
    found = []
    for t in trials:
        with contextlib.suppress(UserError, OSError):
            trace = MissionResult.load(t.path).trace
            found += [(t, trace)] if trace else []
    return found


def switch_sentences(campaign: Campaign, trials: Sequence[Trial]) -> list[str]:
    """Return in how many trials the gate switched, which tuned parameters had no effect, and what would make it switch."""
    planned = [t for t in trials if t.switched is not None]
    if not planned:
        return []
    switched = sum(bool(t.switched) for t in planned)
    said = [f"The gate switched between scorers in {switched} of {len(planned)} missions."]
    reset = [t.why["without_effect"] for t in trials if t.why.get("phase") == "simplified"]
    if reset:
        named = ", ".join(parameter_label(path).name for path in reset[-1])
        said.append(f"Without effect on any photograph, so left at the default: {named}.")
    default = campaign.settings.default_values()
    traces = traces_of(campaign, [t for t in trials if t.values == default and t.switched is False])
    spread = [r.d95_m for _, trace in traces for r in trace if r.d95_m is not None]
    gate = builtin(campaign.settings.config(default)).gate
    if spread and not min(spread) < gate.d95_m < max(spread):
        said.append(
            f"At the default it does not switch where d95 is {min(spread):.2f} to {max(spread):.2f} m, since the threshold is "
            f"{gate.d95_m:.2f} m; a gate.d95_m within that range would make it switch."
        )
    return said
