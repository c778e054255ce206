"""Which photographs register, and what that costs: the missions, the fit and the tables of docs/results/real_photographs.md.

python -m research.photographs.registers fly OUT --rock mictlan --seeds 16 --views 8 --arm random "covis, paper" --replicates 8
python -m research.photographs.registers fly OUT --rock slab@field --arm random
python -m research.photographs.registers fit OUT ...
python -m research.photographs.registers tell OUT ... --csv FILE
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import itertools
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.linear_model import LogisticRegression

from nbv.config import IDEAL, MissionConfig, config_from_dict, load_condition, preset, under
from nbv.mission import MissionResult
from nbv.mission.planning_state import load_state
from nbv.photographs import PhotographSet
from nbv.rocks.catalogue import is_photographed
from nbv.safe_files import read_yaml
from nbv.scorers.registration import Calibration, expected_matches
from tuner.evaluation.comparison import mean_interval
from tuner.missions.registry import mission_function

F_SCORE = "observable.f_score_48mm"
SCORERS = {"covis": "covis", "b-aware": "b_aware", "matchable": "matchable", "predicted": "matchable"}
FEWEST_BY_SIFT = 15  # seeds; farther apart they need features of the ground
OTHER_TERMS = ("nov", "move", "ang")
ANGLES_DEG, OCTAVES = (8.0, 10.0, 12.0, 15.0, 18.0, 22.0, 27.0, 33.0, 40.0), (0.5, 1.0, 2.0)
BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.001)
COLUMNS = ("rock", "seeds", "views", "arm", "replicate", "status", "f_score", "photographs", "registered")
COLUMNS += ("seeds_registered", "planned", "planned_registered")


def base_config(rock: str, seeds: int, views: int) -> MissionConfig:
    """``seeds`` on a ring and ``views``; on a set of photographs at their median elevation, as ``photographs enough`` flies."""
    name, _, condition = rock.partition("@")
    values: dict[str, Any] = {"seed.count": seeds, "stop.adaptive_budget": views, "seed.lowest_deg": 20.0}
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
        return base.with_values(
            {"seed.count": base.seed.total + base.adaptive_budget, "stop.adaptive_budget": 0}
        )
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


def fly(asked: argparse.Namespace) -> None:
    """Fly what is not there yet; keep planning states, not photographs."""
    for k, name, rock in itertools.product(
        range(asked.first, asked.first + asked.replicates), asked.arm, asked.rock
    ):
        bare = rock.partition("@")[0]
        fidelity = "photographs" if is_photographed(bare) else asked.fidelity
        base = base_config(rock, asked.seeds, asked.views).with_values(dict(_values(asked.set)))
        slug = "".join(c if c.isalnum() or c in ".@=-" else "_" for c in name)
        where = asked.out / f"{rock}_{asked.seeds}+{asked.views}" / slug / f"r{k}"
        if not (where / "mission.json").exists():
            result = mission_function(fidelity)(arm(base, name), bare, k, where, keep="all")
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


def fit(asked: argparse.Namespace) -> None:
    """The calibration, cross-validated by rock and replicate, and its reliability."""
    decisions = []
    for where, (rock, *_), result in missions(asked.out):
        located = where / "located.yaml"
        config = config_from_dict(read_yaml(located if located.exists() else where / "config.yaml"))
        for record in result.trace:
            state, pool = load_state(where / "states" / f"iter_{record.iteration:02d}.npz")
            at = pool.positions_m[pool.ids.index(record.chosen.removesuffix("b"))][None]
            decisions.append((f"{rock} {result.replicate}", state.model, at, config, record.registered))
    groups = np.array([d[0] for d in decisions])
    truth = np.array([d[-1] for d in decisions])
    print(f"{len(truth)} planned photographs, {truth.sum()} registered")
    best: tuple[float, Any] = (np.inf, None)
    for angle, octaves in itertools.product(ANGLES_DEG, OCTAVES):
        shape = Calibration(angle_deg=angle, octaves=octaves)
        seen = [expected_matches(model, at, config, shape) for _, model, at, config, _ in decisions]
        features = np.log1p(np.array(seen)[:, :, 0])
        chance = np.empty(len(truth))
        for group in np.unique(groups):
            held = groups == group
            chance[held] = (
                LogisticRegression(C=10.0)
                .fit(features[~held], truth[~held])
                .predict_proba(features[held])[:, 1]
            )
        loss = float(-np.log(np.where(truth, chance, 1 - chance).clip(1e-6)).mean())
        print(f"angle {angle:g} octaves {octaves:g}: log loss {loss:.4f}")
        if loss < best[0]:
            model = LogisticRegression(C=10.0).fit(features, truth)
            fitted = dataclasses.replace(
                shape,
                intercept=float(model.intercept_[0]),
                matches=float(model.coef_[0, 0]),
                cells=float(model.coef_[0, 1]),
            )
            best = loss, (fitted, chance)
    fitted, chance = best[1]
    share = truth.mean()
    constant = -(share * np.log(share) + (1 - share) * np.log(1 - share))
    print(f"best: log loss {best[0]:.4f} (a constant {constant:.4f}), {fitted}")
    print("\n|predicted chance|photographs|mean prediction|registered|\n|---|---:|---:|---:|")
    for low, high in itertools.pairwise(BINS):
        inside = (chance >= low) & (chance < high)
        if inside.any():
            print(
                f"|{low:g} to {min(high, 1):g}|{inside.sum()}|{chance[inside].mean():.2f}|{truth[inside].mean():.2f}|"
            )


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
        for name, flown in of.items():
            scores = [flown[k]["f_score"] for k in sorted(flown)]
            end = (
                100
                * sum(r["registered"] for r in flown.values())
                / max(1, sum(r["photographs"] for r in flown.values()))
            )
            planned = sum(r["planned"] for r in flown.values())
            when = (
                f"{100 * sum(r['planned_registered'] for r in flown.values()) / planned:.0f}"
                if planned
                else ""
            )
            said = ", ".join(f"{v:.1f} ({flown[k]['registered']})" for k, v in zip(sorted(flown), scores))
            over = "|".join(
                _over(flown, of.get(other, {}) if other != name else {}) for other in ("random", "ring")
            )
            print(f"|{name}|{said}|{np.mean(scores):.1f}|{min(scores):.1f}|{end:.0f}|{when}|{over}|")
    if asked.csv:
        with asked.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def _over(flown: dict[int, dict[str, Any]], other: dict[int, dict[str, Any]]) -> str:
    found = mean_interval(
        {"set": [flown[k]["f_score"] - other[k]["f_score"] for k in sorted(flown.keys() & other.keys())]}
    )
    if found is None:
        return ""
    return f"{found.mean:+.1f}" + ("" if found.low is None else f" [{found.low:+.1f}, {found.high:+.1f}]")


def main() -> None:
    """One of three commands."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)
    for name, function in (("fly", fly), ("fit", fit), ("tell", tell)):
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
