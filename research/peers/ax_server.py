"""Ax as a peer: one configuration per mission, outcomes standardised per rock, noise inferred unless known.

Ax's ``fast`` strategy: a Gaussian process and log noisy expected improvement. The initial design is the
client's. The experiment is built anew for every ask, because the scales of the rocks move; so an ask is a function
of what was told and of its seed.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from ax.api.client import Client
from ax.api.configs import ChoiceParameterConfig, RangeParameterConfig
from ax.core.data import Data
from serving import Ask, Trial, serve

warnings.filterwarnings("ignore")
for logger in ("ax", "ax.api.client", "ax.core", "ax.generation_strategy"):
    logging.getLogger(logger).setLevel(logging.ERROR)


class AxPeer:
    """See the module."""

    def __init__(self, start: Mapping[str, Any]) -> None:
        self.parameters = start["parameters"]
        self.names = {p["name"]: f"p{i}" for i, p in enumerate(self.parameters)}  # dots mean something to Ax
        self.trials: list[Trial] = []

    def tell(self, trial: Trial) -> None:
        """Remember."""
        self.trials.append(trial)

    def ask(self, request: Ask) -> dict[str, Any]:
        """Ax's next trial."""
        client = Client(random_seed=request.seed)
        client.configure_experiment([self._parameter(p) for p in self.parameters])
        client.configure_optimization("outcome")
        # What was told is the initial design: one trial is enough to leave it.
        client.configure_generation_strategy(
            method="fast",
            initialization_budget=1,
            initialization_random_seed=request.seed,
            initialize_with_center=False,
            min_observed_initialization_trials=1,
            allow_exceeding_initialization_budget=True,
        )
        rows: list[Any] = []
        for trial in self.trials:
            index = client.attach_trial(self._to_ax(trial.values))
            z = request.standardise(trial)
            if z is None:
                client.mark_trial_abandoned(index)  # a failed one may be suggested again
                continue
            # What client.complete_trial does, but with one attachment for all: each one sorts all data.
            entry = client._experiment.trials[index]
            outcome = {"outcome": (z, request.standardised_sd(trial))}
            evaluation = {entry.arm.name: [(math.nan, outcome)]}
            rows += entry._raw_evaluations_to_data(raw_data=evaluation)._data_rows
            entry.mark_completed()
        client._experiment.attach_data(Data(data_rows=rows))
        for pending in request.pending:
            client.attach_trial(self._to_ax(pending["values"]))
        (arm,) = client.get_next_trials(max_trials=1).values()
        return {"values": self._from_ax(arm)}

    def _parameter(self, p: dict[str, Any]) -> RangeParameterConfig | ChoiceParameterConfig:
        name = self.names[p["name"]]
        if p["kind"] == "categorical":
            labels = [str(i) for i in range(len(p["choices"]))]
            return ChoiceParameterConfig(name=name, values=labels, parameter_type="str", is_ordered=False)
        return RangeParameterConfig(
            name=name,
            bounds=(p["low"], p["high"]),
            parameter_type=p["kind"],
            scaling="log" if p["log"] else "linear",
        )

    def _to_ax(self, values: dict[str, Any]) -> dict[str, Any]:
        return {
            self.names[p["name"]]: str(p["choices"].index(values[p["name"]]))
            if p["kind"] == "categorical"
            else (int if p["kind"] == "int" else float)(values[p["name"]])
            for p in self.parameters
        }

    def _from_ax(self, arm: Mapping[str, Any]) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for p in self.parameters:
            value = arm[self.names[p["name"]]]
            values[p["name"]] = p["choices"][int(value)] if p["kind"] == "categorical" else value
        return values


if __name__ == "__main__":
    serve("ax", version("ax-platform"), AxPeer)
