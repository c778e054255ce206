"""Problems on which optimisers are compared: a configuration, a rock and a replicate give a value at a cost.

A problem is made for one seed (``make_problem(name, seed)``) and is a pure function from then on: the same
(configuration, rock, replicate) gives the same value whoever asks. Larger is better everywhere.

``hartmann6``, ``ackley10``, ``levy10``
    Standard functions in 10 dimensions on one "rock", oriented to be maximised and divided by their standard
    deviation over the cube; ``:NOISE`` is the noise's share of that standard deviation. Hartmann-6 leaves four
    dimensions without effect. The optima of Ackley and Levy are moved to a random place of the middle half of the
    cube, the first point is random: no sampler profits from the centre.
``four-rocks``
    Hartmann-6 in 10 dimensions on four rocks with their own shift (up to 0.08), scale and offset; noise 0.1 per
    mission, ``:BLOCK_SD`` the offset that all missions on one (rock, replicate) share.
``geometric``
    Missions of the geometric fidelity at the campaign preset; ``:SPACE`` is the search space, ``:SPACE:PRICE`` what a
    photograph costs in points. Space ``photographs`` has the dense stage of ``make tune``.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from nbv.types import Floats
from tuner.problem.search_space import Parameter, SearchSpace, Values

ROCK = "one"
ROCKS = ("boulder", "waist", "cavern", "breccia")
TRUTH_REPLICATES = 4
FIRST_TRUTH_REPLICATE = 1000  # no campaign runs these


@dataclass(frozen=True)
class Flight:
    """What one mission gave."""

    value: float | None  # larger is better; None: failed
    cost: float = 1.0  # in missions of the full fidelity


class Problem(Protocol):
    """One problem for one seed."""

    name: str
    space: SearchSpace
    rocks: tuple[str, ...]
    replicates: int
    default: Values  # where every sampler starts
    best: float | None  # largest truth there is, where known
    budget: int  # missions
    trusted_default: bool  # chosen by hand, not a random place

    def run(self, values: Values, rock: str, replicate: int) -> Flight:
        """One mission."""
        ...

    def truth(self, values: Values) -> float:
        """The noiseless mean over rocks."""
        ...


def normal(*key: object) -> float:
    """A standard normal number, a function of ``key``."""
    digest = hashlib.sha256(repr(key).encode()).digest()
    return float(np.random.default_rng(int.from_bytes(digest[:8], "little")).normal())


# -- functions with known optima -----------------------------------------------------------------------------

_ALPHA = np.array([1.0, 1.2, 3.0, 3.2])
_A = np.array(
    [
        [10, 3, 17, 3.5, 1.7, 8],
        [0.05, 10, 17, 0.1, 8, 14],
        [3, 3.5, 1.7, 10, 17, 8],
        [17, 8, 0.05, 10, 0.1, 14],
    ]
)
_P = 1e-4 * np.array(
    [
        [1312, 1696, 5569, 124, 8283, 5886],
        [2329, 4135, 8307, 3736, 1004, 9991],
        [2348, 1451, 3522, 2883, 3047, 6650],
        [4047, 8828, 8732, 5743, 1091, 381],
    ]
)
HARTMANN_BEST = 3.32237
_HARTMANN_MEAN, _HARTMANN_SD = 0.26, 0.38  # over the cube


def hartmann6(x: Floats) -> Floats:
    """(...,) Hartmann-6, sign changed, of the first six of (..., d >= 6) coordinates in [0, 1]."""
    distance = (_A * (x[..., None, :6] - _P) ** 2).sum(-1)
    return np.asarray((_ALPHA * np.exp(-distance)).sum(-1))


def ackley(x: Floats) -> Floats:
    """(...,) minus Ackley's function of (..., d) coordinates, 0 at the origin."""
    root = np.sqrt((x**2).mean(-1))
    return np.asarray(20 * np.exp(-0.2 * root) + np.exp(np.cos(2 * math.pi * x).mean(-1)) - 20 - math.e)


def levy(x: Floats) -> Floats:
    """(...,) minus Levy's function of (..., d) coordinates, 0 at (1, ..., 1)."""
    w = 1 + (x - 1) / 4
    inner = ((w[..., :-1] - 1) ** 2 * (1 + 10 * np.sin(math.pi * w[..., :-1] + 1) ** 2)).sum(-1)
    last = (w[..., -1] - 1) ** 2 * (1 + np.sin(2 * math.pi * w[..., -1]) ** 2)
    return np.asarray(-(np.sin(math.pi * w[..., 0]) ** 2 + inner + last))


def cube(dimension: int) -> SearchSpace:
    """A search space that is the unit cube."""
    return SearchSpace("cube", tuple(Parameter(f"x{i}", "float", 0.0, 1.0) for i in range(dimension)))


_SCALE_SAMPLE = 20_000


@dataclass(frozen=True)
class FunctionProblem:
    """A standard function on one rock."""

    name: str
    function: Callable[[Floats], Floats]  # of (..., d) unit positions, raw unit
    best_raw: float
    noise: float  # share of the function's standard deviation
    seed: int
    dimension: int = 10
    budget: int = 60
    replicates: int = 1
    rocks: tuple[str, ...] = (ROCK,)
    trusted_default: bool = False

    @functools.cached_property
    def space(self) -> SearchSpace:
        """The unit cube."""
        return cube(self.dimension)

    @functools.cached_property
    def _scale(self) -> float:
        points = np.random.default_rng(0).random((_SCALE_SAMPLE, self.dimension))
        return float(self.function(points).std())

    @property
    def best(self) -> float:
        """The optimum, in standard deviations."""
        return self.best_raw / self._scale

    @functools.cached_property
    def default(self) -> Values:
        """A random place."""
        return self.space.from_unit(np.random.default_rng([self.seed, 1]).random(self.dimension))

    def truth(self, values: Values) -> float:
        """Noiseless, in standard deviations of the function over the cube."""
        return float(self.function(self.space.to_unit(values))) / self._scale

    def run(self, values: Values, rock: str, replicate: int) -> Flight:
        """With noise."""
        draw = normal("noise", self.seed, sorted(values.items()), replicate)
        return Flight(self.truth(values) + self.noise * draw)


@dataclass(frozen=True)
class FourRocks:
    """Hartmann-6 in ten dimensions on four correlated rocks."""

    seed: int
    block_sd: float = 0.0
    noise: float = 0.1
    shift: float = 0.08
    budget: int = 64
    replicates: int = 2
    rocks: tuple[str, ...] = ("r0", "r1", "r2", "r3")
    best: float | None = None  # not known: the shifts move it; below Hartmann's 3.32
    trusted_default: bool = False

    @property
    def name(self) -> str:
        """With its block offsets."""
        return f"four-rocks:{self.block_sd:g}"

    @functools.cached_property
    def space(self) -> SearchSpace:
        """The unit cube."""
        return cube(10)

    @functools.cached_property
    def default(self) -> Values:
        """A random place."""
        return self.space.from_unit(np.random.default_rng([self.seed, 1]).random(10))

    @functools.cached_property
    def _rocks(self) -> dict[str, tuple[Floats, float, float]]:
        rng = np.random.default_rng([self.seed, 2])
        return {
            rock: (rng.uniform(-self.shift, self.shift, 6), rng.uniform(0.7, 1.4), rng.normal())
            for rock in self.rocks
        }

    def _on_rock(self, values: Values, rock: str) -> float:
        shift, scale, offset = self._rocks[rock]
        return offset + scale * float(hartmann6(self.space.to_unit(values)[:6] + shift))

    def truth(self, values: Values) -> float:
        """Mean over rocks without their offsets, divided by their mean scale: 3.32 is the upper limit."""
        offsets = np.mean([self._rocks[rock][2] for rock in self.rocks])
        scale = np.mean([self._rocks[rock][1] for rock in self.rocks])
        return float((np.mean([self._on_rock(values, rock) for rock in self.rocks]) - offsets) / scale)

    def run(self, values: Values, rock: str, replicate: int) -> Flight:
        """With noise and the block's offset."""
        noise = self.noise * normal("noise", self.seed, sorted(values.items()), rock, replicate)
        block = self.block_sd * normal("slot", self.seed, rock, replicate)
        return Flight(self._on_rock(values, rock) + self._rocks[rock][1] * (noise + block))


# -- geometric missions --------------------------------------------------------------------------------------


class Memo:
    """Outcomes of geometric missions, by configuration, rock and replicate, in a file."""

    def __init__(self, path: Path, version: str) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._connection = sqlite3.connect(path, timeout=60)
        self._version = version
        with self._connection:
            self._connection.execute("create table if not exists flown (key text primary key, outcome text)")

    def get(self, key: str, run_missions: Callable[[], dict[str, Any] | None]) -> dict[str, Any] | None:
        """What is stored under ``key``, run if nothing is."""
        key = f"{self._version}/{key}"
        row = self._connection.execute("select outcome from flown where key = ?", (key,)).fetchone()
        if row is None:
            outcome = run_missions()
            with self._connection:
                self._connection.execute(
                    "insert or replace into flown values (?, ?)", (key, json.dumps(outcome))
                )
            return outcome
        stored: dict[str, Any] | None = json.loads(row[0])
        return stored


def source_digest() -> str:
    """Of everything a geometric mission may depend on."""
    import nbv

    root = Path(str(nbv.__file__)).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


@dataclass
class GeometricProblem:
    """Geometric missions on training rocks; deterministic functions of (configuration, rock, replicate)."""

    space_name: str
    seed: int
    memo: Memo
    rocks: tuple[str, ...] = ROCKS
    metric: str = "observable.f_score_48mm"
    price: float = 0.0  # points a photograph
    budget: int = 64
    replicates: int = 2
    best: float | None = None
    trusted_default: bool = True
    space: SearchSpace = field(init=False)
    default: Values = field(init=False)
    name: str = field(init=False)

    def __post_init__(self) -> None:
        from nbv.config import preset
        from tuner.campaign.settings_file import QUICK
        from tuner.problem.space_files import load_search_space

        self.space = load_search_space(self.space_name)
        overrides = QUICK["overrides"] if self.space_name == QUICK["space"] else {}
        self._base = preset("campaign").with_values(self.space.base).with_values(overrides)
        self.default = self.space.default(self._base)
        self.name = f"geometric:{self.space_name}" + (f":{self.price:g}" if self.price else "")

    def metrics(self, values: Values, rock: str, replicate: int) -> dict[str, Any] | None:
        """``{"metrics": ..., "costs": ...}`` of one mission; None where it failed."""
        from nbv.errors import MissionFailure
        from nbv.geometric import run_geometric_mission

        config = self._base.with_values(self.space.complete(values))

        def run_missions() -> dict[str, Any] | None:
            try:
                result = run_geometric_mission(config, rock, replicate)
            except MissionFailure:
                return None
            if result.status == "failed":
                return None
            kept = {k: v for k, v in result.metrics["observable"].items() if isinstance(v, float)}
            costs = {key: result.costs[key] for key in ("flight_time_s", "images")}
            return {"observable": kept, **costs}

        return self.memo.get(f"{config.digest()}/{Path(rock).stem}/{replicate}", run_missions)

    def run(self, values: Values, rock: str, replicate: int) -> Flight:
        """The metric, in percent, less what the photographs cost."""
        outcome = self.metrics(values, rock, replicate)
        group, name = self.metric.split(".")
        # A campaign's replicates differ between seeds, as another campaign's would.
        if outcome is None:
            return Flight(None)
        return Flight(float(outcome[group][name]) - self.price * float(outcome["images"]))

    def truth(self, values: Values) -> float:
        """Mean over rocks of fresh replicates; a failed mission counts as 0."""
        flights = [
            self.run(values, rock, FIRST_TRUTH_REPLICATE + k).value
            for rock in self.rocks
            for k in range(TRUTH_REPLICATES)
        ]
        return float(np.mean([0.0 if value is None else value for value in flights]))


# -- by name -------------------------------------------------------------------------------------------------


def make_problem(
    name: str, seed: int, memo: Path, rocks: Sequence[str] = ROCKS, budget: int | None = None
) -> Problem:
    """The problem called ``name`` (``hartmann6:0.1``, ``four-rocks:0``, ``geometric:full``, ...) for a seed.

    ``memo`` is the file of geometric outcomes. ``ValueError`` for an unknown name.
    """
    kind, _, option = name.partition(":")
    limit: dict[str, Any] = {} if budget is None else {"budget": budget}
    if kind == "four-rocks":
        return FourRocks(seed, float(option or 0.0), **limit)
    if kind == "geometric":
        space, _, price = option.partition(":")
        return GeometricProblem(
            space or "gate_and_weights",
            seed,
            Memo(memo, source_digest()),
            tuple(rocks),
            price=float(price or 0.0),
            **limit,
        )
    noise = float(option or 0.1)
    at = np.random.default_rng([seed, 3]).uniform(0.25, 0.75, 10)
    functions: dict[str, tuple[Callable[[Floats], Floats], float]] = {
        "hartmann6": (hartmann6, HARTMANN_BEST),
        "ackley10": (lambda u: ackley(65.536 * (u - at)), 0.0),
        "levy10": (lambda u: levy(1 + 20 * (u - at)), 0.0),
    }
    if kind not in functions:
        raise ValueError(f"unknown problem {name!r}; there are {', '.join(functions)}, four-rocks, geometric")
    function, best = functions[kind]
    return FunctionProblem(f"{kind}:{noise:g}", function, best, noise, seed, **limit)
