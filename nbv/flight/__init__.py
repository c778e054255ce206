"""How the vehicle gets there: jerk-limited legs, detours around the rock, arrival errors, time and path."""

from nbv.flight.flight import Airspace, Flight
from nbv.flight.leg import Pose

__all__ = ["Airspace", "Flight", "Pose"]
