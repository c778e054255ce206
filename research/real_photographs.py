"""Planners, random views and rings on photographs that were taken: the missions and tables of docs/results/index.md.

python -m research.real_photographs fly OUT --rock mictlan --seeds 16 --views 8 --arm random "covis, paper" --replicates 8
python -m research.real_photographs fly OUT --rock slab@field --arm random
python -m research.real_photographs tell OUT ... --csv FILE
"""

from __future__ import annotations

import argparse
import itertools
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import IDEAL, MissionConfig, load_condition, preset, under
from nbv.mission import MissionResult
from nbv.photographs import PhotographSet
from nbv.rocks.catalogue import is_photographed
from research import write_rows
from tuner.missions.registry import kind_on
from tuner.problem.intervals import mean_interval

F_SCORE = "observable.f_score_48mm"
SCORERS = {"covis": "covis", "b-aware": "b_aware", "predicted": "predicted"}
FEWEST_BY_SIFT = 15  # seeds; farther apart they need features of the ground
OTHER_TERMS = ("nov", "move", "ang")
COLUMNS = ("rock", "seeds", "views", "arm", "replicate", "status", "f_score", "photographs", "registered")
COLUMNS += ("seeds_registered", "planned", "planned_registered")


def base_config(rock: str, seeds: int, views: int) -> MissionConfig:
    """``seeds`` on a ring and ``views``; on a set of photographs at their median elevation, as ``photographs enough`` runs."""
    name, _, condition = rock.partition("@")
    values: dict[str, Any] = {"photographs": seeds + views, "seeds": seeds}
    values |= {"seed.layout": "turn", "seed.lowest_deg": 20.0}
    values |= {
        "sparse.min_registered_seeds": 3,
        "sparse.ground_features": 0 if seeds >= FEWEST_BY_SIFT else 2000,
    }
    if is_photographed(name):
        views_of = PhotographSet.read(name).coverage
        values["seed.lowest_deg"] = round(float(np.clip(np.median(views_of.elevations_deg), 0.0, 60.0)), 1)
        values |= {"telemetry": "rtk", "pool.min_altitude_m": -3.0}
    config = preset("campaign").with_values(values)
    return under(config, load_condition(condition)) if condition and condition != IDEAL else config


def arm(base: MissionConfig, name: str) -> MissionConfig:
    """``SCORER, WHAT; path=value ...`` of ``base``: ``paper`` keeps the weights, ``novelty 0`` and ``alone`` set some to 0."""
    name, _, more = name.partition(";")
    kind, _, weights = name.partition(", ")
    if kind == "ring":
        return base.changed(seeds=base.photographs)
    values: dict[str, Any] = {"gate.kind": kind}
    zeros = {"paper": (), "novelty 0": ("nov",), "alone": OTHER_TERMS}[weights or "paper"]
    scorers = set(SCORERS.values()) if kind not in SCORERS else {SCORERS[kind]}
    values |= {f"{s}.weights.{term}": 0.0 for s in scorers for term in zeros}
    for item in more.split():
        path, _, value = item.partition("=")
        values[path] = (
            {"true": True, "false": False}.get(value) if value in ("true", "false") else float(value)
        )
        paths = [p.format(s) for p in (path,) for s in sorted(scorers)] if "{}" in path else [path]
        if "{}" in path:
            values.update(dict.fromkeys(paths, values.pop(path)))
    return base.with_values(values)


def run_missions(asked: argparse.Namespace) -> None:
    """Run what is not there yet; keep planning states, not photographs."""
    for k, name, rock in itertools.product(
        range(asked.first, asked.first + asked.replicates), asked.arm, asked.rock
    ):
        bare = rock.partition("@")[0]
        base = base_config(rock, asked.seeds, asked.views).with_values(dict(_values(asked.set)))
        slug = "".join(c if c.isalnum() or c in ".@=-" else "_" for c in name)
        where = asked.out / f"{rock}_{asked.seeds}+{asked.views}" / slug / f"r{k}"
        if not (where / "mission.json").exists():
            result = kind_on(bare, asked.fidelity)(arm(base, name), bare, k, where, keep="all")
            for folder in ("images", "sparse"):
                shutil.rmtree(where / folder, ignore_errors=True)
            for cloud in where.glob("*.ply"):
                cloud.unlink()
            (where / "arm.txt").write_text(f"{rock}\n{asked.seeds}\n{asked.views}\n{name}\n")
            print(
                rock,
                name,
                k,
                result.status,
                result.metrics.get("observable", {}).get("f_score_48mm"),
                flush=True,
            )


def _values(items: Iterable[str]) -> Iterable[tuple[str, float]]:
    for item in items:
        path, _, value = item.partition("=")
        yield path, float(value)


def missions(roots: Sequence[Path]) -> Iterable[tuple[Path, list[str], MissionResult]]:
    """Directory, rock, seeds, views and arm, and result of every mission."""
    for path in sorted(p for root in roots for p in root.rglob("arm.txt")):
        yield path.parent, path.read_text().splitlines(), MissionResult.load(path.parent)


def row_of(facts: Sequence[str], result: MissionResult) -> dict[str, Any]:
    """What the tables tell of one mission."""
    rock, seeds, views, name = facts
    planned = sum(record.registered for record in result.trace)
    images, registered = (int(result.costs.get(key, 0)) for key in ("images", "registered_images"))
    started = result.trace[0].n_registered if result.trace else registered
    score = 0.0 if result.status == "failed" else result.metric(F_SCORE)
    measured = (round(score, 2), images, registered, started, len(result.trace), planned)
    values = (rock, int(seeds), int(views), name, result.replicate, result.status, *measured)
    return dict(zip(COLUMNS, values, strict=True))


def tell(asked: argparse.Namespace) -> None:
    """Tables by set and plan: F-scores by replicate, what registered, and differences to random views and to the ring."""
    rows = [row_of(facts, result) for _, facts, result in missions(asked.out)]
    key = lambda r: (r["rock"], r["seeds"], r["views"])  # noqa: E731
    for (rock, seeds, views), found in itertools.groupby(sorted(rows, key=key), key):
        of: dict[str, dict[int, dict[str, Any]]] = {}
        for row in found:
            of.setdefault(row["arm"], {})[row["replicate"]] = row
        print(f"\n{rock}, {seeds} + {views}\n")
        print(
            "|plan|F-score by replicate|mean|worst|registered at the end, %|planned that registered when taken, %|over random|over the ring|"
        )
        print("|---|---|---:|---:|---:|---:|---|---|")
        for name, evaluated in of.items():
            scores = [evaluated[k]["f_score"] for k in sorted(evaluated)]
            end = (
                100
                * sum(r["registered"] for r in evaluated.values())
                / max(1, sum(r["photographs"] for r in evaluated.values()))
            )
            planned = sum(r["planned"] for r in evaluated.values())
            when = (
                f"{100 * sum(r['planned_registered'] for r in evaluated.values()) / planned:.0f}"
                if planned
                else ""
            )
            said = ", ".join(
                f"{v:.1f} ({evaluated[k]['registered']})" for k, v in zip(sorted(evaluated), scores)
            )
            over = "|".join(
                _over(evaluated, of.get(other, {}) if other != name else {}) for other in ("random", "ring")
            )
            print(f"|{name}|{said}|{np.mean(scores):.1f}|{min(scores):.1f}|{end:.0f}|{when}|{over}|")
    if asked.csv:
        write_rows(asked.csv, COLUMNS, rows)


def _over(evaluated: dict[int, dict[str, Any]], other: dict[int, dict[str, Any]]) -> str:
    found = mean_interval(
        {
            "set": [
                evaluated[k]["f_score"] - other[k]["f_score"] for k in sorted(evaluated.keys() & other.keys())
            ]
        }
    )
    if found is None:
        return ""
    return f"{found.mean:+.1f}" + ("" if found.low is None else f" [{found.low:+.1f}, {found.high:+.1f}]")


def main() -> None:
    """One of two commands."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)
    for name, function in (("fly", run_missions), ("tell", tell)):
        command = commands.add_parser(name)
        command.set_defaults(function=function)
        command.add_argument("out", type=Path, nargs=None if name == "fly" else "+")
        if name == "tell":
            command.add_argument("--csv", type=Path)
        if name == "fly":
            command.add_argument("--rock", action="append", required=True, help="a set, or ROCK@CONDITION")
            command.add_argument("--arm", nargs="+", required=True)
            command.add_argument("--set", nargs="*", default=[])
            command.add_argument("--fidelity", default="photogrammetric")
            for number, default in (("seeds", 16), ("views", 8), ("replicates", 4), ("first", 0)):
                command.add_argument(f"--{number}", type=int, default=default)
    asked = parser.parse_args()
    asked.function(asked)


if __name__ == "__main__":
    main()
