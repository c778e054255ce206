"""A campaign as an Optuna study that optuna-dashboard shows well: comparable values, constraints, artefacts."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
from optuna.artifacts import FileSystemArtifactStore, upload_artifact
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState
from PIL import Image

from nbv.errors import UserError
from nbv.mission.result import json_ready
from tuner.campaign.campaign import Campaign
from tuner.campaign.ledger import TrialRecord
from tuner.report.campaign.facts import CampaignFacts
from tuner.samplers.distributions import distributions

_STATES = {"running": TrialState.RUNNING, "complete": TrialState.COMPLETE, "failed": TrialState.FAIL}
_FILES = ("cleaned.ply", "view.html", "config.yaml", "mission.json")
_TILE_PX = 240
_COLUMNS = 8


@dataclass(frozen=True)
class Dashboard:
    """What `write_dashboard` wrote."""

    journal: Path
    artefacts: Path

    @property
    def command(self) -> str:
        """What shows it."""
        return f"optuna-dashboard {self.journal} --artifact-dir {self.artefacts}"


def write_dashboard(campaign: Campaign, directory: Path) -> Dashboard:
    """Write a study beside the ledger, which stays as it is; an older one in ``directory`` is replaced.

    The objective is the campaign's metric with the rocks' (and conditions') differences taken out, as the surrogate sees
    it, in the metric's unit: values of different rocks compare, and importances are those of the parameters; what the
    configuration decides stays as it is, beside the quality. Failed
    missions are trials that failed, with constraint 1 where measured ones have 0. What a mission kept (photographs in
    one sheet, cloud, page, configuration) are its artefacts.

    Raises
    ------
    UserError
        No mission has succeeded yet, or the directory cannot be written.
    """
    facts = CampaignFacts(campaign)
    if facts.recommendation is None:
        raise UserError(
            f"{campaign.directory} has no successful mission yet; run or resume the campaign first"
        )
    files = Dashboard(directory / "study.journal", directory / "artifacts")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        files.journal.unlink(missing_ok=True)
        shutil.rmtree(files.artefacts, ignore_errors=True)
        files.artefacts.mkdir()
        storage = JournalStorage(JournalFileBackend(str(files.journal)))
        s = campaign.settings
        study = optuna.create_study(
            study_name=s.name,
            storage=storage,
            direction="maximize" if s.objective.direction == "maximise" else "minimize",
        )
        store = FileSystemArtifactStore(files.artefacts)
        for trial in facts.trials:
            study.add_trial(_trial(facts, trial, store, campaign.directory / trial.directory))
    except OSError as error:
        raise UserError(f"cannot write {directory}: {error.strerror}; choose another --out") from error
    return files


def _trial(
    facts: CampaignFacts, trial: TrialRecord, store: FileSystemArtifactStore, run: Path
) -> FrozenTrial:
    # Artefacts belong to a trial that is open: a scratch one, whose notes the finished one takes over.
    study = optuna.create_study(storage=optuna.storages.InMemoryStorage())
    scratch = study.ask()
    with tempfile.TemporaryDirectory() as folder:
        for file in _artefacts(run, Path(folder)):
            upload_artifact(artifact_store=store, file_path=str(file), study_or_trial=scratch)
    notes = {} if trial.state == "running" else {"constraints": [float(trial.state == "failed")]}
    return FrozenTrial(
        number=trial.number,
        trial_id=trial.number,
        state=_STATES[trial.state],
        value=_adjusted(facts, trial),
        datetime_start=trial.started,
        datetime_complete=trial.finished,
        params=trial.values,
        distributions=distributions(facts.settings.space),
        user_attrs=_attributes(facts, trial),
        system_attrs={**study.trials[0].system_attrs, **notes},
        intermediate_values={},
    )


def _adjusted(facts: CampaignFacts, trial: TrialRecord) -> float | None:
    """The metric as if flown in the mean of the worlds; as it is where the configuration decides it."""
    if trial.raw is None or facts.model is None or facts.modelled != facts.settings.objective:
        return trial.raw
    standard = facts.model.standardiser
    offset, factor = standard.mean_over(facts.model.worlds)
    (z,) = standard.standardise([trial.world], [facts.sign * trial.raw])
    return float(facts.sign * (offset + factor * z))


def _attributes(facts: CampaignFacts, trial: TrialRecord) -> dict[str, Any]:
    best, quality = facts.recommendation, facts.modelled
    attributes = {
        "recommended": True if best is not None and trial.values == best.values else None,
        quality.metric: None if quality == facts.settings.objective else facts.outcome(trial),
        "rock": trial.rock,
        "condition": trial.condition,
        "replicate": trial.replicate,
        "as measured": trial.raw,
        "status": trial.status,
        "reason": trial.reason,
        "phase": trial.why.get("phase", ""),
        "mission": trial.directory,
        **{f"cost {name}": value for name, value in trial.costs.items()},
    }
    return {key: value for key, value in json_ready(attributes).items() if value not in (None, "")}


def _artefacts(run: Path, folder: Path) -> list[Path]:
    sheet = _contact_sheet(sorted((run / "images").glob("*.png")), folder / "photographs.jpg")
    return [*([sheet] if sheet else []), *(run / name for name in _FILES if (run / name).is_file())]


def _contact_sheet(photographs: list[Path], path: Path) -> Path | None:
    """All photographs of a mission, seeds last."""
    if not photographs:
        return None
    with Image.open(photographs[0]) as first:
        height_px = round(_TILE_PX * first.height / first.width)
    rows = -(-len(photographs) // _COLUMNS)
    sheet = Image.new("RGB", (_TILE_PX * _COLUMNS, height_px * rows))
    for i, photograph in enumerate(photographs):
        with Image.open(photograph) as image:
            tile = image.convert("RGB").resize((_TILE_PX, height_px))
        sheet.paste(tile, (_TILE_PX * (i % _COLUMNS), height_px * (i // _COLUMNS)))
    sheet.save(path, "JPEG", quality=80)
    return path
