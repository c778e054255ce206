"""Why a candidate won: every term of Eq. 1, for one planning state."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from nbv.config import IDEAL, SCORERS, MissionConfig, Weights, preset
from nbv.errors import UserError
from nbv.mission.planning_state import load_state
from nbv.scorers import find_scorer, rank_candidates
from nbv.types import CandidatePool, Ranking
from tuner.report.mission.decisions import mission_config

TERMS = ("main", "nov", "move", "ang")


def locate_state(path: Path, iteration: int, preset_name: str) -> tuple[Path, MissionConfig]:
    """The saved state of ``iteration`` and its configuration.

    Raises
    ------
    UserError
        Neither a state file nor a mission directory with that iteration.
    """
    if path.suffix == ".npz":
        return path, preset(preset_name)
    states = sorted((path / "states").glob("iter_*.npz"))
    if not states and (path / "flight.json").is_file():
        raise UserError(f"{path} planned no view; there is nothing to explain")
    if not states:
        raise UserError(
            f"{path} holds no planning states; name a directory that `gatetune mission run` wrote"
        )
    state = path / "states" / f"iter_{iteration:02d}.npz"
    if state not in states:
        raise UserError(f"{path} has no iteration {iteration}; it has 0 to {len(states) - 1}")
    return state, mission_config(path)


def explain_state(
    path: Path, iteration: int, preset_name: str, overrides: Mapping[str, Any], top: int
) -> tuple[list[Table | str], dict[str, list[dict[str, Any]]]]:
    """The rankings of one state, by the paper's two scorers and by what the gate flies: to be read, and as data.

    Parameters
    ----------
    path
        A mission's directory, or one state's file.
    iteration
        Of a mission's directory: which state.
    preset_name
        Of one state's file: what it is ranked with.
    overrides
        Values by parameter path, laid over the configuration.
    top
        Candidates per scorer.

    Raises
    ------
    UserError
        There is no such state, or no such parameter.
    """
    file, config = locate_state(path, iteration, preset_name)
    config = config.with_values(dict(overrides))
    state, pool = load_state(file)
    rankings = rank_candidates(state, pool, config)
    said: list[Table | str] = [
        f"iteration {state.iteration}: {len(pool)} candidates, {len(state.model.points_m)} sparse points, "
        f"{state.captures_used} of {state.adaptive_budget} captures used, d95 {1000 * state.d95_m:.0f} mm"
        + (f"; condition {config.condition}" if config.condition != IDEAL else "")
    ]
    data = {}
    flown = [name for name in (config.gate.kind, config.gate.geometry_scorer) if name in SCORERS]
    for name in dict.fromkeys([*rankings, *flown]):
        weights = find_scorer(name).weights(config)
        said.append(_ranking_table(name, rankings[name], pool, weights, top))
        said.append(_why(name, rankings[name], pool, weights))
        data[name] = [
            {
                "candidate": pool.ids[index],
                "score": float(rankings[name].scores[index]),
                **{term: float(rankings[name].terms[term][index]) for term in TERMS},
            }
            for index in rankings[name].order[:top]
        ]
    return said, data


def _ranking_table(title: str, ranking: Ranking, pool: CandidatePool, weights: Weights, top: int) -> Table:
    table = Table(
        title=f"{title}: S = {weights.main:g} main + {weights.nov:g} nov - {weights.move:g} move - "
        f"{weights.ang:g} ang"
    )
    # In full on a terminal of 80 columns: names of candidates are what one looks up.
    for column in ("#", "candidate", "elev.", "azim.", *TERMS, "score"):
        table.add_column(column, justify="right", no_wrap=True)
    for rank, index in enumerate(ranking.order[:top]):
        table.add_row(
            str(rank + 1),
            pool.ids[index],
            f"{pool.elevations_deg[index]:.0f}°",
            f"{pool.azimuths_deg[index]:.0f}°",
            *(f"{ranking.terms[term][index]:.4f}" for term in TERMS),
            f"{ranking.scores[index]:.4f}",
        )
    return table


def _why(name: str, ranking: Ranking, pool: CandidatePool, weights: Weights) -> str:
    if len(ranking.order) < 2:
        return f"{name}: the only candidate."
    first, second = ranking.order[:2]
    signs = {"main": weights.main, "nov": weights.nov, "move": -weights.move, "ang": -weights.ang}
    lead = {
        term: sign * (ranking.terms[term][first] - ranking.terms[term][second])
        for term, sign in signs.items()
    }
    spread = {term: abs(sign) * float(np.std(ranking.terms[term])) for term, sign in signs.items()}
    parts = ", ".join(
        f"{term} {value:+.4f}" for term, value in sorted(lead.items(), key=lambda item: -abs(item[1]))
    )
    decisive = max(spread, key=lambda term: spread[term])
    return (
        f"{name}: {pool.ids[first]} leads {pool.ids[second]} by {ranking.scores[first] - ranking.scores[second]:.4f} "
        f"({parts}). Over the pool, {decisive} spreads the scores most "
        f"(weighted standard deviations: {', '.join(f'{t} {v:.4f}' for t, v in spread.items())})."
    )
