"""How the vehicle gets there: jerk-limited legs, detours around the rock, arrival errors, time and path."""

from nbv.flight.flight import Flight
from nbv.flight.leg import Pose
from nbv.flight.route import route

__all__ = ["Flight", "Pose", "route"]
