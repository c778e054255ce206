"""What the page's own script draws: every mission, and the slices."""

from __future__ import annotations

import json
import os
from typing import Any

from markupsafe import Markup

from tuner.missions.job import Trial
from tuner.problem.observations import short
from tuner.problem.search_space import Parameter, Value
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.campaign.walks import PAGE
from tuner.report.labels import parameter_label

MOST_MISSIONS = 2000  # a browser draws more only slowly


def mission_link(facts: CampaignFacts, trial: Trial) -> str:
    """Address of a mission's own page, or of its documents, relative to the campaign's page; empty where there are none."""
    run = facts.campaign.directory / trial.directory
    for file in (run / PAGE, run / "mission.json"):
        if file.is_file():
            return os.path.relpath(file, facts.campaign.directory).replace(os.sep, "/")
    return ""


def explorer_data(facts: CampaignFacts) -> Markup:
    """JSON for a script element; without a "<" nothing in it can end the element, or hide its end."""
    s, best = facts.settings, facts.recommendation
    adjusted: dict[int, float] = {}
    if facts.model is not None:
        adjusted = {
            o.number: round(float(v), 6)
            for o, v in zip(facts.model.observations, facts.adjusted, strict=True)
        }
    trials = [
        {
            "n": t.number + 1,
            "where": facts.world_name(t.world),
            "rep": t.replicate,
            "raw": facts.outcome(t),
            "adj": adjusted.get(t.number),
            "state": t.status if t.state == "complete" else f"failed: {t.reason}",
            "why": str(t.why.get("phase", "")),
            "best": best is not None and t.values == best.values,
            "default": t.values == facts.default,
            "href": mission_link(facts, t),
            "u": [_position(p, t.values[p.path]) for p in s.space.parameters],
            "v": [short(t.values[p.path]) for p in s.space.parameters],
        }
        for t in facts.trials[-MOST_MISSIONS:]
        if t.state != "running"
    ]
    tree = {
        "axis": facts.label.axis,
        "digits": facts.digits,
        "sign": facts.sign,
        "parameters": [_parameter(p) for p in s.space.parameters],
        "best": [_position(p, best.values[p.path]) for p in s.space.parameters] if best else [],
        "trials": trials,
        "slices": [
            {
                "u": [_position(part.parameter, v) for v in part.positions],
                "v": [short(v) for v in part.positions],
                "mean": [round(float(m), 6) for m in part.mean],
                "sd": [round(float(v), 6) for v in part.sd],
            }
            for part in facts.slices
        ],
    }
    return Markup(json.dumps(tree, allow_nan=False).replace("<", "\\u003c"))


def _parameter(p: Parameter) -> dict[str, Any]:
    label = parameter_label(p.path)
    ends: tuple[Value, ...] = p.choices if p.kind == "categorical" else (p.low, p.high)
    return {
        "name": label.name,
        "short": label.short,
        "unit": label.unit,
        "ticks": [[_position(p, v), short(v)] for v in ends],
        "choices": p.kind == "categorical",
    }


def _position(p: Parameter, value: Value) -> float:
    """From 0 to 1 along the parameter's axis."""
    if p.kind == "categorical":
        return p.choices.index(value) / max(1, len(p.choices) - 1)
    return round(p.to_unit(value), 5)
