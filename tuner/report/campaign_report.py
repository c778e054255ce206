"""``report.html`` of a campaign: one self-contained page for the person who has to believe it."""

from __future__ import annotations

import collections
import json
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from nbv.errors import UserError
from nbv.provenance import git_revision, versions
from tuner.campaign import Campaign
from tuner.campaign_settings import SETTINGS_FILE
from tuner.missions import DEFAULT_RUNNER, RESULT_FILE
from tuner.recommendation import Recommendation
from tuner.report.campaign_facts import CampaignFacts, verdict
from tuner.report.campaign_figures import (
    calibration_figure,
    history_figure,
    map_figure,
    relevance_figure,
    running_recommendation_figure,
    slices_figure,
    time_figure,
)
from tuner.report.front import front_context
from tuner.report.labels import decimals_for, format_number, parameter_label, parameter_value, with_unit
from tuner.report.pages import duration, write_page
from tuner.report.style import Illustration, embed
from tuner.search_space import Parameter
from tuner.studies.fidelity import GEOMETRIC_NOTE

if TYPE_CHECKING:
    from tuner.evaluation import EvaluationRun

REPORT_FILE = "report.html"
FIGURES_DIRECTORY = "figures"
# Coverage of 95 % intervals below which the page says that they are too narrow.
POOR_COVERAGE = 0.85
MIN_MISSIONS_FOR_COVERAGE = 12
EDGE = 0.005  # of the searched range: nearer to a bound counts as at it


def write_campaign_report(campaign: Campaign, evaluation: EvaluationRun | None = None) -> Path:
    """Write ``report.html`` and ``figures/*.png`` into the campaign's run directory.

    Parameters
    ----------
    campaign
        Finished, interrupted or still running; nothing but the report is written.
    evaluation
        The tuned configuration against the baselines on held-out rocks, where there is one.

    Returns
    -------
    Path of the page.

    Raises
    ------
    UserError
        The campaign has no finished mission, or the directory cannot be written.
    """
    facts = CampaignFacts(campaign)
    if facts.status.finished == 0:
        raise UserError(f"{campaign.directory} has no finished mission; run or resume the campaign first")
    figures = campaign.directory / FIGURES_DIRECTORY
    comparison: dict[str, Any] | None = None
    if evaluation is not None:
        from tuner.report.comparison_report import comparison_context

        comparison = comparison_context(evaluation, figures, metric=facts.settings.objective.metric)
    try:
        context = _context(facts, figures)
    except OSError as error:
        raise UserError(f"cannot write {figures}: {error.strerror}; choose another directory") from error
    return write_page(campaign.directory / REPORT_FILE, "campaign.html.j2", comparison=comparison, **context)


def campaign_headline(recommendation: Recommendation, metric: str, difference_unit: str) -> str:
    """One honest sentence: better, worse, or no difference detected, with the 95 % interval."""
    low, high = recommendation.improvement_interval_95
    digits = decimals_for(recommendation.improvement_sd)
    how = (
        f"improvement {with_unit(recommendation.improvement, difference_unit, digits, signed=True)} "
        f"(95 % interval {format_number(low, digits, signed=True)} to {format_number(high, digits, signed=True)})"
    )
    if recommendation.values == recommendation.default_values:
        return (
            "The paper’s default is itself the recommendation: nothing flown so far is believed to be better."
        )
    kind = verdict(recommendation.improvement_interval_95)
    if kind == "better":
        return f"The recommended configuration is better than the paper’s default in {metric}: {how}."
    if kind == "worse":
        return f"The recommended configuration is worse than the paper’s default in {metric}: {how}."
    return f"No difference detected between the recommended configuration and the paper’s default in {metric}: {how}."


def recommended_yaml(recommendation: Recommendation) -> str:
    """The recommended values as parameter paths, seven significant digits."""
    values = {k: float(f"{v:.7g}") if isinstance(v, float) else v for k, v in recommendation.values.items()}
    return yaml.safe_dump(values, sort_keys=False)


# -- what the template needs ---------------------------------------------------------------------------------


def _context(facts: CampaignFacts, figures: Path) -> dict[str, Any]:
    s, label = facts.settings, facts.label
    best = facts.recommendation
    rocks = ", ".join(facts.rock_names.values())
    provenance, revision = _provenance(facts)
    context: dict[str, Any] = {
        "title": f"{s.name} · gatetune campaign",
        "name": f"Campaign {s.name}",
        "subtitle": f"{s.space.dimension} parameters of the search space “{s.space.name}” tuned for "
                    f"{label.full} ({s.objective.direction}d) on {len(s.rocks)} "
                    f"{'rock' if len(s.rocks) == 1 else 'rocks'}: {rocks}",
        "headline": _headline(facts),
        "warnings": _warnings(facts),
        "kpis": _kpis(facts),
        "recommended": best is not None,
        "parameters": [_parameter_row(facts, p) for p in s.space.parameters],
        "metric_name": label.name,
        "metric_full": label.full,
        "unit": label.unit,
        "difference_unit": label.difference_unit,
        "stop_reason": facts.stop_reason,
        "costs": _costs(facts),
        "failures": _failures(facts),
        "trials": [_trial_row(facts, t) for t in facts.trials],
        "command": reproduce_command(facts.campaign),
        "command_note": _command_note(facts.campaign),
        "provenance": provenance,
        "settings_file": SETTINGS_FILE,
        "settings_yaml": yaml.safe_dump(s.to_dict(), sort_keys=False, allow_unicode=True),
        "version": versions().get("gatetune", ""),
        "revision": revision,
        "yaml": "", "mission_command": "", "per_rock": [], "top": [], "model_text": "",
        "front": front_context(facts, figures),
        "mission_figures": [_history(facts, figures)],
        "model_figures": [], "rock_checks": [],
        "cost_figures": [],
    }  # fmt: skip
    spent = time_figure(facts)
    if spent is not None:
        context["cost_figures"].append(
            embed(
                spent,
                "compute_time",
                "Bar chart of compute time by stage of a mission.",
                "Wall-clock time of all missions by stage, as each mission measured it.",
                figures,
                title="Compute time",
            )  # fmt: skip
        )
    if best is not None:
        context |= _recommended_context(facts, best, figures)
        context["mission_figures"].append(_running(facts, figures))
    return context


def _trend_text(facts: CampaignFacts) -> str:
    return ", beside a linear trend" if facts.model is not None and facts.model.settings.trend else ""


def _earlier_text(facts: CampaignFacts) -> str:
    campaign = facts.campaign
    earlier = campaign.earlier
    if earlier is None or facts.model is None:
        return ""
    what = (
        f"missions of the low fidelity ({facts.settings.low_fidelity})"
        if campaign.screening is not None
        else f"missions of earlier campaigns ({', '.join(facts.settings.learn_from)}; on {', '.join(Path(r).stem for r in earlier.rocks)})"
    )
    share = (
        "What they say of a configuration is part of the model, as far as the missions here bear it out."
        if facts.model.uses_earlier
        else "The missions here do not bear out what they say of a configuration, so it is no part of the model."
    )
    return f" Before it {len(earlier.observations)} {what} were flown; the best of them lead the initial design. {share}"


def _verification_text(facts: CampaignFacts, best: Recommendation) -> str:
    flown = sum(t.why.get("phase") == "verification" for t in facts.trials)
    if best.expected_shortfall is None or not flown:
        return ""
    shortfall = with_unit(best.expected_shortfall, facts.label.difference_unit, facts.digits)
    missions = "One mission" if flown == 1 else f"{flown} missions"
    return (
        f" {missions} near the end of the search flew its favourite on a rock, or with a replicate, it had not seen. By "
        f"what the first of a favourite stayed behind its prediction, {shortfall} on average (the noise counted as one "
        "more), configurations are marked down before one is recommended, each for its share of the rocks and replicates "
        "it has not flown."
    )


def _recommended_context(facts: CampaignFacts, best: Recommendation, figures: Path) -> dict[str, Any]:
    label, s = facts.label, facts.settings
    assert facts.model is not None
    sets = " ".join(
        f"--set {shlex.quote(f'{k}={v}')}" for k, v in yaml.safe_load(recommended_yaml(best)).items()
    )
    base = " ".join(f"--set {shlex.quote(f'{k}={v}')}" for k, v in {**s.overrides, **s.space.base}.items())
    return {
        "yaml": recommended_yaml(best),
        "mission_command": " ".join(
            f"gatetune mission run --rock {shlex.quote(s.rocks[0])} --preset {s.preset} {base} {sets}".split()
        ),
        "per_rock": _per_rock(facts, best),
        "finalists": _finalists(facts, best),
        "gain_unit": label.difference_unit,
        "interval_covers_zero": any(
            g.gain_interval_95 is not None and g.gain_interval_95[0] <= 0 <= g.gain_interval_95[1]
            for g in best.confirmation
            if g.values == best.values
        ),
        "top": [
            {
                "mean": f"{format_number(c.mean, facts.digits)} ± {format_number(c.sd, facts.digits)}",
                "share": f"{100 * c.probability_best:.0f} %",
                "missions": f"{c.missions} ({c.failed})" if c.failed else str(c.missions),
                "parameters": {path: parameter_value(c.values[path]) for path in s.space.paths},
            }
            for c in best.top
        ],
        "model_text": (
            f"A Gaussian process (Matérn 5/2, one length scale per parameter{_trend_text(facts)}) on "
            f"{best.observations} missions, outcomes "
            "standardised per rock. One mission scatters about its configuration’s mean over rocks with a standard "
            f"deviation of {with_unit(best.noise_sd, label.difference_unit, facts.digits)}: that is the noise against which "
            "differences have to be seen."
            + (
                " What all missions on one rock and replicate share is modelled apart and cancels between "
                f"configurations; its standard deviation is {with_unit(best.slot_sd, label.difference_unit, facts.digits)}."
                if best.slot_sd is not None
                else ""
            )
            + _earlier_text(facts)
            + _verification_text(facts, best)
        ),
        "model_figures": _model_figures(facts, best, figures),
        "rock_checks": [
            [
                facts.rock_names[c.rock], str(c.missions), f"{100 * c.inside_95:.0f} %", format_number(c.z_sd, 2),
                format_number(c.spearman, 2, signed=True),
            ]
            for c in facts.leave_one_rock_out
        ],
    }  # fmt: skip


def _headline(facts: CampaignFacts) -> dict[str, Any]:
    best, label, s = facts.recommendation, facts.label, facts.settings
    rocks = ", ".join(facts.rock_names.values())
    if best is None:
        return {
            "kind": "worse",
            "verdict": f"No recommendation: none of the {facts.status.finished} finished missions succeeded.",
            "sentences": [facts.stop_reason, "The reasons are listed under Costs."],
        }
    kind = verdict(best.improvement_interval_95) if best.values != best.default_values else ""
    low, high = best.interval_95
    sentences = [
        f"Tuned: {s.space.dimension} parameters ({s.space.description.rstrip('.') or s.space.name}), for {label.full}, "
        f"on {rocks}." + (f" Recommended: {_inline_values(best.values)}." if s.space.dimension <= 3 else ""),
        f"Posterior mean over the training rocks {with_unit(best.mean, label.unit, facts.digits)} "
        f"(95 % interval {format_number(low, facts.digits)} to {format_number(high, facts.digits)}), the paper’s default "
        f"{with_unit(best.default_mean, label.unit, facts.digits)}. Probability that the recommendation beats the default: "
        f"{_percent(best.probability_better_than_default)}.",
        "These figures are the surrogate’s, on the rocks that were tuned on, for the configuration picked as the best "
        "of those flown; they lean towards optimism. `gatetune evaluate` measures the recommendation on held-out rocks.",
    ]  # fmt: skip
    if s.fidelity == "geometric":
        sentences.append(
            f"{GEOMETRIC_NOTE} They rank configurations and do not measure them: `gatetune evaluate` flies the "
            "recommendation with photographs."
        )
    return {
        "kind": kind.split()[0] if kind else "",
        "verdict": campaign_headline(best, label.full, label.difference_unit),
        "sentences": sentences,
    }


def _inline_values(values: dict[str, Any]) -> str:
    labels = {path: parameter_label(path) for path in values}
    return ", ".join(
        f"{labels[path].name} = {f'{parameter_value(value)} {labels[path].unit}'.strip()}"
        for path, value in values.items()
    )


def _warnings(facts: CampaignFacts) -> list[str]:
    best = facts.recommendation
    out = []
    if facts.status.remaining and best is not None:
        out.append(f"The campaign is not finished. {facts.stop_reason}")
    if best is None:
        return out
    coverage = best.leave_one_out["coverage_95"]
    if best.observations < MIN_MISSIONS_FOR_COVERAGE:
        out.append(
            f"Only {best.observations} successful missions: the model rests mostly on its priors, and its intervals "
            "cannot be checked yet."
        )
    elif coverage < POOR_COVERAGE:
        out.append(
            f"The model’s 95 % intervals held only {100 * coverage:.0f} % of the left-out missions: read all "
            "intervals on this page as too narrow."
        )
    edges = [
        parameter_label(p.path).name
        for p in facts.settings.space.parameters
        if p.kind != "categorical" and not EDGE < p.to_unit(best.values[p.path]) < 1 - EDGE
    ]
    if edges:
        out.append(
            f"Recommended at the edge of the searched range: {', '.join(edges)}. Where such a parameter matters (see "
            "below), a wider range may hold something better."
        )
    if facts.status.failed > 0.2 * facts.status.finished:
        out.append(f"{facts.status.failed} of {facts.status.finished} finished missions failed; see Costs.")
    return out


def _kpis(facts: CampaignFacts) -> list[tuple[str, str]]:
    st = facts.status
    return [
        (f"{st.finished} of {st.budget}", "missions finished"),
        (str(st.failed), "of them failed"),
        (duration(st.mission_wall_s), "computing, summed over missions"),
        (duration(st.flight_time_s), "simulated flight"),
        (_distance(st.path_length_m), "flown"),
        (f"{st.images:.0f}", _photographs(facts)),
    ]


def _parameter_row(facts: CampaignFacts, p: Parameter) -> dict[str, str]:
    label = parameter_label(p.path)
    unit = f" {label.unit}" if label.unit else ""
    best = facts.recommendation
    span = (
        ", ".join(map(str, p.choices))
        if p.kind == "categorical"
        else f"{p.low:g} to {p.high:g}{unit}{', log' if p.scale == 'log' else ''}"
    )
    return {
        "path": p.path,
        "label": label.name,
        "short": label.short,
        "default": parameter_value(facts.default[p.path]) + unit,
        "recommended": parameter_value(best.values[p.path]) + unit if best else "–",
        "range": span,
    }


def _per_rock(facts: CampaignFacts, best: Recommendation) -> list[list[str]]:
    rows = []
    done = [t for t in facts.trials if t.state != "running"]
    for row in best.per_rock:
        own = [t for t in done if t.rock == row.rock]
        default = [t.raw for t in own if t.values == best.default_values and t.raw is not None]
        rows.append(
            [
                facts.rock_names[row.rock], str(len(own)), str(sum(t.raw is None for t in own)), str(row.missions),
                format_number(row.predicted, facts.digits), format_number(row.observed, facts.digits), str(len(default)),
                format_number(sum(default) / len(default) if default else None, facts.digits),
            ]
        )  # fmt: skip
    return rows


def _finalists(facts: CampaignFacts, best: Recommendation) -> list[dict[str, Any]]:
    """The confirmation stage's paired gains over the default, recommended first, then by gain."""
    gains = sorted(
        best.confirmation,
        key=lambda g: (g.values != best.values, -math.inf if g.gain is None else -g.gain),
    )
    rows = []
    for g in gains:
        low, high = g.gain_interval_95 or (None, None)
        rows.append(
            {
                "recommended": g.values == best.values,
                "values": _inline_values(g.values),
                "missions": str(g.missions),
                "pairs": str(g.pairs),
                "gain": format_number(g.gain, facts.digits, signed=True),
                "interval": "–"
                if low is None or high is None
                else f"{format_number(low, facts.digits, signed=True)} to {format_number(high, facts.digits, signed=True)}",
            }
        )
    return rows


def _costs(facts: CampaignFacts) -> list[list[str]]:
    st = facts.status
    done = max(1, st.finished)
    return [
        ["missions", f"{st.finished} ({st.complete} successful, {st.failed} failed)", ""],
        ["compute time", duration(st.mission_wall_s), duration(st.mission_wall_s / done)],
        ["simulated flight time", duration(st.flight_time_s), duration(st.flight_time_s / done)],
        ["distance flown", _distance(st.path_length_m), _distance(st.path_length_m / done)],
        [_photographs(facts), f"{st.images:.0f}", f"{st.images / done:.1f}"],
    ]


def _failures(facts: CampaignFacts) -> list[list[str]]:
    groups: dict[str, list[Any]] = collections.defaultdict(list)
    for t in facts.trials:
        if t.state == "failed":
            groups[t.reason or "unknown"].append(t)
    return [
        [reason, str(len(group)), ", ".join(sorted({facts.rock_names.get(t.rock, t.rock) for t in group})), group[-1].message]
        for reason, group in sorted(groups.items(), key=lambda item: -len(item[1]))
    ]  # fmt: skip


def _trial_row(facts: CampaignFacts, t: Any) -> list[str]:
    outcome = {"running": "in flight", "complete": t.status or "ok", "failed": f"failed: {t.reason}"}[t.state]
    return [
        str(t.number + 1), str(t.why.get("phase", "")), facts.rock_names.get(t.rock, t.rock), str(t.replicate),
        format_number(t.raw, facts.digits), outcome,
        *(parameter_value(t.values[path]) for path in facts.settings.space.paths),
    ]  # fmt: skip


# -- figures -------------------------------------------------------------------------------------------------


def _history(facts: CampaignFacts, figures: Path) -> Illustration:
    st = facts.status
    return embed(
        history_figure(facts), "missions",
        f"Scatter plot of {facts.label.name} over {st.finished} missions, one colour and marker per rock; "
        f"{st.failed} failed missions are crosses at the bottom.",
        f"{facts.label.full} of every mission by rock. The shaded missions are the initial design (the paper’s default "
        "first); after it the sampler proposes. Rocks differ in difficulty, so heights compare within a rock only. "
        "Circled: missions of the recommended configuration. Crosses at the bottom: failed missions, which have no value.",
        figures, title="Outcome of every mission",
    )  # fmt: skip


def _running(facts: CampaignFacts, figures: Path) -> Illustration:
    return embed(
        running_recommendation_figure(facts), "running_recommendation",
        "Line plot of the recommended configuration's posterior mean at several moments of the campaign, with 95 % bars.",
        "Quality of the recommendation as missions came in: the recommendation was recomputed from the first n missions "
        "alone. Circles: what the model believed then; squares: what the model of all missions says about the same "
        "configuration. Dashed: the paper’s default under the model of all missions.",
        figures, title="Running recommendation",
    )  # fmt: skip


def _model_figures(facts: CampaignFacts, best: Recommendation, figures: Path) -> list[Illustration]:
    label = facts.label
    out = [
        embed(
            slices_figure(facts), "slices",
            f"One panel per parameter: posterior mean of {label.name} with its 95 % band along the parameter.",
            f"Posterior of {label.full}, mean over the training rocks, along one parameter at a time, the others as "
            "recommended. Dots are missions with their rock’s difference taken out; the fainter, the farther the mission "
            "lies from the slice in the other parameters. A flat line within its band: no influence detected.",
            figures, title="Slices through the recommendation",
        )
    ]  # fmt: skip
    surface = map_figure(facts)
    if surface is not None:
        found = facts.surface()
        assert found is not None
        names = f"{parameter_label(found.x.path).name} and {parameter_label(found.y.path).name}"
        others = facts.settings.space.dimension > 2
        out.append(
            embed(
                surface, "map",
                f"Two maps over {names}: posterior mean and posterior standard deviation, with missions, default and recommendation.",
                f"Posterior mean (left) and its standard deviation (right) over {names}"
                + (", the other parameters as recommended; missions are projected onto the plane." if others else "."),
                figures, title="Map of two parameters",
            )
        )  # fmt: skip
    out.append(
        embed(
            relevance_figure(facts), "relevance",
            "Bar chart of each parameter's influence on the posterior mean with its length scale.",
            "How far the posterior mean moves along each slice above, and the length scale ℓ in units of the searched "
            f"range: long means {'no more than the linear trend' if _trend_text(facts) else 'unimportant'}.",
            figures, title="Which parameters matter",
        )
    )  # fmt: skip
    if best.observations >= 2:
        check = best.leave_one_out
        out.append(
            embed(
                calibration_figure(facts), "calibration",
                "Scatter plot of leave-one-out predictions against measured outcomes with 95 % bars and the diagonal.",
                f"Every successful mission predicted from all the others, hyperparameters kept. "
                f"{100 * check['coverage_95']:.0f} % of {best.observations:.0f} missions lie inside their 95 % interval "
                f"(nominal: 95 %); the residuals’ standard deviation is {check['z_sd']:.2f} predicted ones (ideal: 1).",
                figures, title="Calibration",
            )
        )  # fmt: skip
    return out


# -- provenance ----------------------------------------------------------------------------------------------


def _provenance(facts: CampaignFacts) -> tuple[list[tuple[str, str]], str]:
    """Rows for the page, and the revision that flew the missions (several are all listed)."""
    trees = []
    for t in facts.trials:
        path = facts.campaign.directory / t.directory / RESULT_FILE
        try:
            tree = json.loads(path.read_text()).get("provenance") or {}
        except (OSError, ValueError, AttributeError):
            continue
        if tree:
            trees.append(tree)
    revisions = sorted({str(tree.get("revision", "unknown")) for tree in trees})
    software = trees[-1].get("versions", {}) if trees else versions()
    machines = sorted({str(tree["machine"]) for tree in trees if "machine" in tree})
    backends = sorted({str(tree["backend"]) for tree in trees if "backend" in tree})
    hashes = {
        facts.rock_names.get(t.rock, t.rock): str(tree["rock_sha256"])[:12]
        for t, tree in zip([t for t in facts.trials if t.state != "running"], trees)
        if "rock_sha256" in tree
    } if len(trees) == facts.status.finished else {}  # fmt: skip
    times = [t.started for t in facts.trials if t.started], [t.finished for t in facts.trials if t.finished]
    rows = [
        ("flown between", f"{min(times[0]):%Y-%m-%d %H:%M} and {max(times[1]):%Y-%m-%d %H:%M}" if all(times) else "–"),
        ("revision of the missions", ", ".join(revisions) or "not recorded"),
        ("revision of this page", git_revision()),
        ("versions", ", ".join(f"{name} {number}" for name, number in software.items())),
        ("machine", ", ".join(machines) or "not recorded"),
        ("renderer", ", ".join(backends) or "not recorded"),
        ("mission preset", facts.settings.preset),
        ("base configuration", facts.settings.base_config().digest()),
        ("sampler and seed", f"{facts.settings.sampler}, {facts.settings.seed}"),
    ]  # fmt: skip
    if hashes:
        rows.append(
            ("rocks (SHA-256)", ", ".join(f"{name} {digest}…" for name, digest in sorted(hashes.items())))
        )
    return rows, ", ".join(revisions) or git_revision()


def reproduce_command(campaign: Campaign) -> str:
    """The command line that runs the same campaign again."""
    s = campaign.settings
    words = ["gatetune", "campaign", "run", "--name", s.name, "--space", _space_argument(campaign)]
    for rock in s.rocks:
        words += ["--rock", rock]
    words += ["--replicates", str(s.replicates), "--budget", str(s.budget), "--seed", str(s.seed)]
    words += ["--preset", s.preset, "--metric", s.objective.metric, "--sampler", s.sampler]
    if s.objective.direction == "minimise":
        words.append("--minimise")
    for path, value in s.overrides.items():
        words += ["--set", f"{path}={json.dumps(value)}"]
    for directory in s.learn_from:
        words += ["--learn-from", directory]
    return " ".join(shlex.quote(word) for word in [*words, *_optional_words(campaign)])


def _optional_words(campaign: Campaign) -> list[str]:
    """What of the settings is not a campaign's default."""
    s, gp, words = campaign.settings, campaign.settings.gp, []
    with_values = {
        "--keep": s.keep if s.keep != "summary" else None, "--in-step": s.in_step,
        "--confirm": s.confirmation or None, "--low-fidelity": s.low_fidelity,
        "--fidelity": s.fidelity if s.runner != DEFAULT_RUNNER else None,
        "--risk": gp.risk if gp.risk != "mean" else None, "--prior": gp.prior_strength or None,
        "--second-metric": s.second.metric if s.second is not None else None,
    }  # fmt: skip
    for option, value in with_values.items():
        if value is not None:
            words += [option, str(value)]
    flags = {
        "--sparse": gp.sparse is True, "--no-sparse": gp.sparse is False, "--fully-bayesian": gp.fully_bayesian,
        "--stop-when-settled": s.stop_when_settled,
        "--second-minimise": s.second is not None and s.second.direction == "minimise",
    }  # fmt: skip
    return [*words, *(option for option, wanted in flags.items() if wanted)]


def _space_argument(campaign: Campaign) -> str:
    from tuner.search_space import load_search_space

    space = campaign.settings.space
    try:
        if load_search_space(space.name).to_dict() == space.to_dict():
            return space.name
    except UserError:
        pass
    return f"{space.name}.yaml"


def _command_note(campaign: Campaign) -> str:
    s, notes = campaign.settings, []
    if _space_argument(campaign).endswith(".yaml"):
        notes.append(
            f"Save the section “search_space” of the settings below as {_space_argument(campaign)} first."
        )
    if s.fidelity is None:
        notes.append(f"Missions were flown by {s.runner}, which the command line cannot name.")
    if s.in_step is None:
        notes.append(
            "With one worker the sequence of proposals repeats exactly; with more it depends on which mission ends "
            "first, unless the campaign is run --in-step."
        )
    return " ".join(notes)


# -- small things --------------------------------------------------------------------------------------------


def _photographs(facts: CampaignFacts) -> str:
    return "captures, no photographs" if facts.settings.fidelity == "geometric" else "photographs"


def _distance(metres: float) -> str:
    return f"{metres:.0f} m" if metres < 2000 else f"{metres / 1000:.1f} km"


def _percent(share: float) -> str:
    if share > 0.999:
        return "above 99.9 %"
    return "below 0.1 %" if share < 0.001 else f"{100 * share:.1f} %"


__all__ = ["campaign_headline", "recommended_yaml", "reproduce_command", "write_campaign_report"]
