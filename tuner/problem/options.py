"""What a user may ask of our optimiser beyond its defaults. No numerics here: the command line imports it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

from nbv.errors import UserError

Risk = Literal["mean", "cvar", "worst"]
RISKS: tuple[Risk, ...] = get_args(Risk)


@dataclass(frozen=True)
class GPOptions:
    """Options of sampler ``gp``.

    Raises
    ------
    UserError
        An unknown risk measure, a negative strength, or options that exclude one another.
    """

    risk: Risk = "mean"  # over the training rocks: mean, mean of the worse half, worst
    prior_strength: float = 0.0  # missions for which the belief in the default configuration leads; 0: none
    sparse: bool | None = None  # expect most parameters to be without effect; None: where there are many
    fully_bayesian: bool = False  # average over hyperparameters; with ``sparse``: SAAS

    def __post_init__(self) -> None:
        if self.risk not in RISKS:
            raise UserError(f"unknown risk measure {self.risk!r}; there are {', '.join(RISKS)}")
        if not self.prior_strength >= 0:
            raise UserError(f"the prior's strength is {self.prior_strength:g}; give 0 or more missions")
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
