"""Which photographs register, and what that costs: the missions, the fit and the tables of docs/results/real_photographs.md.

python -m research.photographs.registers fly OUT --rock mictlan --seeds 16 --views 8 --arm random "covis, paper" --replicates 8
python -m research.photographs.registers fly OUT --rock slab@field --arm random
python -m research.photographs.registers fit SET/sparse ...
python -m research.photographs.registers check OUT ...
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
import pycolmap
from scipy.spatial.transform import Rotation
from sklearn.linear_model import LogisticRegression

from nbv.config import IDEAL, CameraConfig, MissionConfig, config_from_dict, load_condition, preset, under
from nbv.mission import MissionResult
from nbv.mission.planning_state import load_state
from nbv.photographs import PhotographSet
from nbv.rocks.catalogue import is_photographed
from nbv.safe_files import read_yaml
from nbv.scorers.registration import Calibration, expected_matches, registration_chance
from nbv.types import SparseModel
from tuner.comparison.statistics import mean_interval
from tuner.missions.registry import mission_function

F_SCORE = "observable.f_score_48mm"
SCORERS = {"covis": "covis", "b-aware": "b_aware", "matchable": "matchable", "predicted": "matchable"}
FEWEST_BY_SIFT = 15  # seeds; farther apart they need features of the ground
OTHER_TERMS = ("nov", "move", "ang")
ANGLES_DEG, OCTAVES = (14.0, 17.0, 20.0, 24.0), (1.0,)
DRAWS = 4  # of photographs, at each number
NEEDED_MATCHES = 15  # points of the model that a photograph must show, where telemetry guards the pose
BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.001)
COLUMNS = ("rock", "seeds", "views", "arm", "replicate", "status", "f_score", "photographs", "registered")
COLUMNS += ("seeds_registered", "planned", "planned_registered")


def base_config(rock: str, seeds: int, views: int) -> MissionConfig:
    """``seeds`` on a ring and ``views``; on a set of photographs at their median elevation, as ``photographs enough`` runs."""
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


def run_missions(asked: argparse.Namespace) -> None:
    """Run what is not there yet; keep planning states, not photographs."""
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


def draws(folder: Path) -> Iterable[tuple[SparseModel, np.ndarray, np.ndarray, MissionConfig]]:
    """Chosen photographs of a COLMAP model, even or random ones: what they alone would have as a model, the others' places, and
    how many of its points each of those shares."""
    model = pycolmap.Reconstruction(folder)
    images = [model.images[i] for i in sorted(model.reg_image_ids())]
    row = {image.image_id: n for n, image in enumerate(images)}
    seen = np.zeros((len(model.points3D), len(images)), dtype=bool)
    for n, point in enumerate(model.points3D.values()):
        seen[n, [row[e.image_id] for e in point.track.elements]] = True
    up = -np.mean([image.cam_from_world().rotation.matrix()[1] for image in images], axis=0)
    turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0]
    points = turn.apply([point.xyz for point in model.points3D.values()])
    centers = turn.apply([image.projection_center() for image in images])
    target = np.median(points, axis=0)
    camera = next(iter(model.cameras.values()))
    pinhole = CameraConfig(
        width_px=camera.width, height_px=camera.height, focal_px=camera.mean_focal_length()
    )
    config = dataclasses.replace(preset("campaign"), camera=pinhole, target_m=tuple(target.tolist()))
    offset = centers - target
    around = np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))
    rng = np.random.default_rng(0)
    for count, k in itertools.product((4, 6, 8, 12, 16, 24), range(DRAWS)):
        even = around[
            (np.arange(count) * len(images) / count + rng.integers(len(images))).astype(int) % len(images)
        ]
        chosen = np.sort(even if k % 2 else rng.choice(len(images), count, replace=False))
        others = np.setdiff1d(np.arange(len(images)), chosen)
        kept = np.flatnonzero(seen[:, chosen].sum(axis=1) >= 2)
        tracks = [np.flatnonzero(seen[n, chosen]) for n in kept]
        part = SparseModel(
            points[kept],
            np.ones(len(kept)),
            np.concatenate([[0], np.cumsum([len(t) for t in tracks])]).astype(np.int64),
            np.concatenate([*tracks, []]).astype(np.int64),
            centers[chosen],
            tuple(map(str, chosen)),
            0.0,
            0.0,
        )
        yield part, centers[others], seen[np.ix_(kept, others)].sum(axis=0), config


def fit(asked: argparse.Namespace) -> None:
    """The calibration from the tracks of sets' models, each set predicted by the other's fit, and its reliability."""
    of_set = [list(draws(folder)) for folder in asked.out]
    truth = [np.concatenate([shared for _, _, shared, _ in found]) >= NEEDED_MATCHES for found in of_set]
    print([f"{t.mean():.2f} of {len(t)} share {NEEDED_MATCHES} points" for t in truth])
    best: tuple[float, Any] = (np.inf, None)
    for angle, octaves in itertools.product(ANGLES_DEG, OCTAVES):
        shape = Calibration(angle_deg=angle, octaves=octaves)
        seen = [
            np.log1p(np.concatenate([np.stack(expected_matches(m, at, c, shape), 1) for m, at, _, c in f]))
            for f in of_set
        ]
        chance = []
        for k in range(len(of_set)):
            others = [n for n in range(len(of_set)) if n != k] or [k]
            model = LogisticRegression().fit(
                np.concatenate([seen[n] for n in others]), np.concatenate([truth[n] for n in others])
            )
            chance.append(model.predict_proba(seen[k])[:, 1])
        loss = float(
            np.mean([-np.log(np.where(t, p, 1 - p).clip(1e-6)).mean() for t, p in zip(truth, chance)])
        )
        print(f"angle {angle:g} octaves {octaves:g}: log loss {loss:.4f}", flush=True)
        if loss < best[0]:
            model = LogisticRegression().fit(np.concatenate(seen), np.concatenate(truth))
            matches, cells = model.coef_[0]
            fitted = dataclasses.replace(
                shape, intercept=float(model.intercept_[0]), matches=float(matches), cells=float(cells)
            )
            best = loss, (fitted, chance)
    fitted, chance = best[1]
    print(f"best: log loss {best[0]:.4f}, {fitted}")
    for folder, of, p in zip(asked.out, truth, chance):
        print(f"\n{folder}, by the other sets' fit")
        reliability(p, of)
    for folder, of, found in zip(asked.out, truth, of_set):
        print(f"\n{folder}, by the calibration that ships")
        reliability(np.concatenate([registration_chance(m, at, c) for m, at, _, c in found]), of)


def check(asked: argparse.Namespace) -> None:
    """Reliability of the chance over what missions planned."""
    chance, truth = [], []
    for where, _, result in missions(asked.out):
        located = where / "located.yaml"
        config = config_from_dict(read_yaml(located if located.exists() else where / "config.yaml"))
        for record in result.trace:
            state, pool = load_state(where / "states" / f"iter_{record.iteration:02d}.npz")
            at = pool.positions_m[pool.ids.index(record.chosen.removesuffix("b"))][None]
            chance.append(float(registration_chance(state.model, at, config)[0]))
            truth.append(record.registered)
    reliability(np.array(chance), np.array(truth))


def reliability(chance: np.ndarray, truth: np.ndarray) -> None:
    """The curve, as a table."""
    print("|predicted chance|photographs|mean prediction|registered|\n|---|---:|---:|---:|")
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
        with asked.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


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
    """One of three commands."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)
    for name, function in (("fly", run_missions), ("fit", fit), ("check", check), ("tell", tell)):
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
