"""Missions that come with this program: what campaigns on its procedural rocks taught before it was shipped.

``shipped_missions/SPACE.json`` has the geometric missions of one campaign in the search space of that name, on training
rocks, and the command that ran it; ``research/ship_missions.py`` writes it from the campaign's run directory.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nbv.errors import UserError
from nbv.safe_files import RESULT_BYTES, RESULT_NODES, read_json
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace
from tuner.samplers.earlier_missions import EarlierMissions

SHIPPED = "shipped"  # their name among the campaigns to learn from
NOTHING = "nothing"  # what the command line calls a campaign that learns from none
DIRECTORY = Path(__file__).parent / "shipped_missions"


def sources_by_default(
    space: SearchSpace, objective: Objective, sampler: str, second: Objective | None
) -> tuple[str, ...]:
    """Return what a campaign learns from unless told otherwise: the shipped missions where there are some and it can."""
    can = sampler == "gp" and second is None
    return (SHIPPED,) if can and _read(space, objective) is not None else ()


def shipped_missions(space: SearchSpace, objective: Objective) -> EarlierMissions:
    """Return the missions in ``space``, outcomes in the direction that ``objective`` maximises.

    Raises `UserError`: there are none in this space, or for this objective.
    """
    tree = _read(space, objective)
    if tree is None:
        spaces = ", ".join(sorted(path.stem for path in DIRECTORY.glob("*.json")))
        raise UserError(
            f"no missions come with this program for search space {space.name!r} as given here and "
            f"{objective.metric}, {objective.direction}d (there are for {spaces} as it comes with the program, with the "
            f"default metric); leave `--learn-from {SHIPPED}` out"
        )
    observations = tuple(
        Observation(
            number,
            dict(zip(tree["paths"], values)),
            tree["rocks"][rock],
            replicate,
            None if raw is None else objective.sign * raw,
            raw,
        )
        for number, (rock, replicate, raw, values) in enumerate(tree["missions"])
    )
    return EarlierMissions(space, tuple(tree["rocks"]), observations)


def _read(space: SearchSpace, objective: Objective) -> dict[str, Any] | None:
    """Return the file of ``space``; None where there is none, or where it is of another space of that name or objective."""
    path = DIRECTORY / f"{space.name}.json"
    if not path.is_file():
        return None
    tree: dict[str, Any] = read_json(path, RESULT_BYTES, RESULT_NODES)
    task = (list(space.paths), objective.metric, objective.direction)
    if task != (tree["paths"], tree["metric"], tree["direction"]):
        return None
    fits = all(
        p.contains(value) for *_, values in tree["missions"] for p, value in zip(space.parameters, values)
    )
    return tree if fits else None
