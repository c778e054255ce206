"""What `gatetune compare` found, in words, as tables, and in files: a figure, a page, CSV and JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nbv.mission.result import json_ready
from nbv.provenance import provenance
from nbv.safe_files import write_atomic
from tuner.evaluation.curves import Curve, Finding, Outcome, Standing, Zero
from tuner.evaluation.verdict import Kind
from tuner.report import style
from tuner.report.labels import MISSING, ceiling_text, counted, difference_text
from tuner.report.pages import write_page
from tuner.report.table import Cell, Row, Table

SHOWN = {
    Kind.BETTER: "fewer",
    Kind.WORSE: "more",
    Kind.NO_DIFFERENCE: "no difference is shown",
    Kind.NO_INTERVAL: "too few targets for an interval",
}


def write_curves(found: Outcome, directory: Path) -> dict[str, Any]:
    """Write ``report.html``, ``curves.png``, ``curves.csv``, ``targets.csv`` and ``curves.json``; return the last."""
    suite, targets = found.suite, [target.label for target in found.suite.targets]
    panels, said = found.panels(), verdict_lines(found)
    document: dict[str, Any] = json_ready(
        {
            "suite": suite.name,
            "provenance": provenance(),
            "settings": suite.to_dict(),
            "strategies": [one.name for one in found.series],
            "ground_truth": _ground_truth(found),
            "reference": found.reference,
            "share": found.share,
            "number": found.number,
            "at_share": found.findings,
            "at_number": found.standings,
            "plain": found.plain,
            "ceiling": found.ceiling,
            "score_0": found.score_0,
            "verdict": said,
        }
    )
    write_atomic(directory / "curves.json", json.dumps(document, indent=1))
    _write_csv(
        directory / "curves.csv",
        ("strategy", "setting", "photographs", "f_score_percent", "low", "high", "share", "score_0"),
        (
            (curve.name, k, n, f.mean, f.low, f.high, reached.mean / 100, sum(one.scores[k] == 0.0))
            for one, curve, shares in zip(found.series, panels[""], panels["share"])
            for k, (n, f, reached) in enumerate(zip(curve.photographs, curve.means, shares.means))
        ),
    )
    _write_csv(
        directory / "targets.csv",
        ("strategy", "target", "photographs", "f_score_percent"),
        (
            (one.name, target, *cell)
            for one in found.series
            for r, target in enumerate(targets)
            for cell in zip(one.photographs[:, r], one.scores[:, r])
        ),
    )
    figure = _figure(found, panels)
    style.save_figure(figure, directory, "curves")
    numbers = dict.fromkeys(row.photographs for row in found.standings)
    write_page(
        directory / "report.html",
        "curves.html.j2",
        title="Planners against orbits",
        sub=f"suite {suite.name}: {len(targets)} targets, {suite.numbers[0]} to {suite.numbers[-1]} photographs",
        revision=document["provenance"]["revision"],
        plugins=[plugin_text(*each) for each in document["provenance"].get("plugins", {}).items()],
        verdict=said,
        score_0=[zero_text(zero, len(targets)) for zero in found.score_0],
        dagger=bool(document["ground_truth"]),
        figure=style.embed(figure),
        tables=[*([share_table(found)] if found.share else []), number_table(found, *numbers)],
    )
    return document


def plugin_text(name: str, facts: Mapping[str, str]) -> str:
    """``mine of a file``, ``mine of a-package 1.0, source 0a1b2c3d``."""
    of = f"{name} of {facts['distribution'] or 'a file'} {facts['version']}".rstrip()
    return f"{of}, source {facts['source'][:8]}" if facts["source"] else of


# -- sentences -----------------------------------------------------------------------------------------------


def verdict_lines(found: Outcome) -> list[str]:
    """The outcome, a sentence for each strategy; then what a planner could gain."""
    score, reference = found.suite.score, found.reference
    base = next(f for f in found.findings if f.strategy == reference)
    to_it = f"of the targets to an F-score of {score:g} %"
    instead = f"{100 * found.share:g} %" if found.share else "mean F-scores"
    said = []
    if base.reached < found.suite.share - 1e-9:
        said.append(
            f"{reference} brings at most {100 * base.reached:.0f} % {to_it}, not the {100 * found.suite.share:g} % asked for; "
            f"{instead} are compared instead."
        )
    if base.fewest:
        few = f"brings {100 * found.suite.share:g} % {to_it} with the fewest photographs tried"
        said.append(f"{reference} {few}; ask for a higher --score, or begin --numbers with a smaller one.")
    if found.share:
        said.append(
            f"{reference} needs {base.needed:.1f} photographs to bring {100 * found.share:g} % {to_it}."
        )
        said += [_needs(f, reference) for f in found.findings if f.strategy != reference]
    else:
        said += [_stands(s, reference) for s in found.standings if s.photographs == found.number]
    if found.ceiling is not None:
        said.append(ceiling_text(found.ceiling, found.plain, room=bool(found.planners_may_gain)))
    return said


def _needs(f: Finding, reference: str) -> str:
    if f.ratio is None:
        return f"{f.strategy} never does so: it brings at most {100 * f.reached:.0f} % of them there."
    times = f"{'at most ' if f.fewest else ''}{difference_text(f.ratio, 2, signed=False)}"
    return f"{f.strategy} needs {times} times as many photographs as {reference}: {SHOWN[f.kind]}."


def _stands(s: Standing, reference: str) -> str:
    has = f"{s.strategy} has a mean F-score of {difference_text(s.f_score, signed=False)} %"
    if s.strategy == reference or s.gain is None:
        return f"{has} with {s.photographs} photographs."
    shown = {Kind.BETTER: "better", Kind.WORSE: "worse"}.get(s.kind) or SHOWN[s.kind]
    return f"{has}, {difference_text(s.gain)} points from {reference}: {shown}."


def zero_text(zero: Zero, targets: int) -> str:
    """Why targets count with a score of 0; ``targets``: of the comparison."""
    of = f"all {targets} targets" if len(zero.targets) == targets > 1 else "; ".join(zero.targets)
    if zero.reason:
        return f"{zero.strategy}: {counted(zero.missions, 'mission')} failed ({zero.reason}) on {of}; {zero.example}."
    span = " to ".join(dict.fromkeys(f"{n:g}" for n in zero.photographs))
    return f"{zero.strategy}: no model yet with {span} photographs on {of}."


# -- tables --------------------------------------------------------------------------------------------------


def answer_table(found: Outcome) -> Table:
    """What each strategy needs for the share or, where no share is compared, its mean score."""
    return share_table(found) if found.share else number_table(found, found.number)


def share_table(found: Outcome) -> Table:
    """Return what each strategy needs for the share."""
    share, score = 100 * found.share, found.suite.score
    rows = [
        (
            _marked(found, f.strategy),
            "never" if f.needed is None else f"{'≤ ' if f.fewest else ''}{f.needed:.1f}",
            difference_text(f.ratio, 2, signed=False),
            f"{100 * f.reached:.0f} %",
        )
        for f in found.findings
    ]
    title = f"Photographs until {share:g} % of the targets have an F-score of {score:g} %, and their ratio to {found.reference}"
    return Table.of(title, ("strategy", "photographs", "ratio", "largest share"), rows)


def number_table(found: Outcome, *numbers: int) -> Table:
    """Return each strategy at these mean numbers of photographs."""
    rows: list[Row] = []
    for number in numbers:
        rows.append(Row(f"{number} photographs"))
        for s in (s for s in found.standings if s.photographs == number):
            texts = (
                difference_text(s.f_score, 2, signed=False),
                MISSING if s.strategy == found.reference else difference_text(s.gain, 2),
                f"{100 * s.share:.0f} %",
                str(s.score_0),
            )
            rows.append(Row(_marked(found, s.strategy), tuple(map(Cell, texts))))
    share = f"share at {found.suite.score:g} %"
    head = ("strategy", "F-score, %", f"minus {found.reference}", share, "score 0")
    return Table("Mean F-score at equal number of photographs", head, rows)


def _ground_truth(found: Outcome) -> list[str]:
    return [one.name for one in found.series if one.sees_ground_truth]


def _marked(found: Outcome, name: str) -> str:
    return f"{name} †" if name in _ground_truth(found) else name


# -- files ---------------------------------------------------------------------------------------------------


def _write_csv(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([f"{c:.4f}" if isinstance(c, float) else c for c in row] for row in rows)
    write_atomic(path, text.getvalue())


def _figure(found: Outcome, panels: Mapping[str, Sequence[Curve]]) -> Figure:
    titles = {"share": f"share of targets at {found.suite.score:g} %", "": "F-score, all targets"}
    dashed, columns = _ground_truth(found), min(4, len(panels))
    rows = -(-len(panels) // columns)
    with style.look():
        figure = style.new_figure(3.1 * columns, 2.6 * rows + 0.6)
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis, (name, curves) in zip(axes, panels.items()):
            _panel(axis, curves, dashed)
            axis.set_title(titles.get(name, f"F-score, {name}"), fontsize=9)
        for axis in axes[len(panels) :]:
            axis.set_visible(False)
        for axis in axes[max(0, len(panels) - columns) : len(panels)]:
            axis.set_xlabel("photographs (mean)")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _panel(axis: Axes, curves: Sequence[Curve], dashed: Sequence[str]) -> None:
    for index, curve in enumerate(curves):
        x, colour, line = curve.photographs, f"C{index}", "--" if curve.name in dashed else "-"
        axis.plot(x, [i.mean for i in curve.means], line, color=colour, label=curve.name, lw=1.4)
        if curve.means[0].low is not None:
            low, high = ([getattr(i, bound) for i in curve.means] for bound in ("low", "high"))
            axis.fill_between(x, low, high, color=colour, alpha=0.12, lw=0)
    lowest = min(i.mean for curve in curves for i in curve.means[len(curve.means) // 4 :])
    axis.set_ylim(max(0.0, lowest - 1.0), 100.0)
