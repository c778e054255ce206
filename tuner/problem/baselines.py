"""The fixed strategies that a tuned configuration is compared with."""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from nbv.config import Condition, MissionConfig, SeedConfig, SparseConfig, gate_kinds, parameters, under
from nbv.errors import UserError
from nbv.gates import gate_class
from nbv.mission.target_prior import target_must_be_found
from tuner.problem.observations import mission_key
from tuner.problem.search_space import TUNED, TUNED_GATE, TUNED_PLANNER


@dataclass(frozen=True)
class Baseline:
    """A strategy: which ranking the mission runs, everything else as in the base configuration."""

    name: str
    label: str
    values: dict[str, Any] = field(default_factory=dict)  # further parameters of the strategy
    plans: bool = True  # False: all photographs are seeds on a plain orbit, and no view is planned
    recentred: bool = False  # of an orbit: its first half locates the target, its second half is moved there

    def config(self, base: MissionConfig) -> MissionConfig:
        """``base`` running this strategy; `UserError`, with the strategy's name, where it cannot."""
        if not self.plans:
            return self.orbit(base, base.photographs)
        if self.name in PAPER_STRATEGIES:
            base = base.changed(seed=paper_seeds(base.seed))
        return self._laid_over(base, {"gate.kind": self.name, **self.values})

    def _laid_over(self, base: MissionConfig, values: dict[str, Any]) -> MissionConfig:
        try:
            return base.with_values(values)
        except UserError as error:
            raise UserError(f"strategy {self.name} cannot run here: {error}") from error

    def orbit(self, base: MissionConfig, number: int) -> MissionConfig:
        """``base`` with ``number`` photographs on this plain orbit, as far away as its candidates."""
        values = {
            "photographs": number,
            "seeds": number,
            "seed.layout": "turn",
            "seed.radius_m": base.pool.radius_m,
            "seed.recentre_after": number // 2 if self.recentred else 0,
            **{f"sparse.{name}": value for name, value in _registering(base.sparse, number).items()},
        }
        return self._laid_over(base, {**values, **self.values})


# Parameters by what they change of a mission: the groups by which a gain is split.
OTHER = "other"
_GROUPS = {
    "scorer": ("gate.kind", "gate.geometry_scorer"),
    "thresholds": ("gate.",),
    "weights": ("covis.", "b_aware.", "predicted."),
    "seeds": ("seed", "sparse."),
    "pool": ("pool.",),
    "stop": ("stop.", "photographs"),
}
WITHOUT = "-without-"  # of a tuned configuration a group of parameters: the name of an ablation


def grouped(paths: Collection[str]) -> dict[str, tuple[str, ...]]:
    """Return the paths by group, in the order of the groups, without empty ones."""
    groups: dict[str, list[str]] = {name: [] for name in (*_GROUPS, OTHER)}
    for path in paths:
        group = next((name for name, begins in _GROUPS.items() if path.startswith(begins)), OTHER)
        groups[group].append(path)
    return {name: tuple(members) for name, members in groups.items() if members}


# Of the splits over 10 and 35 degrees these two were best on rocks that no other choice was made on.
ONE_RING: dict[str, Any] = {"seed.lowest_deg": 10.0, "seed.span_deg": 0.0, "seed.upper_share": 0.0}
MIDDLE_RING: dict[str, Any] = {**ONE_RING, "seed.lowest_deg": 15.0}
HIGH_RING: dict[str, Any] = {**ONE_RING, "seed.lowest_deg": 20.0}
TWO_RINGS: dict[str, Any] = {"seed.lowest_deg": 10.0, "seed.span_deg": 25.0, "seed.upper_share": 0.38}
FEWEST_SEEDS, GROUND_FEATURES = 6, 2000  # as in the search space photographs


def paper_seeds(seed: SeedConfig) -> SeedConfig:
    """The seeds on the paper's rings: shares of 8 : 6 : 6 : 4 at 15, 22, 29 and 36 degrees, 4 m away."""
    if seed.layout == "rings":
        return seed
    elevations_deg, counts = seed.ring_elevations_deg, seed.ring_azimuth_counts
    return SeedConfig(ring_elevations_deg=elevations_deg, ring_azimuth_counts=counts)


def _registering(sparse: SparseConfig, seeds: int) -> dict[str, int]:
    """Fields of `SparseConfig` that let so few seeds, so far apart, register."""
    return {
        "min_registered_seeds": min(sparse.min_registered_seeds, FEWEST_SEEDS, seeds),
        "ground_features": sparse.ground_features or GROUND_FEATURES,
    }


BASELINES: dict[str, Baseline] = {
    b.name: b
    for b in (
        Baseline("covis", "Covis"),  # co-visibility scorer alone (Eq. 5)
        Baseline("b-aware", "B-aware"),  # baseline-aware repair scorer alone (Eq. 6 to 8)
        Baseline("hyb-h", "Hyb-H"),  # heuristic gate at the paper's thresholds (Eq. 9)
        Baseline("hyb-o", "Hyb-O"),  # oracle gate, by the true surface
        Baseline("random", "Random views"),  # a feasible candidate at random
        Baseline("movement-only", "Movement only"),  # the feasible candidate nearest to the vehicle
        # The best single view by the true surface. The ceiling needs the reward that the dense stage pays back: docs/results/index.md.
        Baseline("greedy-oracle", "Greedy oracle", {"gate.oracle_coverage": "matchable"}),
        # The scorer alone: how much the predicted completeness would rise.
        Baseline(
            "predicted", "Predicted", {f"predicted.weights.{term}": 0.0 for term in ("nov", "move", "ang")}
        ),
        Baseline("orbit-middle", "Orbit at 15°", MIDDLE_RING, plans=False),
        Baseline("orbit", "Orbit at 10°", ONE_RING, plans=False),
        Baseline("orbit-high", "Orbit at 20°", HIGH_RING, plans=False),
        # 62 % of it at 10° and the rest at 35°.
        Baseline("orbit-two", "Orbit, two rings", TWO_RINGS, plans=False),
        # Their second halves are moved to the target that the first have located.
        Baseline("orbit-recentred", "Orbit, re-centred", ONE_RING, plans=False, recentred=True),
        Baseline(
            "orbit-two-recentred", "Orbit, two rings, re-centred", TWO_RINGS, plans=False, recentred=True
        ),
    )
}
PAPER_STRATEGIES = ("covis", "b-aware", "hyb-h", "hyb-o")
# What `gatetune evaluate` compares with unless told otherwise: the paper's four, *predicted*, random views, a planner that sees
# the true surface, and plain orbits.
ORBITS = ("orbit-middle", "orbit", "orbit-high", "orbit-two")
RECENTRED_ORBITS = ("orbit-recentred", "orbit-two-recentred")
# The plain plans that a campaign runs as trials where its space holds them.
ARMS = ("orbit-middle",)
EVALUATION_BASELINES = (*PAPER_STRATEGIES, "predicted", "random", "greedy-oracle", *ORBITS)
# What `gatetune reproduce` runs: Table I's columns, and the reference for the gates.
REPRODUCTION_STRATEGIES = (*PAPER_STRATEGIES, "greedy-oracle")
ANSWERS = (TUNED_GATE, TUNED_PLANNER, TUNED)
# Plans without tuning, from the simplest to fly: which one is flown where none is shown to be better. The orbit at 15 degrees is the
# best single plan over 34 training targets (docs/results/index.md).
SIMPLEST_FIRST = (
    *("orbit-middle", "orbit", "orbit-high", "orbit-two", "orbit-recentred", "orbit-two-recentred"),
    *("random", "default", "hyb-h", "covis", "b-aware", "movement-only", "predicted"),
)
PAPER, TUNED_KIND, CONTROLS, ORACLES = KINDS = ("the paper's", "tuned", "controls", "oracles")
# Labels of all strategies, in the order of tables.
_LABELS = {
    **{b.name: b.label for b in BASELINES.values()},
    TUNED_GATE: "Tuned gate",  # thresholds, weights and repairing scorer tuned; seeds as in the paper
    TUNED_PLANNER: "Tuned planner",  # seeds and pool tuned besides, at least three views planned
    TUNED: "Tuned",
    "default": "Default",  # the campaign's configuration with nothing tuned
}
# What a campaign ends in, beside its tuned configurations. In the order in which they are run: those that often choose the same
# views lie apart, so that the later finds all it needs.
COMPARISON = ("hyb-h", "covis", "orbit-middle", "random", "orbit", "orbit-high", "b-aware", "hyb-o")

# d95 of the sparse cloud is 0.15 to 0.5 m in flight; where it is infinite the gate asks for repair.
COARSEST_M = 1.0
PLANNER = ("gate", "covis", "b_aware", "predicted", "shared", "plugins")  # sections that choose views
# And those that say from where, and how many.
PLAN = (*PLANNER, "photographs", "seeds", "seed", "pool", "stop")


def baseline(name: str, also: Sequence[str] = ()) -> Baseline:
    """The baseline called ``name``; `UserError` where there is none, which lists those that there are ``also``."""
    if name not in BASELINES and name in gate_kinds():
        return Baseline(name, name)  # a plug-in's planner
    if name not in BASELINES:
        known = (*BASELINES, *also)
        close = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise UserError(
            f"unknown strategy {name!r}; {hint}there are {', '.join(known)}; "
            "a plug-in must be installed, or named with gatetune --plugin"
        )
    return BASELINES[name]


def scorer_alone(config: MissionConfig) -> str:
    """Return the scorer that chooses every view, where the thresholds of a Hyb-H gate never switch; else nothing."""
    gate = config.gate
    if gate.kind != "hyb-h" or not config.planned_views:
        return ""
    if gate.budget_fraction == 0 and gate.d95_m >= COARSEST_M:
        return "covis"
    return gate.geometry_scorer if gate.budget_fraction == 1 or gate.d95_m == 0 else ""


def reference_of(configs: Collection[str], usual: str) -> str:
    """What differences are taken from: the ``usual`` baseline, or the first that is run."""
    return usual if usual in configs else next(iter(configs))


def baseline_configs(names: tuple[str, ...] | list[str], base: MissionConfig) -> dict[str, MissionConfig]:
    return {name: baseline(name).config(base) for name in names}


def with_sections_of(source: MissionConfig, sections: Sequence[str], base: MissionConfig) -> MissionConfig:
    """``base`` with some of the sections of ``source``, such as `PLAN`."""
    return base.changed(**{name: getattr(source, name) for name in sections})


def at_equal_number(
    configs: dict[str, MissionConfig], tuned: MissionConfig, reference: str
) -> dict[str, MissionConfig]:
    """The baselines with the seeds and planned views of ``tuned``, and ``reference`` at its own number beside them.

    Names say the number, as in ``hyb-h-26``; where the number is the same anyway, ``configs`` as they are. Where ``tuned``
    plans no view, those that plan share the number out as they did before.
    """
    number = tuned.photographs
    if all(config.photographs == number for config in configs.values()):
        return configs
    equal = {f"{name}-{number}": _at_number(name, config, tuned) for name, config in configs.items()}
    return {reference: configs[reference], **equal}


def _at_number(name: str, config: MissionConfig, tuned: MissionConfig) -> MissionConfig:
    number = tuned.photographs
    if is_orbit(name):
        return BASELINES[name].orbit(config, number)
    seeds, seed = tuned.seeds, tuned.seed
    sparse = tuned.sparse  # what seeds far apart need to register
    if not tuned.planned_views:
        seeds = min(number, max(FEWEST_SEEDS, round(number * config.seeds / config.photographs)))
        seed = config.seed
        sparse = tuned.changed(sparse=_registering(sparse, seeds)).sparse
    if name in PAPER_STRATEGIES:
        seed = paper_seeds(seed)
    stop = {"criterion": "budget"}
    return config.changed(photographs=number, seeds=seeds, seed=seed, sparse=sparse, stop=stop)


def ending_at(config: MissionConfig, number: int) -> MissionConfig:
    """``config`` with so many photographs in every mission: its seeds, and planned views until the number is reached."""
    return config.changed(photographs=max(number, config.seeds), stop={"criterion": "budget"})


def orbits_at_number(tuned: MissionConfig, conditions: Iterable[Condition]) -> dict[str, MissionConfig]:
    """The plain orbits with as many photographs as ``tuned``, and re-centred ones where the target must be located."""
    number = tuned.photographs
    names = [*ORBITS, *(RECENTRED_ORBITS if target_must_be_located(tuned, conditions) else ())]
    return {f"{name}-{number}": BASELINES[name].orbit(tuned, number) for name in names}


def target_must_be_located(config: MissionConfig, conditions: Iterable[Condition]) -> bool:
    """Whether a mission must first locate its target under one of the conditions; elsewhere re-targeting changes no orbit."""
    return any(target_must_be_found(under(config, condition)) for condition in conditions)


def is_orbit(strategy: str) -> bool:
    """Whether a strategy, such as ``orbit`` or ``orbit-two-24``, is a plain orbit."""
    name, _ = _split(strategy)
    return name in BASELINES and not BASELINES[name].plans


def _split(strategy: str) -> tuple[str, str]:
    """``hyb-h`` and ``26`` of ``hyb-h-26``; the number is empty where there is none."""
    name, _, number = strategy.rpartition("-")
    return (name, number) if number.isdigit() and name in BASELINES else (strategy, "")


def base_name(strategy: str) -> str:
    """``hyb-h`` of ``hyb-h-26``."""
    return _split(strategy)[0]


def ablations(name: str, tuned: MissionConfig, base: MissionConfig) -> dict[str, MissionConfig]:
    """Return the configurations that tell what earned a gain: ``tuned`` with one group of its parameters as in ``base``.

    Empty where one group alone differs. Groups without a mission of their own, or with another number of photographs, are left out.
    """
    changed = [path for path in parameters() if attrgetter(path)(tuned) != attrgetter(path)(base)]
    groups = {g: paths for g, paths in grouped(changed).items() if g not in ("stop", OTHER)}
    configs, seen = dict[str, MissionConfig](), {mission_key(tuned), mission_key(base)}
    for group, paths in groups.items() if len(groups) > 1 else ():
        values = {path: attrgetter(path)(base) for path in paths}
        with contextlib.suppress(UserError):  # values that exclude one another
            config = tuned.with_values(values)
            if mission_key(config) not in seen and config.photographs == tuned.photographs:
                configs[f"{name}{WITHOUT}{group}"] = config
                seen.add(mission_key(config))
    return configs


def is_ablation(strategy: str) -> bool:
    return WITHOUT in strategy


def kind_of(strategy: str) -> str:
    """Where a strategy stands in a table: among the paper's, the tuned ones, the controls or the oracles."""
    name = _split(strategy)[0]
    if name in PAPER_STRATEGIES:
        return PAPER
    if name in ANSWERS or is_ablation(name):
        return TUNED_KIND
    return ORACLES if name in BASELINES and sees_ground_truth(name) else CONTROLS


def in_table_order(strategies: Iterable[str]) -> list[str]:
    """The strategies as tables list them: kind by kind, in the order of this file."""
    known = list(_LABELS)

    def place(name: str) -> tuple[int, int]:
        base = _split(name)[0]
        return KINDS.index(kind_of(name)), known.index(base) if base in known else len(known)

    return sorted(strategies, key=place)


def label(strategy: str) -> str:
    name, number = _split(strategy)
    tuned, without, group = name.partition(WITHOUT)
    shown = _LABELS.get(tuned, tuned)
    if without:
        return f"{shown}, {group} as in the paper"
    return f"{shown}, {number}" if number else shown


def sees_ground_truth(strategy: str) -> bool:
    """Whether a strategy is an upper reference, not deployable."""
    name = _split(strategy)[0]
    return name in gate_kinds() and gate_class(name).sees_ground_truth
