"""The fixed strategies that a tuned configuration is compared with."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from nbv.config import Condition, MissionConfig, SparseConfig, gate_kinds, parameters, under
from nbv.errors import UserError
from nbv.gates import gate_class
from nbv.mission.target_prior import target_must_be_found
from tuner.problem.observations import mission_key
from tuner.problem.search_space import Configuration, builtin


@dataclass(frozen=True)
class Baseline:
    """A strategy: which ranking the mission runs, everything else as in the base configuration."""

    name: str
    label: str
    description: str = ""  # what the label does not say
    values: dict[str, Any] = field(default_factory=dict)  # further parameters of the strategy
    plans: bool = True  # False: all photographs are seeds on a plain orbit, and no view is planned
    recentred: bool = False  # of an orbit: its first half locates the target, its second half is moved there

    def config(self, base: MissionConfig) -> MissionConfig:
        """``base`` running this strategy; `UserError`, with the strategy's name, where it cannot."""
        if not self.plans:
            return self.orbit(base, photographs(base))
        return self._laid_over(base, {"gate.kind": self.name, **self.values})

    def _laid_over(self, base: MissionConfig, values: dict[str, Any]) -> MissionConfig:
        try:
            return base.with_values(values)
        except UserError as error:
            raise UserError(f"strategy {self.name} cannot run here: {error}") from error

    def orbit(self, base: MissionConfig, number: int) -> MissionConfig:
        """``base`` with ``number`` photographs on this plain orbit, as far away as its candidates."""
        values = {
            "seed.count": number,
            "seed.layout": "turn",
            "seed.radius_m": base.pool.radius_m,
            "seed.recentre_after": number // 2 if self.recentred else 0,
            **_registering(base.sparse, number),
            "stop.adaptive_budget": 0,
            "stop.max_photographs": 0,
        }
        return self._laid_over(base, {**values, **self.values})


# Parameters by what they change of a mission: the groups by which a gain is split.
THRESHOLDS, COVIS, B_AWARE, POOL = "gate thresholds", "Covis' weights", "B-aware's weights", "candidate pool"
SEEDS, STOP, OTHER = "seeds", "stop", "other"
_GROUPS = {
    THRESHOLDS: ("gate.",),
    COVIS: ("covis.",),
    B_AWARE: ("b_aware.", "predicted."),
    POOL: ("pool.",),
    SEEDS: ("seed.", "sparse."),
    STOP: ("stop.",),
}
CHOICE = (THRESHOLDS, COVIS, B_AWARE)  # how a view is chosen; the others: where views may be, and how many


def group_of(path: str) -> str:
    return next((name for name, begins in _GROUPS.items() if path.startswith(begins)), OTHER)


def grouped(paths: Collection[str]) -> dict[str, tuple[str, ...]]:
    """Return the paths by group, in the order of the groups, without empty ones."""
    groups = {name: tuple(path for path in paths if group_of(path) == name) for name in (*_GROUPS, OTHER)}
    return {name: members for name, members in groups.items() if members}


# Of the splits over 10 and 35 degrees these two were best on rocks that no other choice was made on.
ONE_RING: dict[str, Any] = {"seed.lowest_deg": 10.0, "seed.span_deg": 0.0, "seed.upper_share": 0.0}
MIDDLE_RING: dict[str, Any] = {**ONE_RING, "seed.lowest_deg": 15.0}
HIGH_RING: dict[str, Any] = {**ONE_RING, "seed.lowest_deg": 20.0}
TWO_RINGS: dict[str, Any] = {"seed.lowest_deg": 10.0, "seed.span_deg": 25.0, "seed.upper_share": 0.38}
FEWEST_SEEDS, GROUND_FEATURES = 6, 2000  # as in the search space photographs


def _registering(sparse: SparseConfig, seeds: int) -> dict[str, int]:
    """Parameters that let so few seeds, so far apart, register."""
    return {
        "sparse.min_registered_seeds": min(sparse.min_registered_seeds, FEWEST_SEEDS, seeds),
        "sparse.ground_features": sparse.ground_features or GROUND_FEATURES,
    }


BASELINES: dict[str, Baseline] = {
    b.name: b
    for b in (
        Baseline("covis", "Covis", "co-visibility scorer alone (Eq. 5)"),
        Baseline("b-aware", "B-aware", "baseline-aware repair scorer alone (Eq. 6 to 8)"),
        Baseline("hyb-h", "Hyb-H", "heuristic gate at the paper's thresholds (Eq. 9)"),
        Baseline("hyb-o", "Hyb-O", "oracle gate, by the true surface"),
        Baseline("random", "Random views", "a feasible candidate at random"),
        Baseline("movement-only", "Movement only", "the feasible candidate nearest to the vehicle"),
        # The ceiling needs the reward that the dense stage pays back: docs/results/table_1.md.
        Baseline(
            "greedy-oracle",
            "Greedy oracle",
            "the best single view by the true surface",
            values={"gate.oracle_coverage": "matchable"},
        ),
        Baseline(
            "predicted",
            "Predicted",
            "scorer predicted alone: how much the predicted completeness would rise",
            values={f"predicted.weights.{term}": 0.0 for term in ("nov", "move", "ang")},
        ),
        Baseline("orbit-middle", "Plain orbit at 15°", values=MIDDLE_RING, plans=False),
        Baseline("orbit", "Plain orbit at 10°", values=ONE_RING, plans=False),
        Baseline("orbit-high", "Plain orbit at 20°", values=HIGH_RING, plans=False),
        Baseline(
            "orbit-two",
            "Plain orbit, two rings",
            "a plain orbit, 62 % of it at 10° and the rest at 35°",
            values=TWO_RINGS,
            plans=False,
        ),
        Baseline(
            "orbit-recentred",
            "Plain orbit, re-centred",
            "a plain orbit at 10°; its second half is moved to the target that the first has located",
            values=ONE_RING,
            plans=False,
            recentred=True,
        ),
        Baseline(
            "orbit-two-recentred",
            "Plain orbit, two rings, re-centred",
            "the orbit of two rings; its second half is moved to the target that the first has located",
            values=TWO_RINGS,
            plans=False,
            recentred=True,
        ),
    )
}
PAPER_STRATEGIES = ("covis", "b-aware", "hyb-h", "hyb-o")
# What `gatetune evaluate` compares with unless told otherwise: the paper's four, *predicted*, random views, a planner that sees
# the true surface, and plain orbits.
ORBITS = ("orbit-middle", "orbit", "orbit-high", "orbit-two")
RECENTRED_ORBITS = ("orbit-recentred", "orbit-two-recentred")
# The plain plans that a campaign runs as trials where its space holds them. The first is the best over 34 training targets with
# photographs (docs/results/what_to_fly.md): another has to be better on the campaign's own rocks.
ARMS = ("orbit-middle", "orbit-high", "random")
EVALUATION_BASELINES = (*PAPER_STRATEGIES, "predicted", "random", "greedy-oracle", *ORBITS)
# What `gatetune reproduce` runs: Table I's columns, and the reference for the gates.
REPRODUCTION_STRATEGIES = (*PAPER_STRATEGIES, "greedy-oracle")
TUNED = "tuned"
PAPER, TUNED_KIND, CONTROLS, ORACLES = KINDS = ("the paper's", "tuned", "controls", "oracles")
# Arms that split the gain of a tuned configuration. Not baselines by name, since the campaign decides their pool.
TUNED_POOL_RANDOM, TUNED_POOL_HYB_H = "random-tuned-pool", "hyb-h-tuned-pool"
TUNED_WEIGHTS = "tuned-paper-thresholds"
# Labels and descriptions of all strategies, in the order of tables.
_SHOWN: dict[str, tuple[str, str]] = {b.name: (b.label, b.description) for b in BASELINES.values()} | {
    TUNED: ("Tuned", "the recommended configuration"),
    TUNED_WEIGHTS: ("Tuned, paper's gate", "the recommended configuration with the paper's thresholds"),
    TUNED_POOL_HYB_H: (
        "Hyb-H, tuned pool",
        "the paper's thresholds and weights in the pool of the recommended configuration",
    ),
    TUNED_POOL_RANDOM: (
        "Random, tuned pool",
        "a candidate at random in the pool of the recommended configuration",
    ),
    "default": ("default", "nothing changed"),  # of a mission file
}
# What a campaign ends in, beside Tuned and its arms: the paper's four and the plainest plans at equal number.
# In the order in which they are run: those that often choose the same views lie apart, so that the later finds all it needs.
COMPARISON = ("hyb-h", "covis", "orbit-middle", "random", "orbit", "b-aware", "orbit-high", "hyb-o")

PLANNER = ("gate", "covis", "b_aware", "predicted", "shared", "plugins")  # sections that choose views
PLAN = (*PLANNER, "seed", "pool", "stop")  # and those that say from where, and how many


def baseline(name: str, also: Sequence[str] = ()) -> Baseline:
    """The baseline called ``name``; `UserError` where there is none, which lists those that there are ``also``."""
    if name not in BASELINES and name in gate_kinds():
        return Baseline(name, name, "a plug-in's planner")
    if name not in BASELINES:
        known = (*BASELINES, *also)
        close = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise UserError(
            f"unknown strategy {name!r}; {hint}there are {', '.join(known)}; "
            "a plug-in must be installed, or named with gatetune --plugin"
        )
    return BASELINES[name]


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
    number = photographs(tuned)
    if all(photographs(config) == number for config in configs.values()):
        return configs
    equal = {f"{name}-{number}": _at_number(name, config, tuned) for name, config in configs.items()}
    return {reference: configs[reference], **equal}


def _at_number(name: str, config: MissionConfig, tuned: MissionConfig) -> MissionConfig:
    number = photographs(tuned)
    if is_orbit(name):
        return BASELINES[name].orbit(config, number)
    seed, budget = tuned.seed, tuned.adaptive_budget
    sparse = tuned.sparse  # what seeds far apart need to register
    if budget == 0:
        seeds = min(number, max(FEWEST_SEEDS, round(number * config.seed.total / photographs(config))))
        seed = dataclasses.replace(config.seed if config.seed.count else seed, count=seeds)
        budget = number - seeds
        sparse = tuned.with_values(_registering(sparse, seeds)).sparse
    return ending_at(config, number).changed(seed=seed, sparse=sparse, stop={"adaptive_budget": budget})


def ending_at(config: MissionConfig, number: int) -> MissionConfig:
    """``config`` with so many photographs in every mission: its seeds, and planned views until the number is reached."""
    return config.changed(
        stop={
            "adaptive_budget": max(0, number - config.seed.total),
            "max_photographs": 0,
            "criterion": "budget",
        }
    )


def orbits_at_number(tuned: MissionConfig, conditions: Iterable[Condition]) -> dict[str, MissionConfig]:
    """The plain orbits with as many photographs as ``tuned``, and re-centred ones where the target must be located."""
    number = photographs(tuned)
    names = [*ORBITS, *(RECENTRED_ORBITS if target_must_be_located(tuned, conditions) else ())]
    return {f"{name}-{number}": BASELINES[name].orbit(tuned, number) for name in names}


def target_must_be_located(config: MissionConfig, conditions: Iterable[Condition]) -> bool:
    """Whether a mission must first locate its target under one of the conditions; elsewhere re-targeting changes no orbit."""
    return any(target_must_be_found(under(config, condition)) for condition in conditions)


def is_orbit(strategy: str) -> bool:
    """Whether a strategy, such as ``orbit`` or ``orbit-two-24``, is a plain orbit."""
    name, _ = _split(strategy)
    return name in BASELINES and not BASELINES[name].plans


def photographs(config: MissionConfig) -> int:
    """Seeds and planned views of a mission that nothing ends early."""
    return config.seed.total + config.adaptive_budget


def controls_at_equal_number(strategies: Mapping[str, Configuration]) -> tuple[str, ...]:
    """Return the strategies with as many photographs as the tuned one, less its equals and those that see the true surface.

    Where the tuned mission may end early, its mean number counts, which is in the controls' names (``orbit-26``).
    """
    tuned = strategies.get(TUNED)
    if not isinstance(tuned, MissionConfig):  # a mission file's configuration has no number
        return ()
    named = [int(said) for name in strategies if (said := _split(name)[1])]
    number = named[0] if tuned.stop.may_end_early and named else photographs(tuned)
    return tuple(
        name
        for name, config in strategies.items()
        if photographs(builtin(config)) == number
        and mission_key(config) != mission_key(tuned)
        and not sees_ground_truth(name)
    )


def _split(strategy: str) -> tuple[str, str]:
    """``hyb-h`` and ``26`` of ``hyb-h-26``; the number is empty where there is none."""
    name, _, number = strategy.rpartition("-")
    return (name, number) if number.isdigit() and name in BASELINES else (strategy, "")


def base_name(strategy: str) -> str:
    """``hyb-h`` of ``hyb-h-26``."""
    return _split(strategy)[0]


def tuned_configs(
    tuned: MissionConfig, base: MissionConfig, counted: MissionConfig | None = None
) -> dict[str, MissionConfig]:
    """The tuned configuration and the arms that split its gain, each where it is a mission of its own.

    ``counted``: the tuned one with as many photographs as the random views are to have, where something may end it
    early.
    """
    arms = {
        TUNED: tuned,
        TUNED_WEIGHTS: _with_default(tuned, base, (THRESHOLDS,)),
        TUNED_POOL_HYB_H: _with_default(tuned, base, CHOICE),
    }
    seen, configs = {mission_key(base)}, dict[str, MissionConfig]()
    for name, config in arms.items():
        if name == TUNED or mission_key(config) not in seen:
            configs[name] = config
            seen.add(mission_key(config))
    if tuned.pool != base.pool and tuned.adaptive_budget:
        chance = baseline("random").config(base.changed(pool=tuned.pool))
        equal = at_equal_number({"random": chance}, counted or tuned, "random")
        configs[TUNED_POOL_RANDOM] = list(equal.values())[-1]
    return configs


def _with_default(tuned: MissionConfig, base: MissionConfig, groups: Collection[str]) -> MissionConfig:
    """``tuned`` with all parameters of the groups as in ``base``."""
    return tuned.with_values(
        {path: attrgetter(path)(base) for path in parameters() if group_of(path) in groups}
    )


def kind_of(strategy: str) -> str:
    """Where a strategy stands in a table: among the paper's, the tuned ones, the controls or the oracles."""
    name = _split(strategy)[0]
    if name in PAPER_STRATEGIES:
        return PAPER
    if name in (TUNED, TUNED_WEIGHTS):
        return TUNED_KIND
    return ORACLES if name in BASELINES and sees_ground_truth(name) else CONTROLS


def in_table_order(strategies: Iterable[str]) -> list[str]:
    """The strategies as tables list them: kind by kind, in the order of this file."""
    known = list(_SHOWN)

    def place(name: str) -> tuple[int, int]:
        base = _split(name)[0]
        return KINDS.index(kind_of(name)), known.index(base) if base in known else len(known)

    return sorted(strategies, key=place)


def label(strategy: str) -> str:
    name, number = _split(strategy)
    shown, _ = _SHOWN.get(name, (name, ""))
    return f"{shown}, {number}" if number else shown


def description(strategy: str) -> str:
    return _SHOWN.get(_split(strategy)[0], ("", ""))[1]


def sees_ground_truth(strategy: str) -> bool:
    """Whether a strategy is an upper reference, not deployable."""
    name = _split(strategy)[0]
    return name in gate_kinds() and gate_class(name).sees_ground_truth
