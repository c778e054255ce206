"""The answer in sentences and tables: the same on terminal, page and in exported files."""

from __future__ import annotations

import collections
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from nbv.config import MissionConfig
from tuner.answer.answer import Advice, Answer, AnswerTable
from tuner.problem.baselines import in_table_order, is_ablation, is_orbit, label
from tuner.problem.intervals import Interval
from tuner.problem.observations import short
from tuner.problem.search_space import TUNED, TUNED_GATE
from tuner.report.labels import (
    Cell,
    Label,
    Row,
    Table,
    bracketed,
    counted,
    difference_text,
    format_number,
    metric_label,
    parameter_label,
    short_names,
)

if TYPE_CHECKING:
    from tuner.answer.effects import Effect, ParameterRow
    from tuner.answer.evidence import Evidence, GateFacts

T = TypeVar("T")
REFERENCE = "hyb-h"
FLY_MARK = "→"
LEGEND = (
    "F: F-score (%) on the surface that cameras can see. Brackets: 95 % intervals of paired differences, {method}. "
    f"A failed mission counts as 0. {FLY_MARK} is what to fly."
)
METHODS = {
    "rocks": "by Student's t over targets",
    "replicates": "over replicates, valid on these targets alone",
    "none": "none here: too few missions",
}


# -- what to fly -----------------------------------------------------------------------------------------------


def sentences(answer: Answer) -> list[str]:
    """What to fly; what that is worth; what the tuned plans earn beside it."""
    left_out = [f"An evaluation is left out: {why}." for why in answer.left_out]
    if answer.fly is None:
        return [f"Nothing to fly yet: {answer.nothing_yet}.", *left_out]
    return [_what(answer, answer.fly), *_worth(answer, answer.fly), *_tuned(answer, answer.fly), *left_out]


def _what(answer: Answer, fly: Advice) -> str:
    limit = next(filter(None, (each.missed for each in answer.recommended.values())), None)
    if limit is not None:
        bound = limit_text(limit.metric, limit.direction, limit.limit)
        return f"No configuration that was run is likely to meet the constraint ({bound}); the nearest misses it by {limit.missed_by:.3g}."
    plan = plan_words(answer.configs[fly.strategy])
    return f"Fly {name_in_text(fly.strategy)}: {plan}."


def _worth(answer: Answer, fly: Advice) -> list[str]:
    """The flown plan against Hyb-H and, where it is tuned, against the best plain plan, on all targets."""
    gains = {name: gain for name, gain in fly.against.items() if gain is not None}
    chosen = next((table.best_plain for table in answer.tables), "") if fly.is_tuned else ""
    named = [name for name in (chosen, REFERENCE) if name in gains]
    if not named:
        return []
    unit = metric_label(answer.metric).difference_unit
    parts = [
        f"{difference_text(gains[name])} {unit} against {name_in_text(name)} on {counted(gains[name].rocks, 'target')}"
        for name in named
    ]
    return [f"It has {', '.join(parts)} ({interval_words([gains[name] for name in named])})."]


def _tuned(answer: Answer, fly: Advice) -> list[str]:
    """Tuned plans that lead without being shown to be better, and what the others earn."""
    unit, lines = metric_label(answer.metric).difference_unit, list[str]()
    told = [name for i, name in enumerate(fly.leads) if name in answer.recommended or not i]
    for names, lead in alike({name: fly.leads[name] for name in told}):
        lines.append(
            f"{_capital(names)} {'lead' if ' and ' in names else 'leads'} it by {difference_text(lead)} {unit} on "
            f"{counted(lead.rocks, 'target')}, which is not shown to be a difference."
        )
    table = answer.tables[0] if answer.tables else None  # the held-out one, where there is one
    rows = () if table is None else table.rows
    gate = next((row for row in rows if row.strategy == TUNED_GATE != fly.strategy), None)
    if table and gate and gate.from_reference is not None:
        where = counted(gate.from_reference.rocks, f"{'held-out' if table.held_out else 'training'} target")
        lines.append(
            f"The tuned gate, with the paper's seeds, has {difference_text(gate.from_reference)} {unit} against Hyb-H on {where}."
        )
    return lines[:2]


def name_in_text(strategy: str) -> str:
    """A strategy inside a sentence: ``the tuned planner``, ``Hyb-H``, ``the orbit at 15°``."""
    name = "Tuned configuration" if strategy == TUNED else label(strategy)
    if strategy.startswith("tuned") or is_orbit(strategy):
        return f"the {name[:1].lower()}{name[1:]}"
    return name[:1].lower() + name[1:] if name.startswith("Random") else name


def alike(facts: Mapping[str, T]) -> list[tuple[str, T]]:
    """Strategies inside a sentence, those with equal facts together: ``the tuned gate and the tuned planner``."""
    values = list(facts.values())
    distinct = [value for i, value in enumerate(values) if value not in values[:i]]
    return [
        (" and ".join(name_in_text(name) for name, other in facts.items() if other == value), value)
        for value in distinct
    ]


def plan_words(config: MissionConfig) -> str:
    """``16 photographs at 10°, then 4 by the gate of Covis and B-aware``."""
    if config.seed.layout == "turn":
        (lowest_deg, number), *upper = config.seed_rings
        rings = f"{number} photographs at {lowest_deg:.0f}°"
        rings += "".join(f" and {n} at {elevation_deg:.0f}°" for elevation_deg, n in upper)
    else:
        rings = f"{config.seeds} photographs on the paper's rings"
    if not config.planned_views:
        return rings
    by = {
        "random": "at random",
        "hyb-h": f"by the gate of Covis and {label(config.gate.geometry_scorer)}",
    }.get(config.gate.kind, f"by {label(config.gate.kind)}")
    if config.stop.may_end_early:
        return f"{rings}, then planned ones {by} until the stop criterion holds, at most {config.photographs} in all"
    return f"{rings}, then {config.planned_views} {by}"


# -- tables ------------------------------------------------------------------------------------------------------


def table_lines(table: AnswerTable, metric: str, fly: str = "", *, narrow: bool = False) -> Table:
    """The strategies, kind by kind, with the paired differences from the reference and from the best baseline.

    ``fly``: the strategy that is marked; ``narrow``: without costs.
    """
    several = len(table.kinds) > 1
    means = [*table.kinds, "all"] if several else ["all"]
    unit = metric_label(metric)
    short_metric = "F" if "f_score" in metric else unit.name
    columns = [
        "strategy",
        *([] if narrow else ["photos", "planned", "flight s"]),
        *(f"{short_metric} {m}" if several else short_metric for m in means),
    ]
    flown_reference = any(row.strategy == table.reference for row in table.rows)
    columns.append(f"from {label(table.reference) if flown_reference else 'default'}")
    against_plain = table.best_plain not in ("", table.reference)
    if against_plain:
        columns.append(f"from {label(table.best_plain)}")
    digits = 1 if unit.unit in ("%", "mm") else 3
    rows, kind = list[Row](), ""
    for row in table.rows:
        if row.kind != kind:
            kind = row.kind
            rows.append(Row(kind))
        texts = [
            *(() if narrow else [format_number(c, 0) for c in (row.photographs, row.planned, row.flight_s)]),
            *(format_number(row.means.get(m), digits) for m in means),
            difference_text(row.from_reference, digits),
        ]
        if against_plain:
            texts.append(difference_text(row.from_baseline, digits))
        flown = row.strategy == fly
        name = f"{FLY_MARK} {row.label}" if flown else f"  {row.label}"
        rows.append(Row(name, tuple(map(Cell, texts)), best=flown))
    least, most = table.replicates
    replicates = counted(most, "replicate") if least == most else f"{least} to {most} replicates"
    names = short_names(table.targets)
    shown = ", ".join(names) if len(names) <= 8 else f"{', '.join(names[:7])} and {len(names) - 7} more"
    title = f"{'Held-out' if table.held_out else 'Training'} targets: {shown} ({replicates})"
    return Table(title, tuple(columns), rows, " ".join(notes_of(table)))


def notes_of(table: AnswerTable) -> list[str]:
    """Failures, equal photographs, and who flew on fewer targets."""
    lines = [
        f"{row.label}: {counted(row.failures, 'failed mission')} of {row.missions}."
        for row in table.rows
        if row.failures
    ]
    same: dict[str, list[str]] = {}
    for row in table.rows:
        if row.same_as:
            same.setdefault(row.same_as, []).append(row.label)
    lines += [
        f"{' and '.join(names)} took the same photographs as {label(other)}." for other, names in same.items()
    ]
    fewer = [row.label for row in table.rows if row.targets < len(table.targets)]
    if fewer:
        lines.append(f"On fewer targets: {', '.join(fewer)}; compare differences, not means.")
    return lines


def by_target(evidence: Evidence, metric: str) -> Table:
    """The mean of every strategy on every target."""
    targets = [rock for held_out in (True, False) for rock in evidence.on(held_out=held_out).targets]
    rows = []
    for name in in_table_order(n for n in evidence.configs if not is_ablation(n)):
        scores: dict[str, list[float]] = collections.defaultdict(list)
        for (instance, _), score in evidence.scores(name).items():
            scores[instance.rock].append(score)
        if scores:
            means = (format_number(sum(v) / len(v) if (v := scores.get(t)) else None) for t in targets)
            rows.append([label(name), *means])
    caption = f"{metric_label(metric).full}, mean over replicates; held-out targets first."
    return Table.of("Target by target", ("strategy", *short_names(targets)), rows, caption)


def legend(tables: Iterable[AnswerTable]) -> str:
    """What the columns are, and how the intervals were made."""
    rows = [row for table in tables for row in table.rows]
    gains = [gain for row in rows for gain in (row.from_reference, row.from_baseline) if gain is not None]
    return LEGEND.format(method=interval_words(gains).removeprefix("95 % intervals "))


def interval_words(gains: Sequence[Interval]) -> str:
    methods = [METHODS[m] for m in ("rocks", "replicates", "none") if any(g.method == m for g in gains)]
    return f"95 % intervals {', '.join(methods or [METHODS['none']])}"


def parameters_table(name: str, rows: Sequence[ParameterRow], metric: Label) -> Table:
    """What was found: the paper's value, the tuned one, what is as good, and what the change earned, by the model."""
    lines = [
        [
            parameter_label(row.path).name,
            value_text(row.path, row.default),
            value_text(row.path, row.tuned),
            range_text(row.path, row.as_good),
            effect_text(row.earned),
            f"{row.importance:.2f}",
        ]
        for row in rows
    ]
    columns = (
        "parameter",
        "paper",
        "tuned",
        "as good (95 %)",
        f"earned, {metric.difference_unit or 'its unit'}",
        "importance",
    )
    return Table.of(label(name), columns, lines)


def values_table(answer: Answer) -> Table:
    """The tuned values beside the paper's, one column for each tuned configuration; what none of them changed is left out."""
    found = answer.recommended
    paths = [
        path
        for path in next(iter(found.values())).values
        if any(path in each.changed for each in found.values())
    ]
    lines = []
    for path in paths:
        default = next(iter(found.values())).default_values[path]
        texts = [
            value_text(path, each.values[path]) if path in each.changed else "=" for each in found.values()
        ]
        lines.append([path, value_text(path, default), *texts])
    if not lines:
        lines.append(["nothing", "", *("=" for _ in found)])
    return Table.of("", ("tuned", "paper", *map(label, found)), lines)


def effect_text(effect: Effect | None) -> str:
    return "–" if effect is None else bracketed(effect.mean, effect.low, effect.high, signed=True)


def value_text(path: str, value: Any) -> str:
    return f"{short(value)} {parameter_label(path).unit}".strip()


def range_text(path: str, good: Sequence[Any]) -> str:
    if good and isinstance(good[0], (int, float)) and not isinstance(good[0], bool) and len(good) == 2:
        low, high = good
        unit = parameter_label(path).unit
        return f"{short(low)} to {short(high)} {unit}".strip()
    return ", ".join(map(str, good))


def gate_sentence(names: str, gate: GateFacts) -> str:
    """What the gate of a tuned configuration did; ``names`` as inside a sentence."""
    who = _capital(names)
    views = sum(gate.views.values())
    if not views:
        return f"{who} has not planned a view in a mission that was kept."
    shares = ", ".join(f"{label(scorer)} {100 * count / views:.0f} %" for scorer, count in gate.views.items())
    d95 = (
        "" if gate.d95_m is None else f", while d95 lay between {gate.d95_m[0]:.2f} and {gate.d95_m[1]:.2f} m"
    )
    text = f"{who}: the gate switched in {gate.switched} of {counted(gate.missions, 'mission')} ({shares} of {views} views{d95})"
    if gate.alone:
        text += f"; the thresholds leave {label(gate.alone)} alone"
    return f"{text}. Of the campaign's {gate.all_missions} missions that planned views it switched in {gate.all_switched}."


def chosen_text(chosen_by: Mapping[str, int]) -> str:
    """``64 missions: 12 baselines, 12 design, 34 chosen by the model, 6 verification``."""
    words = {
        "baselines": "of baselines",
        "design": "of the initial design",
        "model": "chosen by the model",
        "verification": "to verify its favourites",
    }
    parts = [f"{count} {words[by]}" for by, count in chosen_by.items() if count]
    return f"{counted(sum(chosen_by.values()), 'mission')}: {', '.join(parts)}."


def limit_text(metric: str, direction: str, limit: float) -> str:
    """``F-score @ 48 mm at least 98 %``."""
    about = metric_label(metric)
    return (
        f"{about.name} {'at least' if direction == 'maximise' else 'at most'} {limit:g} {about.unit}".strip()
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
