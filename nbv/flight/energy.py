"""Electrical energy of a flight, by momentum theory.

A rotor disc of area A that carries the weight T accelerates air of density rho to v_h = sqrt(T / (2 rho A)) in hover; in a
climb at v its ideal power is

    P(v) = T (v / 2 + sqrt((v / 2)^2 + v_h^2))

(Leishman, Principles of Helicopter Aerodynamics, 2nd ed., section 2.13). In a descent slower than 2 v_h, the vortex-ring
state, momentum theory does not hold; it counts as hover. So does level flight: its induced power is 3 % less at 2 m/s, the
mean of a short leg, and a sixth less at 5 m/s, of which drag takes back a part. Rotors, motors and controllers turn electrical into
ideal power with one efficiency. Avionics and camera are not in it.
"""

from __future__ import annotations

import math

from nbv.config import FlightConfig
from nbv.flight.leg import Leg

GRAVITY_M_S2 = 9.81
AIR_KG_M3 = 1.225  # sea level, 15 degrees: ISO 2533
ROTORS = 4
J_PER_WH = 3600.0


def power_w(vehicle: FlightConfig, climb_m_s: float = 0.0) -> float:
    """Electrical power in hover, or in a climb; a descent counts as hover."""
    weight_n = vehicle.mass_kg * GRAVITY_M_S2
    disc_m2 = ROTORS * math.pi * (vehicle.rotor_diameter_m / 2) ** 2
    half = max(0.0, climb_m_s) / 2
    ideal_w = weight_n * (half + math.sqrt(half**2 + weight_n / (2 * AIR_KG_M3 * disc_m2)))
    return ideal_w / vehicle.propulsion_efficiency


def leg_energy_wh(vehicle: FlightConfig, leg: Leg) -> float:
    """Of one leg, at its mean climb rate."""
    if leg.duration_s <= 0:
        return 0.0
    climb_m_s = (leg.end.position_m[2] - leg.start.position_m[2]) / leg.duration_s
    return power_w(vehicle, climb_m_s) * leg.duration_s / J_PER_WH
