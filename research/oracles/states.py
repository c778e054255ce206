"""Every oracle on the same planning states: what each would have preferred, whatever was flown.

GROUND TRUTH, for analysis only. Needs missions that were flown with everything kept.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nbv.cache import Store
from nbv.errors import UserError
from nbv.gates import GroundTruthOracle
from nbv.mission.planning_state import load_state
from nbv.rocks import Rock, load_rock
from nbv.scorers import B_AWARE, COVIS, rank_candidates
from nbv.terrain import buried_rock
from research.decisions import PERCENT
from research.flown_missions import FlownMission, find_missions
from research.oracles.study import COVERAGES, Judgement, Preferences, preferences


@dataclass(frozen=True)
class JudgedMission:
    """One mission's states under one coverage."""

    directory: Path
    rock: str
    gate: str  # that flew it
    coverage: str
    preferences: Preferences
    covered_first: float  # percent of the samples, before the first capture
    covered_last: float  # before the last


@dataclass(frozen=True)
class CoverageSummary:
    """One coverage over all missions."""

    coverage: str
    missions: int
    preferences: Preferences  # counts summed; ``saturates_at`` is the median over missions that saturate
    missions_preferring_b_aware: int
    missions_preferring_covis: int
    missions_saturated: int
    covered_first: float  # means over missions, percent
    covered_last: float


def judge(
    directories: Sequence[Path], rocks: Sequence[str] = (), coverages: Sequence[str] = COVERAGES
) -> list[JudgedMission]:
    """Every kept mission in or below ``directories`` under every coverage.

    Parameters
    ----------
    rocks
        Catalogue names or mesh files that missions may have been flown on; catalogue rocks are found without.

    Raises
    ------
    UserError
        No mission with its planning states, or a mission on a rock that is not given.
    """
    known = [load_rock(rock, Store()) for rock in rocks]
    missions = [m for m in find_missions(directories) if any((m.directory / "states").glob("iter_*.npz"))]
    if not missions:
        raise UserError(
            f"{directories[0]} holds no mission with its planning states; fly one with `gatetune mission run`"
        )
    return [judged for m in missions for judged in _judge_mission(m, _rock_of(m, known), coverages)]


def _rock_of(mission: FlownMission, known: Sequence[Rock]) -> Rock:
    sha256 = mission.result.provenance.get("rock_sha256")
    for rock in known:
        if rock.sha256 == sha256:
            return rock
    try:
        rock = load_rock(mission.result.rock, Store())
    except UserError as error:
        raise UserError(f"{mission.directory}: {error}; name its mesh file with --rock") from error
    if rock.sha256 != sha256:
        raise UserError(f"{mission.directory} was flown on another rock {rock.name!r}; name it with --rock")
    return rock


def _judge_mission(mission: FlownMission, rock: Rock, coverages: Sequence[str]) -> list[JudgedMission]:
    rock = buried_rock(rock, mission.config)
    files = sorted((mission.directory / "states").glob("iter_*.npz"))
    oracles = {
        coverage: GroundTruthOracle(
            rock.vertices_m, rock.faces, mission.config.with_values({"gate.oracle_coverage": coverage})
        )
        for coverage in coverages
    }
    judged: dict[str, list[Judgement]] = {coverage: [] for coverage in coverages}
    covered: dict[str, list[float]] = {coverage: [] for coverage in coverages}
    for file in files:
        state, pool = load_state(file)
        rankings = rank_candidates(state, pool, mission.config)
        b_aware, covis = rankings[B_AWARE.name].top, rankings[COVIS.name].top
        for coverage, oracle in oracles.items():
            now = oracle.coverage(state)
            ours, theirs = (oracle.gain(pool.positions_m[top], now) for top in (b_aware, covis))
            judged[coverage].append(Judgement(state.iteration, ours, theirs, b_aware == covis))
            covered[coverage].append(PERCENT * float(now.covered.mean()))
    found = []
    for coverage in coverages:
        counts = preferences(judged[coverage])
        assert counts is not None  # there is a state
        found.append(
            JudgedMission(
                mission.directory,
                rock.name,
                mission.config.gate.kind,
                coverage,
                counts,
                covered[coverage][0],
                covered[coverage][-1],
            )
        )
    return found


def summarise(judged: Sequence[JudgedMission]) -> list[CoverageSummary]:
    """One line per coverage, in the order in which they were judged."""
    summaries = []
    for coverage in dict.fromkeys(j.coverage for j in judged):
        own = [j for j in judged if j.coverage == coverage]
        counts = [j.preferences for j in own]
        ends = [p.saturates_at for p in counts if p.saturates_at is not None]
        total: dict[str, Any] = {
            name: sum(getattr(p, name) for p in counts)
            for name in ("decisions", "b_aware", "covis", "same_candidate", "saturated", "other_ties")
        }
        total["saturates_at"] = round(statistics.median(ends)) if ends else None
        summaries.append(
            CoverageSummary(
                coverage,
                len(own),
                Preferences(**total),
                sum(p.b_aware > 0 for p in counts),
                sum(p.covis > 0 for p in counts),
                len(ends),
                statistics.mean(j.covered_first for j in own),
                statistics.mean(j.covered_last for j in own),
            )
        )
    return summaries
