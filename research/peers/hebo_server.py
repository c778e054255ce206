"""HEBO as a peer: one configuration per mission, outcomes standardised per rock, its native mixed space.

HEBO 0.3.6 with its Gaussian process (warped outputs, MACE acquisition). The initial design is the client's. The
optimiser is built anew for every ask, because the scales of the rocks move; so an ask is a function of what
was told and of its seed. HEBO takes neither known noise nor missions in flight nor failures: those are left out.
"""

from __future__ import annotations

import functools
import random
import warnings
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
import pandas as pd
import torch
from hebo.acq_optimizers import evolution_optimizer
from hebo.design_space.design_space import DesignSpace
from hebo.optimizers.hebo import HEBO
from pymoo.optimize import minimize
from serving import Ask, Trial, serve

warnings.filterwarnings("ignore")
_MAX_SEED = 2**31 - 1


class HeboPeer:
    """See the module."""

    def __init__(self, start: Mapping[str, Any]) -> None:
        self.parameters = start["parameters"]
        self.trials: list[Trial] = []

    def tell(self, trial: Trial) -> None:
        """Remember."""
        self.trials.append(trial)

    def ask(self, request: Ask) -> dict[str, Any]:
        """HEBO's suggestion."""
        random.seed(request.seed)
        np.random.seed(request.seed)  # noqa: NPY002 - HEBO draws from numpy's global generator
        torch.manual_seed(request.seed)
        # pymoo since 0.6.1 draws from its own generator, which HEBO does not seed.
        evolution_optimizer.minimize = functools.partial(minimize, seed=request.seed % _MAX_SEED)
        space = DesignSpace().parse([self._parameter(p) for p in self.parameters])
        good = [(t, z) for t in self.trials if (z := request.standardise(t)) is not None]
        optimiser = HEBO(space, rand_sample=2, scramble_seed=request.seed)
        optimiser.observe(
            pd.DataFrame([self._to_hebo(t.values) for t, _ in good])[space.para_names],
            -np.array([[z] for _, z in good]),
        )
        row = optimiser.suggest(1).iloc[0]
        return {"values": self._from_hebo(row)}

    def _parameter(self, p: dict[str, Any]) -> dict[str, Any]:
        if p["kind"] == "categorical":
            labels = [str(i) for i in range(len(p["choices"]))]
            return {"name": p["name"], "type": "cat", "categories": labels}
        kinds = {
            ("int", True): "pow_int",
            ("int", False): "int",
            ("float", True): "pow",
            ("float", False): "num",
        }
        return {"name": p["name"], "type": kinds[p["kind"], p["log"]], "lb": p["low"], "ub": p["high"]}

    def _to_hebo(self, values: dict[str, Any]) -> dict[str, Any]:
        return {
            p["name"]: str(p["choices"].index(values[p["name"]]))
            if p["kind"] == "categorical"
            else values[p["name"]]
            for p in self.parameters
        }

    def _from_hebo(self, row: Mapping[str, Any]) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for p in self.parameters:
            value = row[p["name"]]
            if p["kind"] == "categorical":
                values[p["name"]] = p["choices"][int(value)]
            else:
                values[p["name"]] = round(value) if p["kind"] == "int" else float(value)
        return values


if __name__ == "__main__":
    serve("hebo", version("HEBO"), HeboPeer)
