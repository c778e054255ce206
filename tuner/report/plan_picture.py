"""A plan from above and from the side: where photographs are taken, and where the planner may choose more."""

from __future__ import annotations

from collections.abc import Iterable

from nbv.config import MissionConfig
from nbv.rocks import DEFAULT_HEIGHT_M
from nbv.types import Viewpoint
from nbv.viewpoints import raw_candidates, seed_viewpoints

_WIDTH, _MARGIN = 250.0, 14.0  # of a panel, in the drawing's units
_TITLE = 20.0
_GREY, _BLUE, _ROCK = "#b8b8b8", "#0072B2", "#c9a98b"


def plan_picture(config: MissionConfig) -> str:
    """The plan as SVG: seeds in blue, in grey where planned views may be, the target's place in brown."""
    seeds = seed_viewpoints(config)
    pool = [v for v in raw_candidates(config) if _in_pool(v, config)] if config.adaptive_budget else []
    reach_m = max(max(abs(v.position_m[0]), abs(v.position_m[1])) for v in (*seeds, *pool))
    scale = (_WIDTH / 2 - _MARGIN) / reach_m
    top_m = max(v.position_m[2] for v in (*seeds, *pool))
    height = _TITLE + max(2 * reach_m, top_m) * scale + 2 * _MARGIN
    middle, ground = _TITLE + _MARGIN + reach_m * scale, height - _MARGIN
    rock = DEFAULT_HEIGHT_M * scale

    def above(v: Viewpoint) -> tuple[float, float]:
        return _WIDTH / 2 + v.position_m[0] * scale, middle - v.position_m[1] * scale

    def beside(v: Viewpoint) -> tuple[float, float]:
        return 1.5 * _WIDTH + v.position_m[0] * scale, ground - v.position_m[2] * scale

    def dots(views: Iterable[Viewpoint], size: float, fill: str) -> list[str]:
        return [
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size}" fill="{fill}"/>'
            for v in views
            for x, y in (above(v), beside(v))
        ]

    x = 1.5 * _WIDTH
    parts = [
        f'<circle cx="{_WIDTH / 2}" cy="{middle:.1f}" r="{rock / 2:.1f}" fill="{_ROCK}"/>',
        f'<rect x="{x - rock / 2:.1f}" y="{ground - rock:.1f}" width="{rock:.1f}" height="{rock:.1f}" rx="12" fill="{_ROCK}"/>',
        f'<line x1="{_WIDTH + 4}" x2="{2 * _WIDTH - 4}" y1="{ground:.1f}" y2="{ground:.1f}" stroke="{_GREY}"/>',
        *dots(pool, 1.8, _GREY),
        *dots(seeds, 3.6, _BLUE),
        f'<text x="4" y="14">from above, {2 * reach_m:.1f} m across</text>',
        f'<text x="{_WIDTH + 4}" y="14">from the side, up to {top_m:.1f} m high</text>',
    ]
    return (
        f'<svg class="drawing" id="plan" role="img" aria-label="The plan from above and from the side" '
        f'viewBox="0 0 {2 * _WIDTH:.0f} {height:.0f}">{"".join(parts)}</svg>'
    )


def _in_pool(view: Viewpoint, config: MissionConfig) -> bool:
    return config.pool.min_altitude_m <= view.position_m[2] <= config.pool.max_altitude_m
