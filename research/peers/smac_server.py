"""SMAC3 as a peer, racing configurations over its native instances (rocks) and seeds (replicates).

With several rocks: SMAC's algorithm-configuration set-up (random forest, one-hot instance features, racing over
(rock, replicate) pairs), the client's initial design as additional configurations. SMAC chooses rock and replicate.
With one rock: SMAC's black-box set-up (Gaussian process). Outcomes are standardised per rock.

SMAC keeps a queue of configurations under race. It lives as long as this process; after a restart SMAC rebuilds it
from the missions told again, so a resumed campaign may go on with other configurations than an uninterrupted one.
"""

from __future__ import annotations

import logging
import tempfile
import warnings
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ConfigSpace import Categorical, Configuration, ConfigurationSpace, Float, Integer
from serving import Ask, Trial, serve
from smac import AlgorithmConfigurationFacade, BlackBoxFacade, Scenario
from smac.initial_design import DefaultInitialDesign
from smac.runhistory.dataclasses import TrialInfo, TrialValue
from smac.runhistory.enumerations import StatusType

warnings.filterwarnings("ignore")
_NO_LIMIT = 100_000  # trials; the campaign owns the budget
# Of new configurations: the default of SMAC's facade for hyperparameters, and of that for one black box.
_RANDOM_SHARE = {AlgorithmConfigurationFacade: 0.2, BlackBoxFacade: 0.08447232371720552}


def _never_called(config: Configuration, instance: str | None = None, seed: int = 0) -> float:
    raise RuntimeError("missions are run by the campaign")


class SmacPeer:
    """See the module."""

    def __init__(self, start: Mapping[str, Any]) -> None:
        logging.disable(logging.WARNING)
        self.parameters = start["parameters"]
        self.rocks: list[str] = start["rocks"]
        self.replicates: int = start["replicates"]
        self.space = ConfigurationSpace(seed=start["seed"])
        self.space.add([self._parameter(p) for p in self.parameters])
        self._outputs = tempfile.TemporaryDirectory()
        several = len(self.rocks) > 1
        scenario = Scenario(
            self.space,
            deterministic=self.replicates == 1,
            n_trials=_NO_LIMIT,
            seed=start["seed"] % 2**31,
            instances=self.rocks if several else None,
            instance_features={rock: [float(rock == other) for other in self.rocks] for rock in self.rocks}
            if several
            else None,
            output_directory=Path(self._outputs.name),
        )
        facade = AlgorithmConfigurationFacade if several else BlackBoxFacade
        design = [self._configuration(values) for values in start["design"]]
        self.smac = facade(
            scenario,
            _never_called,
            initial_design=DefaultInitialDesign(scenario, n_configs=0, additional_configs=design),
            intensifier=facade.get_intensifier(scenario, max_config_calls=len(self.rocks) * self.replicates),
            # SMAC's racing defaults are made for thousands of missions: half of the configurations random, the
            # model trained anew after eight. At tens of missions: as its other facades, and after every one.
            random_design=facade.get_random_design(scenario, probability=_RANDOM_SHARE[facade]),
            config_selector=facade.get_config_selector(scenario, retrain_after=1),
            overwrite=True,
            logging_level=False,
        )
        self.smac.intensifier._tf_seeds = list(range(self.replicates))  # SMAC's seeds are our replicates
        self._asked: dict[int, TrialInfo] = {}
        self._told: list[tuple[TrialInfo, Trial]] = []
        self._entered = 0  # of these, in SMAC's run history

    def tell(self, trial: Trial) -> None:
        """Remember until the next ask, which brings the scales."""
        info = self._asked.get(trial.number) or self._info(trial.values, trial.rock, trial.replicate)
        self._told.append((info, trial))

    def ask(self, request: Ask) -> dict[str, Any]:
        """SMAC's next trial."""
        standard = [request.standardise(trial) for _, trial in self._told]
        worst = max((-z for z in standard if z is not None), default=0.0)
        for i, ((info, _), z) in enumerate(zip(self._told, standard, strict=True)):
            cost, status = (worst, StatusType.CRASHED) if z is None else (-z, StatusType.SUCCESS)
            if i < self._entered:  # the scales have moved
                self.smac.runhistory.add(
                    info.config,
                    cost,
                    status=status,
                    instance=info.instance,
                    seed=info.seed,
                    force_update=True,
                )
            else:
                self.smac.tell(info, TrialValue(cost, status=status), save=False)
        self._entered = len(self._told)
        for pending in request.pending:
            if pending["number"] not in self._asked:  # from before a restart
                info = self._info(pending["values"], pending["rock"], pending["replicate"])
                self._asked[pending["number"]] = info
                self.smac.runhistory.add_running_trial(info)
        info = self.smac.ask()
        self._asked[request.number] = info
        reply = {"values": self._values(info.config), "replicate": int(info.seed or 0)}
        return reply | {"rock": self.rocks[0] if info.instance is None else info.instance}

    def _info(self, values: dict[str, Any], rock: str, replicate: int) -> TrialInfo:
        instance = rock if len(self.rocks) > 1 else None
        return TrialInfo(self._configuration(values), instance=instance, seed=replicate)

    def _configuration(self, values: dict[str, Any]) -> Configuration:
        return Configuration(
            self.space,
            values={
                p["name"]: p["choices"].index(values[p["name"]])
                if p["kind"] == "categorical"
                else values[p["name"]]
                for p in self.parameters
            },
        )

    def _values(self, configuration: Configuration) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for p in self.parameters:
            value = configuration[p["name"]]
            if p["kind"] == "categorical":
                values[p["name"]] = p["choices"][int(value)]
            else:
                values[p["name"]] = int(value) if p["kind"] == "int" else float(value)
        return values

    def _parameter(self, p: dict[str, Any]) -> Any:
        if p["kind"] == "categorical":
            return Categorical(p["name"], list(range(len(p["choices"]))))
        make = Integer if p["kind"] == "int" else Float
        return make(p["name"], (p["low"], p["high"]), log=p["log"])


if __name__ == "__main__":
    serve("smac", version("smac"), SmacPeer)
