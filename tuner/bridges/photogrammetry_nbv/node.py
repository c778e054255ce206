"""Their node with our scorers, which ends when it has finished: ``python -m tuner.bridges.photogrammetry_nbv.node --ros-args ...``.

Needs ROS 2 and their package ``photogrammetry_nbv`` on the path; nothing of theirs is changed on disk.
"""

from __future__ import annotations

import importlib
from typing import Any

from tuner.bridges.photogrammetry_nbv.registering import register


def end_when_finished(controller: type) -> None:
    """Let the controller's timer end the program, as Ctrl-C would, once its state is ``FINISHED``."""
    step = controller._run  # type: ignore[attr-defined]

    def run(self: Any) -> None:
        step(self)
        if self.state.name == "FINISHED":
            raise KeyboardInterrupt  # which their main() ends on

    controller._run = run  # type: ignore[attr-defined]


def main() -> None:
    """Register, then run their ``main()``."""
    package = "photogrammetry_nbv"
    scorers = importlib.import_module(f"{package}.scorers")
    interface = importlib.import_module(f"{package}.scoring_interface")
    contracts = importlib.import_module(f"{package}.contracts")
    register(scorers.SCORER_REGISTRY, interface.BaseScorer, contracts.ScoreBreakdown)
    node = importlib.import_module(f"{package}.unified_controller_node")
    end_when_finished(node.UnifiedControllerNode)
    node.main()


if __name__ == "__main__":
    main()
