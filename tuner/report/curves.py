"""What `gatetune compare` found, in words, as tables, and in files: a figure, a page, CSV and JSON."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nbv.plugins import used
from nbv.provenance import provenance
from nbv.safe_files import json_ready, write_atomic
from nbv.types import Floats
from tuner.comparison.curves import CurvesOutcome, Finding, Series, Suite, leaves_room, panels
from tuner.comparison.statistics import Verdict
from tuner.export.table import write_rows
from tuner.problem.intervals import Interval
from tuner.report import figures as style
from tuner.report.labels import MISSING, Cell, Row, Table, ceiling_text, counted, difference_text
from tuner.report.pages import write_tables

_Curve = tuple[Floats, list[Interval]]
SHOWN = {
    Verdict.BETTER: "fewer",
    Verdict.WORSE: "more",
    Verdict.NO_DIFFERENCE: "no difference is shown",
    Verdict.NO_INTERVAL: "too few targets for an interval",
}


def write_curves(
    suite: Suite, series: Sequence[Series], outcome: CurvesOutcome, directory: Path
) -> dict[str, Any]:
    """Write ``report.html``, ``curves.png``, ``curves.csv``, ``targets.csv`` and ``curves.json``; return the last."""
    curves, lines = panels(suite, series), verdict_lines(suite, outcome)
    made = {**provenance(), **used()}
    about = {"suite": suite.name, "settings": suite.to_dict(), "provenance": made, "verdict": lines}
    document: dict[str, Any] = json_ready({**about, "by_share": outcome.by_share, **vars(outcome)})
    write_atomic(directory / "curves.json", json.dumps(document, indent=1))
    write_rows(
        directory / "curves.csv",
        ("strategy", "setting", "photographs", "f_score_percent", "low", "high", "share", "score_0"),
        (
            (one.name, k, n, f.mean, f.low, f.high, share.mean / 100, (one.scores[k] == 0.0).sum())
            for one, (numbers, means), (_, shares) in zip(series, curves[""], curves["share"])
            for k, (n, f, share) in enumerate(zip(numbers, means, shares))
        ),
        digits=4,
    )
    write_rows(
        directory / "targets.csv",
        ("strategy", "target", "photographs", "f_score_percent"),
        (
            (one.name, target.label, *cell)
            for one in series
            for r, target in enumerate(suite.targets)
            for cell in zip(one.photographs[:, r], one.scores[:, r])
        ),
        digits=4,
    )
    figure = _figure(suite, series, curves)
    style.save_figure(figure, directory, "curves")
    numbers = dict.fromkeys(row.photographs for row in outcome.standings)
    dagger = "sees the true surface and is no planner. "
    plugins = "".join(f"; {plugin_text(*each)}" for each in made.get("plugins", {}).items())
    write_tables(
        directory / "report.html",
        "Planners against orbits",
        f"suite {suite.name}: {len(suite.targets)} targets, {suite.numbers[0]} to {suite.numbers[-1]} photographs",
        lines=lines,
        failed=failed_lines(series),
        figure=style.embed(figure),
        figure_caption=(
            "F-score at 48 mm over the number of photographs, all targets and by family, and the share of targets that reach the "
            f"score. Bands: 95 % bootstrap intervals over targets. {f'Dashed: {dagger}' if outcome.ground_truth else ''}"
            "Curves may leave an axis at its lower end."
        ),
        tables=[
            *([share_table(suite, outcome)] if outcome.by_share else []),
            number_table(suite, outcome, *numbers),
        ],
        footer=f"{f'† {dagger}' if outcome.ground_truth else ''}Revision {made['revision']}{plugins}. A suite fixes settings, not the program: cite both.",
    )
    return document


def plugin_text(name: str, facts: Mapping[str, str]) -> str:
    """``mine of a file``, ``mine of a-package 1.0, source 0a1b2c3d``."""
    of = f"{name} of {facts['distribution'] or 'a file'} {facts['version']}".rstrip()
    return f"{of}, source {facts['source'][:8]}" if facts["source"] else of


# -- sentences -----------------------------------------------------------------------------------------------


def verdict_lines(suite: Suite, outcome: CurvesOutcome) -> list[str]:
    """The outcome, a sentence for each strategy; then what a planner could gain."""
    score, reference = suite.score, outcome.reference
    base = next(f for f in outcome.findings if f.strategy == reference)
    share, to_it = f"{100 * outcome.share:g} %", f"of the targets to an F-score of {score:g} %"
    lines = list[str]()
    if base.reached < suite.share - 1e-9:
        lines.append(
            f"{reference} brings at most {100 * base.reached:.0f} % {to_it}, not the {100 * suite.share:g} % asked for; "
            "mean F-scores are compared instead."
        )
    if base.fewest:
        few = f"already the fewest photographs tried ({base.needed:.1f}) bring {share} {to_it}"
        lines.append(
            f"With {reference} {few}; ask for a higher --score, or begin --numbers with a smaller one."
        )
    if not outcome.by_share:
        lines.append(_scores(outcome))
    else:
        if not base.fewest:
            lines.append(f"{reference} needs {base.needed:.1f} photographs to bring {share} {to_it}.")
        lines += [_needs(f, reference) for f in outcome.findings if f.strategy != reference]
    if outcome.ceiling is not None:
        plain = f"{outcome.plain} with {outcome.number} photographs"
        lines.append(ceiling_text(outcome.ceiling, plain, room=leaves_room(outcome.ceiling)))
    return lines


def _needs(f: Finding, reference: str) -> str:
    if f.ratio is None:
        return f"{f.strategy} never does so: it brings at most {100 * f.reached:.0f} % of them there."
    times = f"{'at most ' if f.fewest else ''}{difference_text(f.ratio, 2, signed=False)}"
    return f"{f.strategy} needs {times} times as many photographs as {reference}: {SHOWN[f.kind]}."


def _scores(outcome: CurvesOutcome) -> str:
    """``Mean F-score with 34 photographs, minus that of orbit: better: mine +1.20 [+0.30, +2.10]; worse: ...``."""
    groups: dict[str, list[str]] = {}
    for s in outcome.standings:
        if s.photographs == outcome.number and s.strategy != outcome.reference:
            shown = {Verdict.BETTER: "better", Verdict.WORSE: "worse"}.get(s.kind) or SHOWN[s.kind]
            groups.setdefault(shown, []).append(f"{s.strategy} {difference_text(s.gain, 2)}")
    listed = "; ".join(f"{shown}: {', '.join(names)}" for shown, names in groups.items())
    return f"Mean F-score with {outcome.number} photographs, minus that of {outcome.reference}: {listed or MISSING}."


def failed_lines(series: Sequence[Series]) -> list[str]:
    """Why missions failed, which count with a score of 0: a line for each strategy and reason."""
    lines = dict[str, None]()
    for one in series:
        counts = Counter(trial.reason for trial in one.failed)
        last = {trial.reason: trial for trial in one.failed}
        for reason, t in last.items():
            where = f"{t.strategy} on {t.instance.label}: {t.record.message}"
            lines[f"{counted(counts[reason], 'mission')} failed ({reason}), such as {where}."] = None
    return list(lines)


# -- tables --------------------------------------------------------------------------------------------------


def answer_table(suite: Suite, outcome: CurvesOutcome) -> Table:
    """What each strategy needs for the share or, where no share is compared, its mean score."""
    return share_table(suite, outcome) if outcome.by_share else number_table(suite, outcome, outcome.number)


def share_table(suite: Suite, outcome: CurvesOutcome) -> Table:
    share, score = 100 * outcome.share, suite.score
    rows = [
        (
            _marked(outcome, f.strategy),
            "never" if f.needed is None else f"{'≤ ' if f.fewest else ''}{f.needed:.1f}",
            difference_text(f.ratio, 2, signed=False),
            f"{100 * f.reached:.0f} %",
        )
        for f in outcome.findings
    ]
    title = f"Photographs until {share:g} % of the targets have an F-score of {score:g} %, and their ratio to {outcome.reference}"
    return Table.of(title, ("strategy", "photographs", "ratio", "largest share"), rows)


def number_table(suite: Suite, outcome: CurvesOutcome, *numbers: int) -> Table:
    rows: list[Row] = []
    for number in numbers:
        rows.append(Row(f"{number} photographs"))
        for s in (s for s in outcome.standings if s.photographs == number):
            texts = (
                difference_text(s.f_score, 2, signed=False),
                MISSING if s.strategy == outcome.reference else difference_text(s.gain, 2),
                f"{100 * s.share:.0f} %",
                str(s.score_0),
            )
            rows.append(Row(_marked(outcome, s.strategy), tuple(map(Cell, texts))))
    share = f"share at {suite.score:g} %"
    head = ("strategy", "F-score, %", f"minus {outcome.reference}", share, "score 0")
    return Table("Mean F-score at equal number of photographs", head, rows)


def _marked(outcome: CurvesOutcome, name: str) -> str:
    return f"{name} †" if name in outcome.ground_truth else name


# -- files ---------------------------------------------------------------------------------------------------


def _figure(suite: Suite, series: Sequence[Series], panels: Mapping[str, Sequence[_Curve]]) -> Figure:
    titles = {"share": f"share of targets at {suite.score:g} %", "": "F-score, all targets"}
    columns = min(4, len(panels))
    rows = -(-len(panels) // columns)
    with style.look():
        figure = style.new_figure(3.1 * columns, 2.6 * rows + 0.6)
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis, (name, curves) in zip(axes, panels.items()):
            _panel(axis, series, curves)
            axis.set_title(titles.get(name, f"F-score, {name}"), fontsize=9)
        for axis in axes[len(panels) :]:
            axis.set_visible(False)
        for axis in axes[max(0, len(panels) - columns) : len(panels)]:
            axis.set_xlabel("photographs (mean)")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _panel(axis: Axes, series: Sequence[Series], curves: Sequence[_Curve]) -> None:
    for index, (one, (x, means)) in enumerate(zip(series, curves)):
        y, low, high = np.array([(i.mean, i.low, i.high) for i in means], dtype=float).T  # None: NaN
        axis.plot(x, y, "--" if one.sees_ground_truth else "-", color=f"C{index}", label=one.name, lw=1.4)
        axis.fill_between(x, low, high, color=f"C{index}", alpha=0.12, lw=0)
    lowest = min(i.mean for _, means in curves for i in means[len(means) // 4 :])
    axis.set_ylim(max(0.0, lowest - 1.0), 100.0)
