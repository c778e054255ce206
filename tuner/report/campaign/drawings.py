"""Small drawings of the first screen as inline SVG, and the error clouds as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup, escape
from matplotlib.colors import Normalize

from nbv.cache import Store
from nbv.errors import UserError
from nbv.types import Floats
from tuner.campaign.showcase import SHOWN
from tuner.missions.registry import is_geometric
from tuner.report.campaign.answers import EQUAL, GateRow, Pair
from tuner.report.labels import format_number, strategy_label
from tuner.report.mission.run_files import mission_config, read_result
from tuner.report.mission.walk_data import measured_cloud
from tuner.report.mission.walk_world import World, make_world, the_rock
from tuner.report.style import BLUE, GREY, ORANGE, SEQUENTIAL, Illustration, embed, look, new_figure

_WIDTH, _ROW = 460, 20
_MOST_ROWS = 16
_MOST_GATE_ROWS = 8
_SCORERS = {"covis": (BLUE, "C", "#fff"), "b-aware": (ORANGE, "B", "#000"), EQUAL: ("#d9dee3", "=", "#000")}
_FAR_MM = 24.0  # of the colour scale
_AZIMUTH_DEG, _ELEVATION_DEG = 35.0, 25.0


def pairs_drawing(pairs: Sequence[Pair], metric: str, digits: int) -> Markup:
    """Default (ring) against recommended (disc) on every rock, condition and replicate; empty without missions."""
    known = [v for p in pairs for v in (p.default, p.recommended) if v is not None]
    if not known:
        return Markup("")
    shown = sorted(pairs, key=lambda p: (p.default is None) + (p.recommended is None))[:_MOST_ROWS]
    low, high = min(known), max(known)
    room = (high - low) * 0.08 or 1.0
    low, high = low - room, high + room
    left = 8 + min(190.0, 6.4 * max(len(p.place) for p in shown))

    def x(value: float) -> float:
        return left + (value - low) / (high - low) * (_WIDTH - left - 12)

    parts, y = [], 0.0
    for i, p in enumerate(shown):
        y = 14.0 + i * _ROW
        parts.append(f'<text x="0" y="{y + 4:.0f}">{escape(_cut(p.place))}</text>')
        parts.append(f'<line x1="{left:.0f}" x2="{_WIDTH}" y1="{y:.0f}" y2="{y:.0f}" stroke="#e9ecef"/>')
        said = []
        if p.default is not None and p.recommended is not None:
            parts.append(
                f'<line x1="{x(p.default):.1f}" x2="{x(p.recommended):.1f}" y1="{y:.0f}" y2="{y:.0f}" stroke="{GREY}" stroke-width="2"/>'
            )
        if p.recommended is not None:
            parts.append(f'<circle cx="{x(p.recommended):.1f}" cy="{y:.0f}" r="5.5" fill="{BLUE}"/>')
            said.append(f"recommended {format_number(p.recommended, digits)}")
        if p.default is not None:
            parts.append(
                f'<circle cx="{x(p.default):.1f}" cy="{y:.0f}" r="4.5" fill="none" stroke="#000" stroke-width="1.8"/>'
            )
            said.append(f"default {format_number(p.default, digits)}")
        parts.append(
            f'<rect x="0" y="{y - 9:.0f}" width="{_WIDTH}" height="18" fill="transparent"><title>{escape(p.place)}: {", ".join(said)}</title></rect>'
        )
    y += 22
    for value, anchor in ((low + room, "start"), (high - room, "end")):
        parts.append(
            f'<text x="{x(value):.0f}" y="{y:.0f}" text-anchor="{anchor}" class="soft">{format_number(value, digits)}</text>'
        )
    if len(pairs) > len(shown):
        parts.append(f'<text x="0" y="{y:.0f}" class="soft">and {len(pairs) - len(shown)} more</text>')
    y += 18
    parts.append(
        f'<circle cx="6" cy="{y - 4:.0f}" r="4.5" fill="none" stroke="#000" stroke-width="1.8"/><text x="16" y="{y:.0f}">default</text>'
        f'<circle cx="76" cy="{y - 4:.0f}" r="5.5" fill="{BLUE}"/><text x="86" y="{y:.0f}">recommended</text>'
        f'<text x="{_WIDTH}" y="{y:.0f}" text-anchor="end" class="soft">{escape(metric)}</text>'
    )
    return _svg(parts, y + 6, "Default and recommended configuration wherever they flew.")


def gate_drawing(rows: Sequence[GateRow]) -> Markup:
    """One line per mission, one cell per adaptive capture, lettered."""
    shown = rows[:_MOST_GATE_ROWS]
    if not shown:
        return Markup("")
    left = 8 + min(170.0, 6.4 * max(len(row.name) for row in shown))
    cell = min(22.0, (_WIDTH - left) / max(len(row.choices) for row in shown))
    parts, found = [], dict.fromkeys(c for row in shown for c in row.choices)
    for i, row in enumerate(shown):
        y = i * _ROW
        parts.append(f'<text x="0" y="{y + 13}">{escape(_cut(row.name))}</text>')
        for k, choice in enumerate(row.choices):
            parts.append(_cell(left + k * cell, y, cell - 1, choice, f"capture {k + 1}: {_name(choice)}"))
    y, at = len(shown) * _ROW + 4, 0.0
    for choice in found:
        parts.append(_cell(at, y, 14, choice, _name(choice)))
        parts.append(f'<text x="{at + 18:.0f}" y="{y + 13}">{escape(_name(choice))}</text>')
        at += 30 + 6.6 * len(_name(choice))
    return _svg(parts, y + 20, "Which scorer chose each adaptive view of each mission.")


def clouds_picture(directory: Path, figures: Path) -> Illustration | None:
    """The default's and the recommended mission's clouds, coloured by distance to the truth; None where neither was measured.

    ``directory`` is the campaign's; its ``shown/`` holds the two missions (`tuner.campaign.showcase`).
    """
    found: list[tuple[str, Floats, Floats]] = []
    world, rock = None, ""
    for name in ("default", "recommended"):
        run = directory / SHOWN / name
        try:
            result = read_result(run)
            if is_geometric(result["provenance"].get("fidelity", "")):
                return None
            cloud = measured_cloud(run)
            if cloud is None:
                continue
            config, store = mission_config(run), Store()
            world = world or make_world(config, the_rock(run, result, None, store), store)
        except UserError:
            continue
        rock = str(result["rock"])
        points = cloud[0][world.near(cloud[0])]
        found.append((name, points, world.errors_mm(points)))
    if world is None or not found:
        return None
    with look():
        figure = new_figure(5.2 * len(found), 4.1)
        axes = figure.subplots(1, len(found), squeeze=False)[0]
        for ax, (name, points, errors) in zip(axes, found):
            across, up, order = _projected(points, world)
            dots = ax.scatter(
                across[order],
                up[order],
                c=errors[order],
                s=1.2,
                linewidths=0,
                cmap=SEQUENTIAL,
                norm=Normalize(0, _FAR_MM),
                rasterized=True,
            )
            far = 100 * float(np.mean(errors > _FAR_MM))
            worth = f"median {np.median(errors):.1f} mm, {far:.0f} % beyond {_FAR_MM:.0f} mm"
            ax.set_title(f"{name}: {len(points)} points, {worth}")
            ax.set_aspect("equal")
            ax.set_axis_off()
        limits = np.array([[*ax.get_xlim(), *ax.get_ylim()] for ax in axes])
        for ax in axes:
            ax.set_xlim(limits[:, 0].min(), limits[:, 1].max())
            ax.set_ylim(limits[:, 2].min(), limits[:, 3].max())
        figure.colorbar(dots, ax=list(axes), label="distance to the truth (mm)", shrink=0.8, extend="max")
    one = "" if len(found) == 2 else f" Only the {found[0][0]} was flown whole."
    return embed(
        figure,
        "clouds",
        "Point clouds of the default's and the recommended mission, coloured by their distance to the true surface.",
        f"Reconstructed clouds, bright where far from the rock and the ground, on {Path(rock).stem}, seen from the same side.{one}",
        figures,
        form="png",
    )


def _projected(points: Floats, world: World) -> tuple[Floats, Floats, np.ndarray]:
    """Across, up and the order from far to near, seen from one side."""
    azimuth, elevation = np.radians(_AZIMUTH_DEG), np.radians(_ELEVATION_DEG)
    x, y, z = (points - world.origin_m).T
    across = -np.sin(azimuth) * x + np.cos(azimuth) * y
    towards = np.cos(azimuth) * x + np.sin(azimuth) * y
    return (
        across,
        z * np.cos(elevation) - towards * np.sin(elevation),
        np.argsort(towards * np.cos(elevation) + z * np.sin(elevation)),
    )


def _cell(x: float, y: float, width: float, choice: str, title: str) -> str:
    fill, letter, ink = _SCORERS.get(choice, ("#fff", choice[:1].upper(), "#000"))
    text = (
        f'<text x="{x + width / 2:.1f}" y="{y + 12.5}" text-anchor="middle" style="fill:{ink};font-size:10px">{escape(letter)}</text>'
        if width >= 9
        else ""
    )
    return (
        f'<g><title>{escape(title)}</title><rect x="{x:.1f}" y="{y + 1}" width="{width:.1f}" height="16" fill="{fill}" '
        f'stroke="#8c959f" stroke-width=".5"/>{text}</g>'
    )


def _name(choice: str) -> str:
    return "both the same view" if choice == EQUAL else strategy_label(choice)


def _cut(text: str) -> str:
    return text if len(text) <= 30 else text[:29] + "…"


def _svg(parts: Sequence[str], height: float, label: str) -> Markup:
    return Markup(
        f'<svg class="drawing" viewBox="0 0 {_WIDTH} {height:.0f}" role="img" aria-label="{escape(label)}">{"".join(parts)}</svg>'
    )
