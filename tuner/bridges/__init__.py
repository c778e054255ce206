"""Files of other programs: the authors' configuration and mission, QGroundControl's ``.plan``."""

from tuner.bridges.plan import Home, qgc_plan

__all__ = ["Home", "qgc_plan"]
