"""Why a candidate won: every term of Eq. 1, for one planning state."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.table import Table

from nbv.config import IDEAL, SCORERS, Weights
from nbv.errors import UserError
from nbv.mission.planning_state import load_state
from nbv.scorers import find_scorer, rank_candidates
from nbv.types import CandidatePool, Ranking
from tuner.report.mission.run_files import planned_config

TERMS = ("main", "nov", "move", "ang")
TOP = 10  # candidates per scorer


def explain_state(
    mission: Path, iteration: int, overrides: Mapping[str, Any]
) -> tuple[list[Table | str], dict[str, list[dict[str, Any]]]]:
    """The rankings of one state, by the paper's two scorers and by what the gate flies: to be read, and as data.

    Parameters
    ----------
    mission
        A mission's directory.
    iteration
        Which state, from 0.
    overrides
        Values by parameter path, laid over the mission's configuration.

    Raises
    ------
    UserError
        There is no such state, or no such parameter.
    """
    states = sorted((mission / "states").glob("iter_*.npz"))
    file = mission / "states" / f"iter_{iteration:02d}.npz"
    if not states and (mission / "flight.json").is_file():
        raise UserError(f"{mission} planned no view; there is nothing to explain")
    if not states:
        raise UserError(
            f"{mission} holds no planning states; name a directory that `gatetune mission run` wrote"
        )
    if file not in states:
        raise UserError(f"{mission} has no iteration {iteration}; it has 0 to {len(states) - 1}")
    config = planned_config(mission).with_values(dict(overrides))
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
        said.append(_ranking_table(name, rankings[name], pool, weights))
        data[name] = [
            {
                "candidate": pool.ids[index],
                "score": float(rankings[name].scores[index]),
                **{term: float(rankings[name].terms[term][index]) for term in TERMS},
            }
            for index in rankings[name].order[:TOP]
        ]
    return said, data


def _ranking_table(title: str, ranking: Ranking, pool: CandidatePool, weights: Weights) -> Table:
    table = Table(
        title=f"{title}: S = {weights.main:g} main + {weights.nov:g} nov - {weights.move:g} move - "
        f"{weights.ang:g} ang"
    )
    # In full on a terminal of 80 columns: names of candidates are what one looks up.
    for column in ("#", "candidate", "elev.", "azim.", *TERMS, "score"):
        table.add_column(column, justify="right", no_wrap=True)
    for rank, index in enumerate(ranking.order[:TOP]):
        table.add_row(
            str(rank + 1),
            pool.ids[index],
            f"{pool.elevations_deg[index]:.0f}°",
            f"{pool.azimuths_deg[index]:.0f}°",
            *(f"{ranking.terms[term][index]:.4f}" for term in TERMS),
            f"{ranking.scores[index]:.4f}",
        )
    return table
