"""Finished missions as observations of a search space: from a campaign's ledger or from run directories."""

from __future__ import annotations

import collections
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig, config_from_dict, parameter_paths
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from nbv.safe_files import read_yaml
from tuner.campaign.campaign import Campaign
from tuner.problem.objective import DEFAULT_METRIC, Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace, value_at
from tuner.report.labels import metric_label


@dataclass(frozen=True)
class MissionData:
    """Missions that differ in the search space's parameters, rock and replicate only."""

    space: SearchSpace
    objective: Objective
    observations: tuple[Observation, ...]
    left_out: dict[str, int]  # missions that are no such observation, by reason

    @property
    def rocks(self) -> tuple[str, ...]:
        """Rocks in order of appearance."""
        return tuple(dict.fromkeys(o.rock for o in self.observations))


@dataclass(frozen=True)
class FlownMission:
    """A finished mission found on disk."""

    directory: Path
    config: MissionConfig
    result: MissionResult


def find_missions(directories: Sequence[Path]) -> list[FlownMission]:
    """All finished missions in or below the directories, in path order, each once.

    Raises
    ------
    UserError
        A directory without any, or a mission whose files cannot be read.
    """
    found: dict[Path, FlownMission] = {}
    for directory in directories:
        files = sorted(directory.rglob("mission.json")) if directory.is_dir() else []
        if not files:
            raise UserError(f"{directory} holds no finished mission (mission.json); name run directories")
        for file in files:
            if file.parent.resolve() in found:
                continue
            path = file.parent / "config.yaml"
            config = config_from_dict(read_yaml(path))
            found[file.parent.resolve()] = FlownMission(file.parent, config, MissionResult.load(file))
    return list(found.values())


def campaign_data(directory: Path, metric: str | None = None) -> MissionData:
    """A campaign's finished missions; another ``metric`` than the tuned one is read from their results."""
    campaign = Campaign.open(directory, read_only=True)
    objective = campaign.settings.objective
    if metric is not None and metric != objective.metric:
        objective = objective_for(metric)
    left_out: collections.Counter[str] = collections.Counter()
    observations = []
    for t in campaign.trials():
        value = t.measured(objective)
        if value is None:
            left_out["still flying" if t.state == "running" else "failed or without the metric"] += 1
            continue
        observations.append(
            Observation(
                t.number, t.values, t.rock, t.replicate, objective.sign * value, value, condition=t.condition
            )
        )
    return _checked(
        MissionData(campaign.settings.space, objective, tuple(observations), dict(left_out)), directory
    )


def mission_data(
    directories: Sequence[Path],
    space: SearchSpace,
    metric: str = DEFAULT_METRIC,
    where: Mapping[str, Any] | None = None,
) -> MissionData:
    """Return the missions in or below ``directories`` that lie in ``space``.

    Missions that fly what the space fixes differently (another gate, say) or that lie outside its bounds are
    left out and counted.

    Parameters
    ----------
    where
        Parameter values that a mission must have, e.g. ``{"stop.adaptive_budget": 8}``.

    Raises
    ------
    UserError
        The missions differ in something else too, or none is left.
    """
    objective = objective_for(metric)
    left_out: collections.Counter[str] = collections.Counter()
    kept: list[tuple[FlownMission, dict[str, Any], float]] = []
    rest: dict[str, MissionConfig] = {}
    for mission in find_missions(directories):
        config = mission.config
        values = {path: value_at(config, path) for path in space.paths}
        value = objective.outcome(mission.result.status, mission.result.metrics)[0]
        if any(value_at(config, path) != wanted for path, wanted in (where or {}).items()):
            left_out["not what --where asks for"] += 1
        elif space.base_config(config) != config:
            left_out["differs in what the search space fixes"] += 1
        elif not all(p.contains(values[p.path]) for p in space.parameters):
            left_out["outside the search space's bounds"] += 1
        elif value is None:
            left_out["failed or without the metric"] += 1
        else:
            kept.append((mission, values, value))
            reference = config.with_values(
                space.complete({p.path: p.from_unit(0.5) for p in space.parameters})
            )
            rest[reference.digest()] = reference
    if len(rest) > 1:
        path, shown = _difference(list(rest.values()))
        raise UserError(
            f"the missions also differ in {path} ({shown}); choose one, for example --where {path}={shown.split(', ')[0]}"
        )
    observations = tuple(
        Observation(
            i,
            values,
            m.result.rock,
            m.result.replicate,
            objective.sign * value,
            value,
            condition=m.result.condition,
        )
        for i, (m, values, value) in enumerate(kept)
    )
    return _checked(MissionData(space, objective, observations, dict(left_out)), directories[0])


def objective_for(metric: str) -> Objective:
    """The metric with the direction that its name tells."""
    return Objective(metric, "maximise" if metric_label(metric).larger_is_better else "minimise")


def is_campaign(directory: Path) -> bool:
    """Whether ``directory`` is a campaign's run directory."""
    return (directory / "campaign.yaml").is_file()


def _difference(configs: Sequence[MissionConfig]) -> tuple[str, str]:
    for path in parameter_paths():
        seen = dict.fromkeys(value_at(c, path) for c in configs)
        if len(seen) > 1:
            return path, ", ".join(map(str, seen))
    raise AssertionError("configurations with different digests differ somewhere")


def _checked(data: MissionData, source: Path) -> MissionData:
    if not data.observations:
        reasons = "; ".join(f"{n} {reason}" for reason, n in data.left_out.items()) or "it holds no mission"
        raise UserError(f"{source}: no mission to learn from with metric {data.objective.metric} ({reasons})")
    return data
