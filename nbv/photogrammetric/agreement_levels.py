"""The mission that the noise study flies: one flight, measured at several fusion strictness levels.

Different adaptive budgets are different missions and are not shared: Eq. 9 reads the share of the budget used,
so a mission of 16 captures does not begin with the mission of 8; and where it does (fixed scorers, controls)
the depth maps still change, because later views become their neighbours. Photographs, features, pairs and seed
models that missions have in common come from the store.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Unpack

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.mission import MissionOptions, MissionResult
from nbv.mission.flying import fly_mission
from nbv.photogrammetric import PhotogrammetricFidelity
from nbv.types import Cloud

# Values of dense.agreeing_views that are measured; a mission is flown with the lowest.
AGREEMENT_LEVELS = (3, 5, 6, 7)
SURFACES = ("whole", "observable")


class SeveralAgreementLevels(PhotogrammetricFidelity):
    """Also measures the same flight at stricter fusions. Depth maps, the dear part, are made once.

    ``metrics["agreement"]["5"]`` holds the scores that a mission configured with 5 would have, or ``failed`` with
    the reason.
    """

    levels = AGREEMENT_LEVELS

    def measure(self, cloud: Cloud) -> dict[str, Any]:
        """The mission's own metrics, and those at every level from ``config.dense.agreeing_views`` on."""
        metrics = super().measure(cloud)
        configured = self.context.config.dense.agreeing_views
        with self.context.stopwatch.timed("agreement_levels"):
            metrics["agreement"] = {
                str(level): _surfaces(metrics) if level == configured else self._scores_at(level)
                for level in self.levels
                if level >= configured
            }
        return metrics

    def _scores_at(self, level: int) -> dict[str, Any]:
        try:
            cloud = self.reconstructor.cloud_at(level)
            return _surfaces(self.evaluate(cloud, self.context.rock, self.context.config).metrics)
        except MissionFailure as failure:
            return {"failed": failure.reason}


def run_study_mission(
    config: MissionConfig,
    rock: str,
    replicate: int = 0,
    directory: Path | None = None,
    **options: Unpack[MissionOptions],
) -> MissionResult:
    """A photogrammetric mission with scores at all levels; see `nbv.mission.MissionFunction`."""
    return fly_mission(SeveralAgreementLevels, config, rock, replicate, directory, **options)


def _surfaces(metrics: dict[str, Any]) -> dict[str, Any]:
    return {surface: metrics[surface] for surface in SURFACES}
