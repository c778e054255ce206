"""How the vehicle gets there: jerk-limited legs, detours around the rock, arrival errors, time and path."""

from nbv.flight.flight import Flight
from nbv.flight.leg import Pose
from nbv.flight.route import Airspace

__all__ = ["Airspace", "Flight", "Pose"]
