"""Table I of the paper, as printed: one mission per strategy, distances in mm, shares in percent."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MetricRow:
    """One line of a table in the layout of Table I."""

    group: str
    label: str
    key: str  # path of the metric, with the surface as its first part
    unit: str
    higher_is_better: bool
    decimals: int = 1

    @property
    def floor_key(self) -> str:
        """Where missions hold the rock's own floor of this metric, if it has one."""
        return self.key.removesuffix("_mm") + "_floor_mm"

    def on(self, surface: str) -> MetricRow:
        """The same row on another surface, ``whole`` or ``observable``."""
        rest = self.key.partition(".")[2]
        return MetricRow(
            self.group, self.label, f"{surface}.{rest}", self.unit, self.higher_is_better, self.decimals
        )


_DISTANCES, _AT_48, _AT_80 = "Dense cloud vs. GT", "Thresholded @ 48 mm", "Thresholded @ 80 mm"
TABLE_I_ROWS: tuple[MetricRow, ...] = (
    MetricRow(_DISTANCES, "Hausdorff", "whole.hausdorff_gt_to_cloud_mm", "mm", False),
    MetricRow(_DISTANCES, "Mean C2C", "whole.c2c_mean_mm", "mm", False),
    MetricRow(_DISTANCES, "Median C2C", "whole.c2c_median_mm", "mm", False),
    MetricRow(_DISTANCES, "P95 C2C", "whole.c2c_p95_mm", "mm", False),
    MetricRow(_AT_48, "Completeness", "whole.completeness_48mm", "%", True),
    MetricRow(_AT_48, "F-score", "whole.f_score_48mm", "%", True),
    MetricRow(_AT_80, "Completeness", "whole.completeness_80mm", "%", True),
    MetricRow(_AT_80, "F-score", "whole.f_score_80mm", "%", True),
)
# Torre et al., Table I. Columns: Covis, B-aware, Hyb-H, Hyb-O.
PAPER_TABLE_I: dict[str, dict[str, float]] = {
    strategy: dict(zip((row.key for row in TABLE_I_ROWS), column))
    for strategy, column in {
        "covis": (480.9, 66.0, 39.0, 245.6, 56.0, 72.0, 75.0, 86.0),
        "b-aware": (522.6, 79.4, 48.9, 293.0, 49.0, 66.0, 67.0, 80.0),
        "hyb-h": (535.1, 79.7, 47.3, 298.4, 50.0, 67.0, 66.0, 79.5),
        "hyb-o": (465.1, 59.8, 38.7, 223.3, 59.0, 73.0, 80.0, 89.0),
    }.items()
}
