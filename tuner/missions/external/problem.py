"""A mission of the user's own as a problem: everything is as its mission file says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from nbv.cache import digest
from nbv.config import IDEAL
from nbv.errors import UserError
from tuner.missions.external.mission_file import ExternalConfig, MissionFile, external_config
from tuner.missions.registry import DEFAULT_FIDELITY, EXTERNAL, code_of
from tuner.problem.baselines import TUNED
from tuner.problem.instances import instances_over
from tuner.problem.objective import Objective, dotted
from tuner.problem.problem import Evaluated, MissionProblem, Strategies


@dataclass(frozen=True, kw_only=True)
class MissionFileProblem(MissionProblem):
    """The mission of one mission file."""

    mission: MissionFile

    instance_word = "instance"
    code_word = "program"
    reference = "default"

    @staticmethod
    def of(mission: MissionFile, instances: Sequence[str], replicates: int) -> MissionFileProblem:
        """Return the problem on some instances of the file; `UserError` for one that is not to be tuned on."""
        for name in instances:
            if name not in mission.instances:
                why = (
                    "is held out: it may not be tuned on"
                    if name in mission.held_out
                    else "is not an instance"
                )
                raise UserError(
                    f"{name!r} {why}; {mission.path} has {', '.join(mission.instances)} to tune on"
                )
        base = external_config(mission, {})
        default = dict(base.values)
        return MissionFileProblem(
            space=mission.space,
            instances=instances_over(instances, [IDEAL]),
            default=default,
            replicates=replicates,
            arms={MissionFileProblem.reference: default},
            base=base,
            mission=mission,
        )

    def config(self, values: Mapping[str, Any], condition: str = IDEAL) -> ExternalConfig:
        """Return the configuration at ``values``; a mission file has instances in place of conditions."""
        return external_config(self.mission, values)

    def fidelity(self, name: str) -> str:
        if name not in (DEFAULT_FIDELITY, EXTERNAL):
            raise UserError(
                "--fidelity applies to missions over rocks; a mission file says how its own mission runs"
            )
        return EXTERNAL

    def code(self) -> str:
        return digest(code_of(EXTERNAL), self.mission.program)

    def require_named(self, named: bool) -> None:
        if not named:
            raise UserError(
                f"the campaign asks to run the program of {self.mission.path}; if you trust it, name it: "
                f"--mission {self.mission.path}"
            )

    def require_measured(self, objectives: Sequence[Objective], measured: Mapping[str, Any]) -> None:
        # A parameter counts as a cost: see `Trial.measurements`.
        costs = {**dict.fromkeys(self.mission.space.paths, 0.0), **measured["costs"]}
        for o in objectives:
            if o.measure({**measured, "costs": costs}) is None:
                raise UserError(
                    f"{self.mission.path}: a mission ended without metric {o.metric!r}, which it is tuned for; it has "
                    f"{', '.join(dotted(measured)) or 'none'}"
                )

    def held_out(self) -> tuple[str, ...]:
        return tuple(self.mission.held_out)

    def evaluated_on(self, rocks: Sequence[str] | None, replicates: int) -> tuple[tuple[str, ...], int]:
        names, path = self.held_out(), self.mission.path
        if not names:
            raise UserError(f"{path} has no held-out instance; list some under held_out")
        for rock in rocks or ():
            if rock not in names:
                raise UserError(f"{rock!r} is not held out; {path} holds out {', '.join(names)}")
        return tuple(rocks or names), replicates

    def strategies(self, tuned: Evaluated, names: Sequence[str] | None) -> Strategies:
        known = {"default": {}, **self.mission.baselines}
        for name in names or ():
            if name not in known:
                raise UserError(f"{self.mission.path} has no baseline {name!r}; there are {', '.join(known)}")
        return Strategies(
            {TUNED: self.config(tuned.values), **{name: self.config(known[name]) for name in names or known}}
        )

    def options(self) -> list[str]:
        """Return the option that names the file: a settings file may not choose what is run."""
        return ["--mission", str(self.mission.path)]

    def can_run(self, values: Mapping[str, Any]) -> bool:
        """Return True: the file says what is searched, and says nothing of what lies beyond."""
        return True
