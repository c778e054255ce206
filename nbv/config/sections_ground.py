"""The sections for what lies and blows around the target: ground and wind."""

from __future__ import annotations

from dataclasses import dataclass

from nbv.config.section import Section
from nbv.config.sources import ours

HIGHEST_RELIEF_M = 0.2
MOST_NEIGHBOURS = 12
HIGHEST_NEIGHBOUR_M = 1.5
WIDEST_GAP_M = 3.0


@dataclass(frozen=True)
class GroundConfig(Section):
    """What the ground has besides its texture (`nbv.terrain`); by default it is flat and empty."""

    relief_m: float = ours(
        0.0,
        "rms height of the ground, 0 to 0.2",
        why="LOLA slopes (Rosenburg 2011), scaled to 1 m: 0.05 is mare, 0.1 highland",
    )
    relief_length_m: float = ours(
        1.0, "its correlation length; rms slope is 1.4 relief / length", why="about the rock's size"
    )
    neighbours: int = ours(0, "other rocks about the target, beyond the evaluation's crop", why="0 to 12")
    neighbour_height_m: tuple[float, float] = ours(
        (0.4, 1.0), "their least and greatest height", why="at most 1.5: smaller than the target"
    )
    neighbour_gap_m: tuple[float, float] = ours(
        (0.1, 2.0), "how far beyond the crop they begin", why="at most 3: within the views' reach"
    )
    burial_m: float = ours(0.0, "how deep the target lies in the ground", why="less than its height")

    def __post_init__(self) -> None:
        self._need(0 <= self.relief_m <= HIGHEST_RELIEF_M, "relief_m", f"between 0 and {HIGHEST_RELIEF_M:g}")
        self._need(0.3 <= self.relief_length_m <= 5, "relief_length_m", "between 0.3 and 5")
        self._need(0 <= self.neighbours <= MOST_NEIGHBOURS, "neighbours", f"between 0 and {MOST_NEIGHBOURS}")
        low, high = self.neighbour_height_m
        rule = f"0.1 or more, in order, and at most {HIGHEST_NEIGHBOUR_M:g}"
        self._need(0.1 <= low <= high <= HIGHEST_NEIGHBOUR_M, "neighbour_height_m", rule)
        low, high = self.neighbour_gap_m
        rule = f"0.05 or more, in order, and at most {WIDEST_GAP_M:g}"
        self._need(0.05 <= low <= high <= WIDEST_GAP_M, "neighbour_gap_m", rule)
        self._need_at_least(0, "burial_m")


@dataclass(frozen=True)
class WindConfig(Section):
    """Wind on the flight (`nbv.flight.wind`); its direction is drawn per replicate."""

    mean_speed_m_s: float = ours(0.0, "mean speed, horizontal", why="with 3 gusts below flight.max_speed_m_s")
    gust_m_s: float = ours(
        0.0, "standard deviation of gusts", why="MIL-F-8785C near the ground: a fifth of the mean"
    )
    sway_s: float = ours(
        0.18,
        "hover error in m per m/s of gust",
        why="rotor drag 0.3 1/s against PX4's default loop of 1.7 1/s²",
    )

    def __post_init__(self) -> None:
        self._need_at_least(0, "mean_speed_m_s", "gust_m_s", "sway_s")

    @property
    def strongest_m_s(self) -> float:
        """Mean and three standard deviations of gusts."""
        return self.mean_speed_m_s + 3 * self.gust_m_s
