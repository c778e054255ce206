"""A study that flies missions: its settings file, written once, and the evaluations that go on beside it."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar, cast

from nbv.errors import UserError
from nbv.mission.run_directory import write_atomic
from nbv.safe_files import read_yaml, to_yaml
from tuner.evaluation.plan import EvaluationPlan
from tuner.evaluation.run import EvaluationEvent, failure_counts, run_evaluation
from tuner.missions.executors import Executor
from tuner.missions.job import Trial
from tuner.missions.registry import GEOMETRIC_NOTE, is_geometric
from tuner.report.style import short_names

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FORMAT_VERSION = 2  # 1 named its fidelity by module and function


class StudySettings(ABC):
    """What a study flies: a flat frozen dataclass of plain values, tuples and mappings."""

    FILE: ClassVar[str]  # of the settings, in the study's directory
    STUDY: ClassVar[str]  # what messages call it

    @abstractmethod
    def plans(self) -> dict[str, EvaluationPlan]:
        """The evaluations to fly, in order, by directory within the study's."""

    @property
    def missions(self) -> int:
        """Missions in all."""
        return sum(plan.missions for plan in self.plans().values())

    def to_dict(self) -> dict[str, Any]:
        """Return the YAML form, without the version of its format."""
        fields = dataclasses.fields(cast("DataclassInstance", self))
        tree = {f.name: getattr(self, f.name) for f in fields}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in tree.items()}

    @classmethod
    def from_dict(cls, tree: dict[str, Any], source: str) -> Self:
        """The inverse of ``to_dict``; ``source`` names the file in messages."""
        return cls(
            **{name: tuple(value) if isinstance(value, list) else value for name, value in tree.items()}
        )

    @classmethod
    def load(cls, directory: Path) -> Self:
        """The settings of a study's directory.

        Raises
        ------
        UserError
            The file is missing, damaged, has an unknown field, or is of another version.
        """
        path = directory / cls.FILE
        if not path.is_file():
            raise UserError(
                f"{directory} holds no {cls.STUDY} ({cls.FILE} is missing); name a study's directory"
            )
        try:
            tree = read_yaml(path)
            if tree.pop("format") != FORMAT_VERSION:
                raise UserError(f"{path} was written by another version; start a new study elsewhere")
            return cls.from_dict(tree, str(path))
        except (KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{path} is not a study's settings ({error!r}); restore the file") from error

    def claim(self, directory: Path) -> None:
        """Write the settings into a new directory, or find the same ones there.

        Raises
        ------
        UserError
            The directory holds something else or cannot be written.
        """
        path = directory / self.FILE
        if path.exists():
            if self.load(directory).to_dict() != self.to_dict():
                raise UserError(f"{directory} holds another {self.STUDY}; choose another --out")
            return
        if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
            raise UserError(f"{directory} exists and is not an empty directory; choose another --out")
        try:
            directory.mkdir(parents=True, exist_ok=True)
            tree = {"format": FORMAT_VERSION, **self.to_dict()}
            write_atomic(path, to_yaml(tree))
        except OSError as error:
            raise UserError(f"cannot write to {directory}: {error.strerror}; choose another --out") from error


def run_missions(
    settings: StudySettings,
    directory: Path,
    executor: Executor,
    on_event: Callable[[EvaluationEvent], None] | None = None,
) -> bool:
    """Fly what has not flown yet and return whether the study is complete.

    Parameters
    ----------
    settings
        What the study flies.
    directory
        Its directory, new or of the same study.
    executor
        Flies the missions.
    on_event
        Is called with everything that happens.

    Raises
    ------
    UserError
        The directory holds something else or cannot be written; a mission met a user's mistake.
    """
    settings.claim(directory)
    return all(
        run_evaluation(plan, directory / name, executor, on_event).complete
        for name, plan in settings.plans().items()
    )


def evaluated(settings: StudySettings, directory: Path) -> dict[str, list[Trial]]:
    """Return what is known of every plan's missions so far, by plan."""
    return {name: plan.records(directory / name) for name, plan in settings.plans().items()}


S = TypeVar("S", bound=StudySettings)


@dataclass(frozen=True)
class StudyFindings(Generic[S]):
    """What every study's findings begin with."""

    settings: S
    missions: int  # with an outcome
    expected: int
    failures: dict[str, int]  # failed missions by reason
    wall_s: float  # of all missions together

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "settings": self.settings.to_dict(),
            "missions": self.missions,
            "missions_expected": self.expected,
            "failures": self.failures,
            "wall_s": self.wall_s,
        }


def counts(settings: StudySettings, records: list[Trial]) -> tuple[int, int, dict[str, int], float]:
    """Return the fields of `StudyFindings` after its settings. Strategies may share missions, which count once."""
    once = {r.directory: r for r in records}.values()
    return len(once), settings.missions, failure_counts(once), sum(r.wall_s for r in once)


def preamble(findings: StudyFindings[Any]) -> list[str]:
    """Markdown lines: preset, overrides, rocks, replicates, surface, missions; fidelity; failures."""
    s = findings.settings
    changed = "".join(f", `{path}={value}`" for path, value in s.overrides.items())
    lines = [
        f"Preset `{s.preset}`{changed}; rocks {', '.join(short_names(s.rocks))}; {s.replicates} replicates. "
        f"{s.surface.capitalize()} surface. {findings.missions} of {findings.expected} missions are in "
        f"({findings.wall_s / 60:.0f} min of missions).",
        "",
    ]
    if is_geometric(s.fidelity.rpartition(":")[2]):
        lines += [GEOMETRIC_NOTE, ""]
    if findings.failures:
        counts = ", ".join(f"{reason} {n}" for reason, n in sorted(findings.failures.items()))
        lines += [f"Failed missions by reason: {counts}.", ""]
    return lines
