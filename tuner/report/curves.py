"""The files that `gatetune compare` writes: a figure, a page, tables as CSV and JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nbv.mission.result import json_ready
from nbv.provenance import provenance
from nbv.rocks.families import generated_name
from nbv.safe_files import write_atomic
from nbv.types import Floats, Ints
from tuner.evaluation import curves
from tuner.evaluation.curves import Series, Suite
from tuner.missions.job import Trial
from tuner.report import style
from tuner.report.labels import MISSING
from tuner.report.pages import write_page
from tuner.report.table import Table

AT_NUMBERS = (16, 20, 24, 32, 40)


def write_comparison(
    suite: Suite, strategies: Sequence[str], reference: str, records: Sequence[Trial], directory: Path
) -> dict[str, Any]:
    """Write ``report.html``, ``curves.svg``, ``curves.csv``, ``targets.csv`` and ``comparison.json``; return the last.

    ``reference``: the strategy of the ratios and gains.
    """
    series = curves.all_series(suite, strategies, records)
    base = next(one for one in series if one.name == reference)
    share = curves.share_compared(base, suite.share, suite.score)
    findings = curves.at_share(series, base, share, suite.score)
    said = curves.verdict(findings, reference, suite.share, share, suite.score)
    numbers = [n for n in AT_NUMBERS if suite.numbers[0] <= n <= suite.numbers[-1]] or [suite.numbers[-1]]
    document: dict[str, Any] = json_ready(
        {
            "suite": suite.name,
            "provenance": provenance(),
            "settings": suite.to_dict(),
            "strategies": list(strategies),
            "ground_truth": [one.name for one in series if one.sees_ground_truth],
            "reference": reference,
            "share": share,
            "score_0": curves.what_scores_0(series, suite.targets),
            "verdict": " ".join(said),
            "at_share": findings,
            "at_number": [row for n in numbers for row in curves.at_number(series, base, n, suite.score)],
        }
    )
    write_atomic(directory / "comparison.json", json.dumps(document, indent=1))
    _write_csv(
        directory / "curves.csv",
        ("strategy", "setting", "photographs", "f_score_percent", "low", "high", "share", "score_0"),
        (
            (
                *(one.name, k, one.photographs[k].mean(), *curves.mean_interval(row)),
                *((row >= suite.score).mean(), (row == 0.0).sum()),
            )
            for one in series
            for k, row in enumerate(one.scores)
        ),
    )
    _write_csv(
        directory / "targets.csv",
        ("strategy", "target", "photographs", "f_score_percent"),
        (
            (one.name, target, *cell)
            for one in series
            for r, target in enumerate(suite.targets)
            for cell in zip(one.photographs[:, r], one.scores[:, r])
        ),
    )
    figure = _figure(suite, series)
    style.save_figure(figure, directory, "curves")
    write_page(
        directory / "report.html",
        "curves.html.j2",
        title="Planners against orbits",
        sub=f"suite {suite.name}: {len(suite.targets)} targets, {suite.numbers[0]} to {suite.numbers[-1]} photographs",
        provenance=document["provenance"],
        verdict=said,
        score_0=document["score_0"],
        figure=style.embed(figure),
        tables=[share_table(document), _number_table(document)],
    )
    return document


def share_table(document: Mapping[str, Any]) -> Table:
    """Return what each strategy needs for the share."""
    share, score = 100 * document["share"], document["settings"]["score"]
    title = f"Photographs until {share:g} % of the targets have an F-score of {score:g} %, and their ratio to {document['reference']}"
    if not share:
        title = f"Largest share of targets that have an F-score of {score:g} %"
    rows = [
        (
            _marked(document, f["name"]),
            "never" if f["needed"] is None else f"{'≤ ' if f['fewest'] else ''}{f['needed']:.1f}",
            curves.interval_text(f["ratio"]),
            f"{100 * f['reached']:.0f} %",
        )
        for f in document["at_share"]
    ]
    return Table.of(title, ("strategy", "photographs", "ratio", "largest share"), rows)


def _number_table(document: Mapping[str, Any]) -> Table:
    rows = [
        (
            f"{_marked(document, row['strategy'])}, {row['photographs']}",
            curves.interval_text(row["f_score"]),
            curves.interval_text(row["gain"], "+.2f") or MISSING,
            f"{100 * row['share']:.0f} %",
            str(row["score_0"]),
        )
        for row in document["at_number"]
    ]
    at = f"share at {document['settings']['score']:g} %"
    head = ("strategy, photographs", "F-score, %", f"minus {document['reference']}", at, "score 0")
    return Table.of("At equal number of photographs", head, rows)


def _marked(document: Mapping[str, Any], name: str) -> str:
    return f"{name} †" if name in document["ground_truth"] else name


def _write_csv(path: Path, head: Sequence[str], rows: Any) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([f"{c:.4f}" if isinstance(c, float) else c for c in row] for row in rows)
    write_atomic(path, text.getvalue())


def _figure(suite: Suite, series: Sequence[Series]) -> Figure:
    everyone, of_family = np.arange(len(suite.targets)), dict[str, list[int]]()
    for r, target in enumerate(suite.targets):
        named = generated_name(target)
        of_family.setdefault(named[0] if named else "others", []).append(r)
    scores = [one.scores for one in series]
    reached = [np.where(own >= suite.score, 100.0, 0.0) for own in scores]
    panels = [
        (f"share of targets at {suite.score:g} %", reached, everyone),
        ("F-score, all targets", scores, everyone),
    ]
    if len(of_family) > 1:
        panels += [(f"F-score, {family}", scores, np.array(of)) for family, of in of_family.items()]
    columns = min(4, len(panels))
    rows = -(-len(panels) // columns)
    with style.look():
        figure = style.new_figure(3.1 * columns, 2.6 * rows + 0.6)
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis, (title, values, of) in zip(axes, panels):
            _panel(axis, title, series, values, of)
        for axis in axes[len(panels) :]:
            axis.set_visible(False)
        for axis in axes[max(0, len(panels) - columns) : len(panels)]:
            axis.set_xlabel("photographs (mean)")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _panel(axis: Axes, title: str, series: Sequence[Series], values: Sequence[Floats], of: Ints) -> None:
    for index, (one, own) in enumerate(zip(series, values)):
        x, y, colour = one.mean_photographs(of), own[:, of].mean(axis=1), f"C{index}"
        axis.plot(x, y, "--" if one.sees_ground_truth else "-", color=colour, label=one.name, lw=1.4)
        low, high = curves.bounds(np.mean, own[:, of])
        if low is not None:
            axis.fill_between(x, low, high, color=colour, alpha=0.12, lw=0)
    axis.set_title(title, fontsize=9)
    lowest = min(float(v[len(v) // 4 :, of].mean(axis=1).min()) for v in values)
    axis.set_ylim(max(0.0, lowest - 1.0), 100.0)
