"""What a user may ask of our optimiser beyond its defaults. No numerics here: the command line imports it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

from nbv.errors import UserError

Risk = Literal["mean", "worst"]
RISKS: tuple[Risk, ...] = get_args(Risk)


@dataclass(frozen=True)
class GPOptions:
    """Options of sampler ``gp``.

    Raises
    ------
    UserError
        An unknown risk measure, or options that exclude one another.
    """

    risk: Risk = "mean"  # outcome over the training rocks: their mean, or that of the worst one
    fully_bayesian: bool = False  # average over hyperparameters

    def __post_init__(self) -> None:
        if self.risk not in RISKS:
            raise UserError(f"unknown risk measure {self.risk!r}; there are {', '.join(RISKS)}")
        if self.fully_bayesian and self.risk != "mean":
            raise UserError(
                f"risk {self.risk} is not averaged over hyperparameters; leave out --fully-bayesian"
            )

    @property
    def is_default(self) -> bool:
        """Whether nothing was asked for."""
        return self == GPOptions()

    def to_dict(self) -> dict[str, Any]:
        """YAML form."""
        return asdict(self)

    @staticmethod
    def from_dict(tree: Mapping[str, Any]) -> GPOptions:
        """The inverse of ``to_dict``."""
        return GPOptions(**tree)
