"""How the vehicle gets there: jerk-limited legs, detours around the rock, arrival errors, time and path."""

from nbv.flight.arrival import arrival_position
from nbv.flight.flight import Flight
from nbv.flight.leg import Leg, Pose, fly_straight
from nbv.flight.route import route

__all__ = ["Flight", "Leg", "Pose", "arrival_position", "fly_straight", "route"]
