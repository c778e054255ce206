"""Does the gain stated for a rock nobody has flown hold there, and how many training rocks does it take?

    OMP_NUM_THREADS=1 python -m research.next_rock fly --rock $A15016 --rock $A65035 --bank bank.csv
    OMP_NUM_THREADS=1 python -m research.next_rock play --bank bank.csv --out docs/results/data/next_rock.csv
    OMP_NUM_THREADS=1 python -m research.next_rock rule --rock $A15016 --rock $A65035 --bank bank.csv

``run_missions`` fills a bank of geometric missions: 48 configurations of each space (the default, then in turn points near it and
anywhere) on all procedural rocks and some files, two replicates. ``play`` plays campaigns of 64 of these missions, drawn at
random on some training rocks: the configuration with the best posterior mean is recommended, its gain on the next rock is
stated, and looked up on every rock that was left out.
All of it is the low-fidelity simulator's, and no default was chosen by it.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import itertools
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from nbv.config import preset
from nbv.geometric import run_geometric_mission
from nbv.rocks import list_rocks
from tuner.campaign.rock_choice import QUICK_ROCKS, procedural_rocks
from tuner.problem.observations import Observation
from tuner.problem.search_space import Values
from tuner.problem.space_files import load_search_space
from tuner.recommendation.next_rock import next_rock
from tuner.samplers.design import near_default, sobol_point
from tuner.surrogate.model import InstanceMeanGP
from tuner.surrogate.settings import surrogate_settings

SPACES = ("beyond_paper", "few_photographs")
SEEDS, WIDTH = ("d95_m", "box_points", "mean_spacing_m", "mean_track_length"), 0.6
CONFIGURATIONS, REPLICATES = 48, 2
BUDGET, OF_DEFAULT = 64, 4
SIZES, FIXED_SEEDS = (1, 2, 4, 8, 12), 12
JUDGED_SIZES, JUDGED_SEEDS = (4, 8, 12), 8
METRIC = "observable.f_score_48mm"
HEAD = ("space", "configuration", "rock", "replicate", "f_score_48mm")
Bank = dict[tuple[int, str, int], float]  # configuration, rock, replicate; nan: failed


def procedural() -> list[str]:
    """Of both splits."""
    return [info.name for info in list_rocks() if info.source == "procedural"]


def configurations(space: str) -> list[Values]:
    """The default, then in turn a point near it and one anywhere."""
    loaded = load_search_space(space)
    default = loaded.default(preset("campaign"))
    others = [
        near_default(loaded, default, 0, i // 2) if i % 2 else sobol_point(loaded, 0, i // 2)
        for i in range(CONFIGURATIONS - 1)
    ]
    return [default, *others]


def read(path: Path) -> Iterator[tuple[str, int, str, int, float]]:
    """Rows of the bank; none where there is no file."""
    if path.is_file():
        with path.open(newline="") as file:
            for r in csv.DictReader(file):
                value = float(r[HEAD[4]] or "nan")
                yield r["space"], int(r["configuration"]), r["rock"], int(r["replicate"]), value


def run_missions(path: Path, files: list[str], spaces: list[str]) -> None:
    """Append what is missing in the bank."""
    there = {row[:4] for row in read(path)}
    rocks = procedural() + files
    began = time.time()
    with path.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if not there:
            writer.writerow(HEAD)
        for space in spaces:
            loaded, values = load_search_space(space), configurations(space)
            for rock in rocks:
                for i, k in np.ndindex(CONFIGURATIONS, REPLICATES):
                    name = Path(rock).stem
                    if (space, i, name, k) in there:
                        continue
                    result = run_geometric_mission(loaded.config(preset("campaign"), values[i]), rock, k)
                    failed = result.status == "failed"
                    writer.writerow([space, i, name, k, "" if failed else f"{result.metric(METRIC):.4f}"])
                file.flush()
                print(f"{space}: {rock} after {time.time() - began:.0f} s", flush=True)


def gains(bank: Bank, best: int, rock: str) -> float:
    """Mean gain of a configuration over the default on a rock; nan where a mission failed."""
    return float(np.mean([bank[best, rock, k] - bank[0, rock, k] for k in range(REPLICATES)]))


def play(bank: Bank, space: str, training: list[str], seed: int, drawn: bool = True) -> dict[str, Any]:
    """One campaign on ``training``: what it states, and what is true on the other rocks."""
    loaded, values = load_search_space(space), configurations(space)
    others = sorted({rock for _, rock, _ in bank} - set(training))
    own = [key for key in bank if key[1] in training]
    rng = np.random.default_rng([seed, len(training)])
    of_default = rng.permutation([j for j, key in enumerate(own) if key[0] == 0])[:OF_DEFAULT]
    rest = rng.permutation([j for j, key in enumerate(own) if key[0] > 0])[: BUDGET - len(of_default)]
    missions = [own[j] for j in (*of_default, *rest)]
    history = [
        Observation(n, values[i], rock, k, None if np.isnan(bank[i, rock, k]) else bank[i, rock, k])
        for n, (i, rock, k) in enumerate(missions)
    ]
    settings = surrogate_settings(loaded)
    model = InstanceMeanGP(loaded, history, training, settings)
    evaluated = sorted({i for i, rock, k in missions if not np.isnan(bank[i, rock, k])})
    best = evaluated[int(model.posterior([values[i] for i in evaluated]).mean.argmax())]
    departing = InstanceMeanGP(loaded, history, training, dataclasses.replace(settings, own_landscapes=True))
    stated = next_rock(departing, values[best], values[0])
    low, high = stated.interval_95
    true = np.array([gains(bank, best, rock) for rock in others])
    return {
        "space": space,
        "training": "drawn" if drawn else " ".join(training),
        "training_rocks": len(training),
        "seed": seed,
        "configuration": best,
        "gain": float(np.nanmean(true)),
        "worst_rock": float(np.nanmin(true)),
        "stated": stated.gain,
        "low": low,
        "high": high,
        "others": int((~np.isnan(true)).sum()),
        "inside": int(((true >= low) & (true <= high)).sum()),
    }


def summary(rows: list[dict[str, Any]]) -> None:
    """One line per space and training set; ± is the standard error over campaigns."""
    print("| space | training rocks | gain on the others | worst rock | stated | half-width | covered |")
    for which in dict.fromkeys((r["space"], r["training"], r["training_rocks"]) for r in rows):
        own = [r for r in rows if (r["space"], r["training"], r["training_rocks"]) == which]
        mean = {
            key: np.mean([r[key] for r in own]) for key in ("gain", "worst_rock", "stated", "low", "high")
        }
        error = np.std([r["gain"] for r in own], ddof=1) / len(own) ** 0.5
        said = [r for r in own if r["configuration"]]  # of the default nothing is stated
        inside, of = sum(r["inside"] for r in said), sum(r["others"] for r in said)
        print(
            f"| {which[0]} | {which[2]} {which[1]} | {mean['gain']:+.2f} ± {error:.2f} | {mean['worst_rock']:+.2f} | "
            f"{mean['stated']:+.2f} | {(mean['high'] - mean['low']) / 2:.2f} | {inside} of {of}, {100 * inside / max(1, of):.0f} % |"
        )


def campaigns(bank_file: Path, out: Path, spaces: list[str], most: int) -> None:
    """Play all campaigns: as many of each size as there are rocks, each left out of one; then on what the product tunes on."""
    rows = []
    for space in spaces:
        bank = {(i, rock, k): value for own, i, rock, k, value in read(bank_file) if own == space}
        rocks = sorted({rock for _, rock, _ in bank})
        for size in (*SIZES, len(rocks) - 1):
            for seed, left_out in enumerate(rocks[:most]):
                rest = np.random.default_rng(seed).permutation([r for r in rocks if r != left_out])
                rows.append(play(bank, space, [str(r) for r in rest[:size]], seed))
        for training in (QUICK_ROCKS, procedural_rocks("train")):
            rows += [play(bank, space, training, seed, drawn=False) for seed in range(min(most, FIXED_SEEDS))]
        print(f"{space}: played", flush=True)
    write(out, rows, "w")
    summary(rows)


def judged(bank_file: Path, out: Path, spaces: list[str], on: list[str]) -> None:
    """Append campaigns on some of the other rocks that are judged on these alone."""
    rows = []
    for space, size, seed in itertools.product(spaces, JUDGED_SIZES, range(JUDGED_SEEDS)):
        bank = {(i, rock, k): value for own, i, rock, k, value in read(bank_file) if own == space}
        rest = np.random.default_rng([seed, size]).permutation(sorted({r for _, r, _ in bank} - set(on)))
        training = [str(r) for r in rest[:size]]
        kept = {key: value for key, value in bank.items() if key[1] in (*training, *on)}
        rows.append(play(kept, space, training, seed) | {"training": f"drawn, judged on {len(on)} others"})
    write(out, rows, "a")
    summary(rows)


def write(out: Path, rows: list[dict[str, Any]], mode: str) -> None:
    """To a CSV file, or after what it has."""
    with out.open(mode, newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        if mode == "w":
            writer.writeheader()
        writer.writerows(
            {k: f"{v:.3f}" if isinstance(v, float) else v for k, v in row.items()} for row in rows
        )


def seeds(space: str, rocks: list[str]) -> dict[str, np.ndarray]:
    """Per rock the logarithms of what the default's first sparse model shows: spacing of points, their number, track lengths."""
    loaded = load_search_space(space)
    config = loaded.config(preset("campaign"), loaded.default(preset("campaign")))
    return {
        Path(rock).stem: np.mean(
            [
                [np.log(run_geometric_mission(config, rock, k).trace[0].features[name]) for name in SEEDS]
                for k in range(REPLICATES)
            ],
            axis=0,
        )
        for rock in rocks
    }


def rule(path: Path, files: list[str], space: str) -> None:
    """Gain over the common best of the other rocks, t intervals over rocks."""
    context = seeds(space, procedural() + files)
    bank = {(i, rock, k): value for own, i, rock, k, value in read(path) if own == space}
    rocks = sorted({rock for _, rock, _ in bank})
    values = np.array(
        [[[bank[i, r, k] for k in range(REPLICATES)] for r in rocks] for i in range(CONFIGURATIONS)]
    )
    means, looks = values.mean(axis=2), np.array([context[rock] for rock in rocks])
    looks = (looks - looks.mean(axis=0)) / looks.std(axis=0)
    found: dict[str, list[float]] = {}
    for r in range(len(rocks)):
        others = np.arange(len(rocks)) != r
        common = (means - means[0])[:, others].mean(axis=1).argmax()
        for name, columns in {
            **{name: [i] for i, name in enumerate(SEEDS)},
            "all of them": [*range(len(SEEDS))],
        }.items():
            weight = np.exp(-((looks[others] - looks[r])[:, columns] ** 2).mean(axis=1) / (2 * WIDTH**2))
            chosen = ((means - means[0])[:, others] @ weight).argmax()
            found.setdefault(f"by {name}", []).append(means[chosen, r] - means[common, r])
        own = [
            values[values[:, r, k].argmax(), r, 1 - k] - values[common, r, 1 - k] for k in range(REPLICATES)
        ]
        found.setdefault("best on that rock, chosen on one replicate, judged on the other", []).append(
            float(np.mean(own))
        )
    for name, gain in found.items():
        half = stats.t.ppf(0.975, len(gain) - 1) * np.std(gain, ddof=1) / len(gain) ** 0.5
        print(f"{name}: {np.mean(gain):+.3f} [{np.mean(gain) - half:+.3f}, {np.mean(gain) + half:+.3f}]")


def main() -> None:
    """Fly the bank or play campaigns from it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=("fly", "play", "rule"))
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--rock", action="append", default=[], help="further rock file to fly on")
    parser.add_argument("--judge", nargs="+", default=[], help="with play: rocks that no campaign trains on")
    parser.add_argument("--space", nargs="+", choices=SPACES, default=[*SPACES])
    parser.add_argument("--most", type=int, default=1000, help="campaigns of each kind at most")
    parser.add_argument("--out", type=Path, default=Path("next_rock.csv"))
    arguments = parser.parse_args()
    if arguments.what == "fly":
        run_missions(arguments.bank, arguments.rock, arguments.space)
    elif arguments.what == "rule":
        for space in arguments.space:
            rule(arguments.bank, arguments.rock, space)
    elif arguments.judge:
        judged(arguments.bank, arguments.out, arguments.space, arguments.judge)
    else:
        campaigns(arguments.bank, arguments.out, arguments.space, arguments.most)


if __name__ == "__main__":
    main()
