"""How well geometric missions rank configurations, against photogrammetric missions that others have flown.

    OMP_NUM_THREADS=1 python -m research.geometric_calibration runs/noise-08 runs/noise-full \\
        --calibrated slab cavern --replicates 4 --work runs/geometric-calibration

Reads the missions below some folders (studies, campaigns, evaluations), flies the same configurations
geometrically, and prints a table and draws a figure, per strictness level of the fusion:

* end to end: Spearman's rank correlation of the configurations' means, the geometric mission having chosen its
  own views; and how alike two photogrammetric replicates are (no stand-in can do better than these allow);
* same views: the prediction for the very views that photogrammetry chose, so planning plays no part.

Intervals are 95 % bootstrap percentiles over configurations. Nothing is fitted here: the constants of
`nbv.geometric.completeness.DenseModel` come from ``research/geometric_fit.py``. Oracles are left out: they
read the ground truth; learned gates too: their policies are files. Geometric choices are kept under ``--work``, so an
interrupted run goes on.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.stats import rankdata, spearmanr
from threadpoolctl import threadpool_limits

from nbv.config import MissionConfig, config_from_dict, preset
from nbv.geometric import predict_views, run_geometric_mission
from nbv.mission.run_directory import write_atomic
from nbv.photogrammetric import run_photogrammetric_mission
from nbv.types import Floats

METRIC = "f_score_48mm"
BOOTSTRAP = 1000
APOLLO = "../shared/rocks"
NOT_REPEATABLE = ("hyb-o", "greedy-oracle", "learned")  # they read the ground truth, or a file


@dataclass(frozen=True)
class Flight:
    """One photogrammetric mission."""

    digest: str
    rock: str  # catalogue name or path
    replicate: int
    values: dict[str, float]  # by strictness level
    chosen: tuple[str, ...]


@dataclass(frozen=True)
class Cell:
    """Values of complete configurations: (configurations, rocks, replicates)."""

    digests: list[str]
    rocks: list[str]
    replicates: list[int]
    measured: Floats
    end_to_end: Floats  # replicates are the geometric ones
    same_views: Floats


def read_flights(
    directories: Sequence[Path], levels: Sequence[str], rocks: Sequence[str], budget: int
) -> tuple[list[Flight], dict[str, MissionConfig]]:
    """The flights below ``directories`` on ``rocks``, and their configurations by digest.

    Failed missions and other adaptive budgets are left out. Noise studies measured every level; of other missions
    only the configured level is known. Strictness does not change a flight, so it does not count as a difference
    between configurations.
    """
    flights, configs = [], {}
    by_stem = {Path(rock).stem: rock for rock in rocks}
    for path in sorted(p for directory in directories for p in directory.rglob("mission.json")):
        mission = json.loads(path.read_text())
        if mission["status"] == "failed" or Path(mission["rock"]).stem not in by_stem:
            continue
        tree = yaml.load((path.parent / "config.yaml").read_text(), Loader=yaml.CSafeLoader)
        config = config_from_dict(tree)
        if config.gate.kind in NOT_REPEATABLE or config.stop.adaptive_budget != budget:
            continue
        metrics = mission["metrics"]
        measured = metrics.get("agreement", {str(config.dense.agreeing_views): metrics})
        values = {k: measured[k]["observable"][METRIC] for k in levels if "observable" in measured.get(k, {})}
        config = config.with_values({"dense.agreeing_views": 3})
        configs[config.digest()] = config
        flights.append(
            Flight(
                config.digest(),
                by_stem[Path(mission["rock"]).stem],
                mission["replicate"],
                values,
                tuple(t["chosen"] for t in mission["trace"]),
            )
        )
    return flights, configs


def fly_missing(
    flights: Sequence[Flight],
    configs: dict[str, MissionConfig],
    rocks: Sequence[str],
    wanted: int,
    level: str,
    directory: Path,
) -> None:
    """Photogrammetric missions, replicate 0, until ``wanted`` configurations are known on all ``rocks``.

    Those that were flown on most of the rocks come first.
    """
    flown = {
        d: {f.rock for f in flights if f.digest == d and f.replicate == 0 and level in f.values}
        for d in configs
    }
    flown = {d: where & set(rocks) for d, where in flown.items()}
    for digest in sorted(flown, key=lambda d: (-len(flown[d]), d))[:wanted]:
        config = configs[digest].with_values({"dense.agreeing_views": int(level)})
        for rock in sorted(set(rocks) - flown[digest]):
            result = run_photogrammetric_mission(
                config, rock, 0, directory / f"{digest}_{Path(rock).stem}_{level}", keep="summary"
            )
            print(f"flown: {digest} on {Path(rock).stem}, {result.status}", flush=True)


class GeometricChoices:
    """The views that geometric missions choose, kept in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[str, list[str]] = json.loads(path.read_text()) if path.exists() else {}

    def get(self, config: MissionConfig, rock: str, replicate: int) -> tuple[str, ...]:
        key = f"{config.digest()} {Path(rock).stem} {replicate}"
        if key not in self._known:
            trace = run_geometric_mission(config, rock, replicate).trace
            self._known[key] = [t.chosen for t in trace]
            if len(self._known) % 50 == 0:
                self.save()
        return tuple(self._known[key])

    def save(self) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(self._path, json.dumps(self._known))


def predicted(level: str) -> Callable[[str, tuple[str, ...], int], float]:
    """Predicted score of a set of views at a strictness level, remembered."""
    config = preset("campaign").with_values({"dense.agreeing_views": int(level)})
    known: dict[tuple[str, tuple[str, ...], int], float] = {}

    def value(rock: str, chosen: tuple[str, ...], replicate: int) -> float:
        key = (rock, tuple(sorted(chosen)), replicate)
        if key not in known:
            known[key] = float(predict_views(config, rock, key[1], replicate)["observable"][METRIC])
        return known[key]

    return value


def cell(
    flights: Sequence[Flight],
    configs: dict[str, MissionConfig],
    rocks: Sequence[str],
    measured_replicates: Sequence[int],
    geometric_replicates: int,
    level: str,
    choices: GeometricChoices,
    value: Callable[[str, tuple[str, ...], int], float],
) -> Cell:
    """Everything about the configurations that were flown on all ``rocks`` with all replicates."""
    by_key = {(f.digest, f.rock, f.replicate): f for f in flights if level in f.values}
    digests = [
        d
        for d in sorted({f.digest for f in flights})
        if all((d, r, k) in by_key for r in rocks for k in measured_replicates)
    ]
    mine = [[[by_key[d, r, k] for k in measured_replicates] for r in rocks] for d in digests]
    return Cell(
        digests,
        list(rocks),
        list(measured_replicates),
        np.array([[[f.values[level] for f in row] for row in group] for group in mine]),
        np.array(
            [
                [
                    [value(r, choices.get(configs[d], r, k), k) for k in range(geometric_replicates)]
                    for r in rocks
                ]
                for d in digests
            ]
        ),
        np.array([[[value(f.rock, f.chosen, f.replicate) for f in row] for row in group] for group in mine]),
    )


def correlation(a: Floats, b: Floats) -> float:
    """Spearman's rank correlation; NaN for fewer than 3 pairs."""
    return float(spearmanr(a, b).statistic) if len(a) >= 3 else float("nan")


def with_interval(a: Floats, b: Floats) -> str:
    """Correlation and its 95 % bootstrap interval over configurations."""
    draws = np.random.default_rng(0).integers(0, len(a), (BOOTSTRAP, len(a)))
    x, y = (rankdata(values[draws], axis=1) for values in (a, b))
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        each = (x * y).sum(axis=1) / np.sqrt((x**2).sum(axis=1) * (y**2).sum(axis=1))
    low, high = np.nanpercentile(each, [2.5, 97.5])
    return f"**{correlation(a, b):.2f}** ({low:.2f} to {high:.2f})"


def row(name: str, group: str, c: Cell) -> str:
    """A line of the table."""
    truth = c.measured.mean(axis=(1, 2))
    alike, ceiling = "", ""
    if len(c.replicates) == 2:
        r = correlation(c.measured[:, :, 0].mean(axis=1), c.measured[:, :, 1].mean(axis=1))
        alike, ceiling = f"{r:.2f}", f"{np.sqrt(max(0.0, 2 * r / (1 + r))):.2f}"
    bias = float((c.same_views - c.measured).mean())
    return (
        f"| {name} | {group} | {len(c.digests)} | {len(c.replicates)} | {with_interval(truth, c.end_to_end.mean(axis=(1, 2)))} |"
        f" {with_interval(truth, c.same_views.mean(axis=(1, 2)))} | {alike} | {ceiling} |"
        f" {truth.std():.2f} | {bias:+.2f} |"
    )


def mean_over_rocks(
    cells: Sequence[Cell], rng: np.random.Generator, of: Callable[[Cell], Floats]
) -> tuple[float, float, float]:
    """Mean over rocks, one cell each, of the rank correlation with what was measured; bootstrap interval."""

    def once(draws: Sequence[NDArray[np.int64]]) -> float:
        return float(
            np.mean(
                [
                    correlation(c.measured.mean(axis=(1, 2))[d], of(c).mean(axis=(1, 2))[d])
                    for c, d in zip(cells, draws)
                ]
            )
        )

    counts = [len(c.digests) for c in cells]
    draws = [once([rng.integers(0, n, n) for n in counts]) for _ in range(BOOTSTRAP)]
    low, high = np.nanpercentile(draws, [2.5, 97.5])
    return once([np.arange(n) for n in counts]), float(low), float(high)


def rock_by_rock(name: str, group: str, singles: Sequence[Cell], doubles: Sequence[Cell]) -> str:
    """A line for the mean of the rocks' own correlations, each over all configurations that the rock saw.

    ``doubles`` are the cells with two measured replicates, of the rocks that have enough of them.
    """
    rng = np.random.default_rng(0)
    parts = [
        "**{:.2f}** ({:.2f} to {:.2f})".format(*mean_over_rocks(singles, rng, of))
        for of in (lambda c: c.end_to_end, lambda c: c.same_views)
    ]
    alike, bound = "", ""
    if doubles:
        each = [correlation(c.measured[:, 0, 0], c.measured[:, 0, 1]) for c in doubles]
        r = float(np.mean(each))
        rocks = ", ".join(Path(c.rocks[0]).stem for c in doubles)
        alike, bound = f"{r:.2f} ({rocks})", f"{np.sqrt(max(0.0, r)):.2f}"
    counts = sorted(len(c.digests) for c in singles)
    return (
        f"| {name} | {group} | {counts[0]} to {counts[-1]} | 1 | {parts[0]} | {parts[1]} | {alike} | {bound} |"
        f" {np.mean([c.measured.std() for c in singles]):.2f} |"
        f" {np.mean([(c.same_views - c.measured).mean() for c in singles]):+.2f} |"
    )


def scatter(cells: dict[str, Cell], path: Path) -> None:
    """Measured against predicted configuration means, a panel per strictness level."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(
        2, len(cells), figsize=(3.4 * len(cells), 6.4), squeeze=False, layout="constrained"
    )
    for column, (level, c) in enumerate(cells.items()):
        truth = c.measured.mean(axis=(1, 2))
        for ax, values, title in (
            (axes[0, column], c.same_views, "same views"),
            (axes[1, column], c.end_to_end, "end to end"),
        ):
            guess = values.mean(axis=(1, 2))
            ax.plot(guess, truth, "o", ms=4, alpha=0.8)
            ax.set_title(f"{title}, {level} agreeing views: {correlation(truth, guess):.2f}", fontsize=9)
            ax.set_xlabel("geometric F-score @ 48 mm (%)", fontsize=8)
            ax.set_ylabel("photogrammetric (%)", fontsize=8)
            ax.tick_params(labelsize=7)
            ax.grid(alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(path, dpi=130)


def report(
    flights: Sequence[Flight],
    configs: dict[str, MissionConfig],
    calibrated: Sequence[str],
    geometric_replicates: int,
    levels: Sequence[str],
    choices: GeometricChoices,
    figure: Path,
    most: Sequence[str],
) -> str:
    """The Markdown table; writes the figure. ``most`` are the rocks whose means are correlated."""
    rocks = list(dict.fromkeys(f.rock for f in flights))
    groups = [(f"mean over {len(most)} rocks", "all", list(most))]
    for name, members in (
        ("calibrated on", [r for r in most if Path(r).stem in calibrated]),
        ("not calibrated on", [r for r in most if Path(r).stem not in calibrated]),
    ):
        groups.append((f"mean over {', '.join(Path(r).stem for r in members)}", name, members))
    groups += [
        (Path(r).stem, "calibrated on" if Path(r).stem in calibrated else "not calibrated on", [r])
        for r in rocks
    ]
    lines: list[str] = []
    panels: dict[str, Cell] = {}
    for level in levels:
        value = predicted(level)
        lines += [
            f"### {level} agreeing views",
            "",
            "| rocks | group | configurations | measured replicates | end to end | same views | two replicates of photogrammetry | best possible | sd between configurations | bias, same views |",
            "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|",
        ]
        for name, group, members in groups:
            if not members:
                continue
            for replicates in ([0, 1], [0]):
                c = cell(flights, configs, members, replicates, geometric_replicates, level, choices, value)
                if len(c.digests) >= 10:
                    lines.append(row(name, group, c))
                    if members == most and (
                        level not in panels or len(c.digests) > len(panels[level].digests)
                    ):
                        panels[level] = c
        for group in ("calibrated on", "not calibrated on"):
            own = [r for r in rocks if (Path(r).stem in calibrated) == (group == "calibrated on")]
            cells = {
                k: [
                    cell(flights, configs, [r], range(k), geometric_replicates, level, choices, value)
                    for r in own
                ]
                for k in (1, 2)
            }
            singles = [c for c in cells[1] if len(c.digests) >= 40]
            doubles = [c for c in cells[2] if len(c.digests) >= 10 and c.rocks in [s.rocks for s in singles]]
            if singles:
                name = f"each of {', '.join(Path(c.rocks[0]).stem for c in singles)} by itself, mean"
                lines.append(rock_by_rock(name, group, singles, doubles))
        lines.append("")
    scatter(panels, figure)
    choices.save()
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("studies", nargs="+", type=Path, help="folders with missions")
    parser.add_argument(
        "--together",
        nargs="+",
        default=["slab", "vesicular", "cavern", f"{APOLLO}/apollo_15016_0/apollo_15016_0.obj"],
        help="rocks over which configurations are averaged",
    )
    parser.add_argument(
        "--rocks",
        nargs="*",
        default=["breccia", f"{APOLLO}/apollo_65035_0/apollo_65035_0.obj"],
        help="further rocks",
    )
    parser.add_argument(
        "--fly",
        type=int,
        default=0,
        metavar="N",
        help="first fly until the first level is known of N configurations on all rocks of --together",
    )
    parser.add_argument(
        "--calibrated", nargs="*", default=["slab", "cavern"], help="rocks whose depth maps were fitted"
    )
    parser.add_argument(
        "--replicates", type=int, default=4, help="geometric replicates per configuration and rock"
    )
    parser.add_argument("--levels", nargs="+", default=["5", "6", "7"], help="dense.agreeing_views")
    parser.add_argument("--work", type=Path, default=Path("runs/geometric-calibration"))
    parser.add_argument("--out", type=Path, help="also write the table here")
    parser.add_argument("--figure", type=Path, default=Path("docs/images/geometric_fidelity_spread.png"))
    arguments = parser.parse_args()
    rocks = arguments.together + [r for r in arguments.rocks if r not in arguments.together]
    budget = 8
    folders = [*arguments.studies, arguments.work / "flown"]
    with threadpool_limits(1):
        flights, configs = read_flights(folders, arguments.levels, rocks, budget)
        if arguments.fly:
            fly_missing(flights, configs, arguments.together, arguments.fly, arguments.levels[0], folders[-1])
            flights, configs = read_flights(folders, arguments.levels, rocks, budget)
        print(f"{len(flights)} photogrammetric missions of {len(configs)} configurations", flush=True)
        text = report(
            flights,
            configs,
            arguments.calibrated,
            arguments.replicates,
            arguments.levels,
            GeometricChoices(arguments.work / "choices.json"),
            arguments.figure,
            arguments.together,
        )
    print(text)
    if arguments.out is not None:
        write_atomic(arguments.out, text + "\n")


if __name__ == "__main__":
    main()
