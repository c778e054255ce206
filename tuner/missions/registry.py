"""Kinds of missions (fidelities) by name, with what the tuner must know of each. A new one is one file, and an entry of `BUILT_IN`.

The name goes into a campaign's settings, to the workers, and to ``--fidelity``. Those of other packages are plug-ins, so that no
file of settings chooses code: a function like `nbv.mission.MissionFunction`, which may return its metrics alone, or a
`MissionKind`.
"""

from __future__ import annotations

import pkgutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from nbv.cache import Store, code_digest
from nbv.config import MissionConfig
from nbv.errors import MissionFailure, UserError
from nbv.mission.result import MissionResult
from nbv.plugins import Registry
from nbv.rocks import Rock, load_coarse_rock, load_rock
from nbv.rocks.catalogue import is_photographed


@dataclass(frozen=True)
class MissionKind:
    """One kind of mission; the defaults say of a plug-in that nothing is known of its missions."""

    # A `nbv.mission.MissionFunction`, or "module:function" of one that is built in; empty: none is known.
    runs: str | Callable[..., MissionResult | Mapping[str, Any]]
    # Rocks of the catalogue, sets of photographs, or what nobody else need know.
    targets: Literal["rocks", "photographs", "own"] = "own"
    flies: Callable[[str], bool] = lambda target: True  # whether it can fly a target of that name
    photographs: Literal["rendered", "taken", ""] = ""  # what it needs, and reconstructs densely; empty: none
    truth: str = ""  # what its clouds are measured against
    predicts: bool = False  # whether its metrics are predictions, on a coarse rock
    every_number: bool = False  # whether one mission measures every number of photographs up to its own
    seconds: Callable[[MissionConfig], float] | None = None  # about how long one takes on a quiet core
    refuses: str = ""  # "module:function" that is given a configuration, and raises `UserError`
    numbers_are: str = ""  # how its numbers come about; empty: the fidelity's name says enough
    note: str = ""  # what somebody who runs it must know
    loads: tuple[str, ...] = ()  # libraries that a mission imports on its way, so that a worker has them

    @property
    def function(self) -> Callable[..., MissionResult | Mapping[str, Any]]:
        """The function that runs one mission; `UserError` where there is none."""
        if not self.runs:
            raise UserError("no such fidelity is known here; name its plug-in with gatetune --plugin")
        function: Callable[..., MissionResult | Mapping[str, Any]] = (
            pkgutil.resolve_name(self.runs) if isinstance(self.runs, str) else self.runs
        )
        return function

    def __call__(
        self,
        config: MissionConfig,
        rock: str,
        replicate: int = 0,
        directory: Path | None = None,
        **options: Any,
    ) -> MissionResult:
        """Run one mission as a `nbv.mission.MissionFunction`; a function that returns its metrics alone has ended well.

        What it returns under ``costs`` are its costs. Raises `MissionFailure`: it returned anything else.
        """
        started = time.perf_counter()
        outcome = self.function(config, rock, replicate, directory, **options)
        if isinstance(outcome, MissionResult):
            return outcome
        if not isinstance(outcome, Mapping) or not isinstance(outcome.get("costs", {}), Mapping):
            raise MissionFailure(
                "plugin_failed",
                f"the fidelity returned {outcome!r:.80}, not a MissionResult or metrics by name",
            )
        return MissionResult(
            status="ok",
            reason="",
            message="",
            config_digest=config.digest(),
            rock=rock,
            replicate=replicate,
            metrics={name: value for name, value in outcome.items() if name != "costs"},
            trace=[],
            timings_s={},
            costs={"wall_s": time.perf_counter() - started, **outcome.get("costs", {})},
            condition=config.condition,
        )

    @property
    def uses_catalogue(self) -> bool:
        """Whether it calls a rock or a set of photographs what the catalogue of rocks does."""
        return self.targets in ("rocks", "photographs")

    def load_rock(self, name: str, store: Store) -> Rock:
        """The rock as its missions know it."""
        return (load_coarse_rock if self.predicts else load_rock)(name, store)

    def require_possible(self, config: MissionConfig) -> None:
        """Raise `UserError` where ``config`` asks for what such missions cannot give."""
        if self.refuses:
            pkgutil.resolve_name(self.refuses)(config)

    def require_dense_stage(self, config: Any) -> None:
        """Raise `UserError` where missions with photographs would end at their dense stage on this machine."""
        if self.photographs and config.dense.backend == "patchmatch":
            from nbv.dense.patchmatch import require_cuda  # noqa: PLC0415  loads OpenCV, wasted where no card is asked for

            require_cuda()


def _rendered_s(config: MissionConfig) -> float:
    # The 32 missions of `make tune`, of 20 photographs, took 226 s on two cores; PatchMatch takes 8 s on an H100 and 2 s after
    # it in place of SGBM's 7.
    of_one_s = 0.9 if config.dense.backend == "patchmatch" else 0.7
    number = config.photographs
    # Where every pair is matched 64 photographs took 744 s, nine tenths of it in matching and bundle adjustment.
    every_pair_s = 0.0 if config.sparse.max_pairs else 0.35 * number * (number - 1) / 2
    return of_one_s * number + every_pair_s


DEFAULT_FIDELITY = "photogrammetric"
PHOTOGRAPHS = "photographs"
_GEOMETRIC = MissionKind(
    "nbv.geometric:run_geometric_mission",
    targets="rocks",
    predicts=True,
    seconds=lambda config: 2.0,  # hardly more than its proposal
    numbers_are="predicted by geometric missions, without photographs",
    note="Geometric missions are a low-fidelity simulation: the loop, scorers, gates and flight are the same, feature tracks are "
    "simulated, and no photograph is rendered. Completeness is predicted, accuracy is set to 100 %, and distances are not "
    "computed. Parameters of features, matching and the ground-truth gate have no effect, nor have conditions of sensor, "
    "telemetry and target, nor of the scene but for its sun.",
    loads=("open3d",),
)
BUILT_IN = {
    DEFAULT_FIDELITY: MissionKind(
        "nbv.photogrammetric:run_photogrammetric_mission",
        targets="rocks",
        photographs="rendered",
        truth="ground truth",
        seconds=_rendered_s,
        loads=("open3d", "torch"),
    ),
    "geometric": _GEOMETRIC,
    "curve": replace(
        _GEOMETRIC, runs="nbv.geometric.geometric_fidelity:run_curve_mission", every_number=True
    ),
    PHOTOGRAPHS: MissionKind(
        "nbv.photographs.photograph_fidelity:run_photographs_mission",
        targets="photographs",
        flies=is_photographed,
        photographs="taken",
        truth="the set's own reference",
        refuses="nbv.photographs.photograph_fidelity:PhotographFidelity.require_noticed",
        numbers_are="measured against the set's own dense reference; missions over real photographs",
        loads=("open3d",),
    ),
}
FIDELITIES = Registry("fidelities", BUILT_IN)


def mission_kind(fidelity: str) -> MissionKind:
    """What is known of missions of this fidelity: nothing where it is a function, or no fidelity that there is now.

    Raises `UserError`: a plug-in that cannot be imported.
    """
    part = FIDELITIES.load(fidelity, BUILT_IN) if fidelity in FIDELITIES else ""
    return part if isinstance(part, MissionKind) else MissionKind(part)


def kind_on(target: str, fidelity: str) -> MissionKind:
    """What is known of missions of this fidelity on ``target``: over a set of photographs nothing is rendered nor simulated.

    Raises `UserError`: such missions cannot run on it; as `mission_kind`.
    """
    kind = mission_kind(fidelity)
    if kind.targets == "rocks" and is_photographed(target):
        return BUILT_IN[PHOTOGRAPHS]
    if not kind.flies(target):
        remedy = (
            "gatetune photographs import makes a set" if kind.targets == "photographs" else "name another"
        )
        raise UserError(f"{fidelity} missions cannot run on {target}; {remedy}")
    return kind


def usual_preset(targets: Sequence[str], fidelity: str = DEFAULT_FIDELITY) -> str:
    """The preset of missions for which nobody names one: ``photographs`` where all are over sets of photographs, else ``campaign``.

    Raises `UserError`: as `kind_on`.
    """
    over_sets = all(kind_on(target, fidelity) is BUILT_IN[PHOTOGRAPHS] for target in targets)
    return "photographs" if over_sets else "campaign"


def modules_of(fidelity: str) -> tuple[str, ...]:
    """The modules that every worker imports to run ``fidelity``: its own, then libraries; of a plug-in's what it may well build on."""
    kind = BUILT_IN.get(fidelity, _GEOMETRIC)
    return str(kind.runs).partition(":")[0], *kind.loads


def code_of(fidelity: str) -> str:
    """Digest of a fidelity's code: of ``nbv`` with all that it imports, of a plug-in its files."""
    if (plugin := FIDELITIES.plugin(fidelity)) is not None:
        return plugin.source
    return code_digest(modules_of(fidelity)[0])
