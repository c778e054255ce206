"""Routes for ground stations that speak MAVLink."""

from adapters.mavlink.plan import Home, qgc_plan

__all__ = ["Home", "qgc_plan"]
