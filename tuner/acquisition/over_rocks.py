"""The surrogate as a model with one output per training world, for acquisitions of a robust choice."""

from __future__ import annotations

from typing import Any

import torch
from botorch.models.model import Model
from botorch.posteriors import GPyTorchPosterior
from gpytorch.distributions import MultitaskMultivariateNormal
from linear_operator.operators import DenseLinearOperator

from tuner.surrogate.model import RockMeanGP


class WorldOutcomes(Model):
    """One output per training world, in the objective's unit.

    Inputs are the surrogate's; the columns behind the unit cube's are replaced.
    """

    def __init__(self, gp: RockMeanGP) -> None:
        super().__init__()
        self._gp = gp
        self._levels = [torch.tensor(gp.levels(world)) for world in gp.worlds]
        self._scales = torch.tensor([gp.standardiser.scale(world) for world in gp.worlds])
        self._centres = torch.tensor([gp.standardiser.centre(world) for world in gp.worlds])

    @property
    def num_outputs(self) -> int:
        """Number of training worlds."""
        return len(self._levels)

    @property
    def batch_shape(self) -> torch.Size:
        """The empty batch shape."""
        return torch.Size()

    def posterior(self, X: torch.Tensor, posterior_transform: Any = None, **kwargs: Any) -> GPyTorchPosterior:
        """Return the joint posterior over q points and W worlds at ``(..., q, inputs)``: ``(..., q, W)`` values."""
        d, q, count = self._gp.space.dimension, X.shape[-2], len(self._levels)
        blocks = []
        for level in self._levels:
            block = X.clone()
            block[..., d:] = level
            blocks.append(block)
        joint = self._gp.model.posterior(torch.cat(blocks, dim=-2)).distribution
        mean = joint.mean.unflatten(-1, (count, q)).transpose(-1, -2) * self._scales + self._centres
        factor = self._scales.repeat_interleave(q)
        covariance = joint.covariance_matrix * factor * factor.unsqueeze(-1)
        posterior = GPyTorchPosterior(
            MultitaskMultivariateNormal(mean, DenseLinearOperator(covariance), interleaved=False)
        )
        return posterior if posterior_transform is None else posterior_transform(posterior, X=X)
