"""Results as JSON, and run folders by which a run can be repeated."""

from __future__ import annotations

import gzip
import hashlib
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from testbed.applications.drives.identify_drives import DriveIdentification
from testbed.applications.validate import Validation
from testbed.bodies.consistency.consistent import Consistent
from testbed.bodies.posterior import Posterior
from testbed.bodies.prediction_errors import LEAST_SQUARES, POSTERIOR
from testbed.bodies.verdict import verdict_of
from testbed.core.base.codec import (
    ValueFactories,
    from_json_values,
    json_text,
    parse_json,
    to_json_values,
)
from testbed.core.base.contents import sha256_of_file
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import ExperimentError
from testbed.core.base.files import atomic_output
from testbed.core.base.installation import package_versions
from testbed.core.base.toml_text import Finite
from testbed.core.base.whole_files import write_atomically
from testbed.core.dynamics.drive_set import make_drive_set
from testbed.core.estimation.diagnostics.torques import diagnostics_of_estimates
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import method_minimal_set
from testbed.core.estimation.selection.chosen import completed_by_estimates
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.recording import Recording
from testbed.core.robot.asset_files import ASSET_SUFFIXES
from testbed.core.robot.friction import joint_law
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.model_file import ModelFile, copy_model, model_format
from testbed.lab.experiment.evaluate import evaluate
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import Bound
from testbed.lab.experiment.robot_tables import RecordingTables, StrictTable
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.score import Score

HASH_DIGITS = 16
"""Number of digits of a fingerprint in a comment."""


def provenance_lines(
    bodies: Consistent, model: ModelFile, recordings: Sequence[Path]
) -> list[str]:
    """Comment lines with version, methods, recordings and prior of a written model file."""
    methods = " and ".join(each.method for each in bodies.bent)
    return [
        f"testbed {package_versions()['testbed']}: inertials and joint losses are physically "
        "consistent",
        f"ones by the {methods} method from",
        *(
            f"{each.name} (sha256 {sha256_of_file(each)[:HASH_DIGITS]}),"
            for each in recordings
        ),
        f"prior {model.path.name} (sha256",
        f"{sha256_of_file(model.path)[:HASH_DIGITS]}) wrong by {bodies.prior_error:.2g}; all else",
        "is that file, unchanged",
    ]


RESULT_FIELDS = (
    "estimates",
    "failures",
    "score",
    "diagnostics",
    "validation",
    "drives",
    "consistent",
    "posterior",
    "verdict",
)
"""Attributes of a run that its result copies."""

MAX_ESTIMATES_BYTES = 500_000_000
"""Largest size of a run folder's estimates, decompressed [bytes]; a humanoid's have a tenth."""

INTERNAL_FIELDS = {"estimates": {"__all__": {"normal_equations", "measured_equations"}}}
"""Fields that the printed JSON omits: normal equations, most of an estimate's size."""


class UsedModel(StrictTable):
    """Model file of a result, and the settings used to read it."""

    path: str
    """Path of the file."""
    sha256: str
    """SHA-256 of its content."""
    weld_root: bool
    """True if a floating root was welded to the bedplate."""
    lock: dict[str, Finite | None]
    """Locked joints and their positions [rad or m]; None for the rest position."""

    @staticmethod
    def from_model_file(model: ModelFile, path: str, sha256: str) -> UsedModel:
        """Describe how a model file was read.

        Args:
            model: Model file.
            path: Path to store.
            sha256: SHA-256 of its content.
        """
        lock = dict(model.lock)
        return UsedModel(path=path, sha256=sha256, weld_root=model.weld_root, lock=lock)


@dataclass(frozen=True, eq=False, kw_only=True)
class Result:
    """Result of a recording or a run, as written to JSON.

    Attributes:
        format: Version of this document.
        source: Versions of the program, and SHA-256 of the files in a run folder.
        name: Name of the run.
        claim: Claim of the experiment, in words.
        expect: Claimed bounds by metric.
        verdicts: True for each bound that holds, by metric.
        as_expected: True if all claims hold.
        estimates: Estimates by method.
        failures: Reason of failure by method.
        score: Errors of the estimates against the truth; None without known truth.
        diagnostics: Warnings about robot, recording and estimates.
        validation: Residuals of another recording, by method.
        drives: Torque constants and friction identified by the plate.
        consistent: Physically consistent bodies.
        posterior: Estimates with the model file as prior, by method.
        plain: True if the least-squares estimates are reported despite a posterior.
        verdict: Reservations about the estimates, or one line of their prediction errors.
        model: Model file of the robot; that of a run is in its folder.
        settings: Tables of robot and identification; those of a run are in its folder.
    """

    format: Literal[2] = 2
    source: Mapping[str, str] = field(default_factory=package_versions)
    name: str = ""
    claim: str = ""
    expect: Mapping[str, Bound] = field(default_factory=dict)
    verdicts: Mapping[str, bool] = field(default_factory=dict)
    as_expected: bool = True
    estimates: Mapping[Signal, Estimate]
    failures: Mapping[Signal, str] = field(default_factory=dict)
    score: Score | None = None
    diagnostics: tuple[Diagnostic, ...] = ()
    validation: Mapping[Signal, Validation] = field(default_factory=dict)
    drives: DriveIdentification | None = None
    consistent: Consistent | None = None
    posterior: Mapping[Signal, Posterior] = field(default_factory=dict)
    plain: bool = False
    verdict: tuple[Diagnostic, ...] = ()
    model: UsedModel | None = None
    settings: dict[str, Any] | None = None

    def document(self) -> dict[str, Any]:
        """Content of the JSON document, without normal equations."""
        content: dict[str, Any] = to_json_values(self, exclude=INTERNAL_FIELDS)
        return content


def run_result(run: Run, source: Mapping[str, str] | None = None) -> Result:
    """Result of a run; `source` has versions and file hashes, by default the versions."""
    experiment, used_model = run.experiment, None
    if run.model is not None:
        sha256 = run.recording.metadata.model_sha256
        used_model = UsedModel.from_model_file(run.model, run.model.path.name, sha256)
    return Result(
        source=package_versions() if source is None else source,
        name=run.name,
        claim="" if experiment is None else experiment.claim,
        expect={} if experiment is None else experiment.expect,
        verdicts=run.verdicts,
        as_expected=run.as_expected,
        model=used_model,
        **{name: getattr(run, name) for name in RESULT_FIELDS},
    )


def identification_result(
    estimates: Iterable[Estimate],
    model: ModelFile,
    tables: RecordingTables,
    diagnostics: Iterable[Diagnostic] = (),
    consistent: Consistent | None = None,
    posterior: Mapping[Signal, Posterior] = {},
    *,
    plain: bool = False,
) -> Result:
    """Result of an identification, with the settings needed to rebuild the robot.

    Args:
        estimates: Estimates by one method or both.
        model: Model file, and how it was read.
        tables: Further settings of robot and identification.
        diagnostics: Diagnostics of the recording.
        consistent: Physically consistent bodies; None if not estimated.
        posterior: Estimates with the model file as prior, by method.
        plain: True to report the least-squares estimates despite a posterior.
    """
    by_method = {estimate.method: estimate for estimate in estimates}
    settings = _completed_tables(tables, by_method.values()).model_dump(
        mode="json", exclude_none=True
    )
    for key in ("lock", "lock_mimic"):  # the model's lock is all that was held
        settings["robot"].pop(key)
    used_model = UsedModel.from_model_file(
        model, str(model.path), sha256_of_file(model.path)
    )
    return Result(
        estimates=by_method,
        diagnostics=(*diagnostics, *diagnostics_of_estimates(by_method.values())),
        consistent=consistent,
        posterior=posterior,
        plain=plain,
        verdict=verdict_of(
            by_method.values(),
            posterior.values(),
            LEAST_SQUARES if plain else POSTERIOR,
            diagnostics,
        ),
        model=used_model,
        settings=settings,
    )


def _completed_tables(
    tables: RecordingTables, estimates: Iterable[Estimate]
) -> RecordingTables:
    """Copy of the tables, completed by joint terms and motor shafts of the estimates."""
    robot, estimates = tables.robot, list(estimates)
    for drives in (estimate.drives for estimate in estimates):
        if drives is not None and drives.tree.shafts:
            names = drives.tree.names
            coupling = {
                s.name: {names[j]: turn for j, turn in s.turns}
                for s in drives.tree.shafts
            }
            robot = robot.model_copy(update={"coupling": coupling})
    identification = completed_by_estimates(tables.identification, estimates)
    return tables.model_copy(update={"robot": robot, "identification": identification})


def write_estimates(result: Result, path: Path) -> None:
    """Write a result with all digits and the normal equations; an existing file is replaced."""
    write_atomically(
        path, gzip.compress(json_text(to_json_values(result), exact=True), mtime=0)
    )


def read_estimates(run: Run, path: Path, source: Mapping[str, str]) -> Run | None:
    """Read the estimates of a run from a file written by `write_estimates`.

    Returns:
        The run with estimates; None if the file does not exist, is damaged, or has another source.
    """
    try:
        with gzip.open(path) as file:
            content = parse_json(file.read(MAX_ESTIMATES_BYTES))
        if content["source"] != source:
            return None
        result: Result = from_json_values(Result, content, _value_makers(run))
        for each in result.estimates.values():
            if each.names != (each.drives or each.minimal).names:
                return None
    except Exception:  # a file that was damaged may be wrong in any way
        return None
    settings = completed_by_estimates(run.settings, result.estimates.values())
    return replace(
        run,
        settings=settings,
        **{name: getattr(result, name) for name in RESULT_FIELDS},
    )


def _value_makers(run: Run) -> ValueFactories:
    """Constructors, keyed by class, of values that are stored by name only."""
    tree, settings = run.tree, run.settings
    sets = {
        minimal.model: minimal
        for minimal in (method_minimal_set(tree, m, settings) for m in SIGNALS)
    }
    return {
        MinimalSet: sets.__getitem__,
        DriveSet: lambda words: make_drive_set(tree, sets["torque"], words),
        JointLaw: joint_law,
    }


EXPERIMENT_FILE, RECORDING_FILE, RESULT_FILE = (
    "experiment.toml",
    "recording.parquet",
    "result.json",
)
"""Names of files in a run folder."""
MOTION_FILE, VALIDATION_FILE, ESTIMATES_FILE = (
    "motion.toml",
    "unseen.parquet",
    "estimates.json.gz",
)
"""Names of files that only some run folders have."""
MODEL_FOLDER = "model"
"""Folder of the model file and the files it refers to."""


def default_folder(experiment: Experiment) -> Path:
    """Default run folder, runs/NAME-HASH; the hash covers the model file's content."""
    return Path("runs") / f"{experiment.name}-{_experiment_hash(experiment)[:8]}"


def check_folder(folder: Path, experiment: Experiment, *, force: bool = False) -> None:
    """Raise ExperimentError if a run folder has content that must not be replaced.

    A new folder and a folder of the same experiment may be written. With `force`, so may a folder
    of another experiment.

    Args:
        folder: Run folder.
        experiment: Experiment of the run.
        force: True if a run of another experiment may be replaced.

    Raises:
        ExperimentError: The folder has other content.
    """
    if not folder.is_dir():
        return
    present_names = {p.name for p in folder.iterdir()}
    own_names = {
        EXPERIMENT_FILE,
        RECORDING_FILE,
        RESULT_FILE,
        MODEL_FOLDER,
        MOTION_FILE,
        VALIDATION_FILE,
        ESTIMATES_FILE,
    }
    other_names = sorted(present_names - own_names)
    model_files = (
        each for each in (folder / MODEL_FOLDER).rglob("*") if each.is_file()
    )
    other_names += [
        f"{MODEL_FOLDER}/{each.name}"
        for each in model_files
        if each.suffix.lower() not in ASSET_SUFFIXES
    ]
    if present_names and (other_names or EXPERIMENT_FILE not in present_names):
        listed = ", ".join((other_names or sorted(present_names))[:3])
        raise ExperimentError(
            f"'{folder}' is no run folder: it holds {listed}"
            f"{' ...' if len(other_names) > 3 else ''}; name another with --out"
        )
    if present_names and not _is_run_of(folder, experiment):
        if Path(experiment.model).resolve().is_relative_to(folder.resolve()):
            raise ExperimentError(
                f"'{folder}' holds the model that this experiment reads; --out names another folder"
            )
        if not force:
            raise ExperimentError(
                f"'{folder}' holds a run of another experiment; --force replaces it, --out names "
                "another folder"
            )


def write_run(run: Run, folder: Path) -> None:
    """Write a run folder; it replaces an existing folder once all files are complete.

    Raises:
        ExperimentError: The run has no experiment.
    """
    if run.experiment is None:
        raise ExperimentError(
            f"run '{run.name}' is of no experiment: it has no run folder"
        )
    with atomic_output(folder, folder=True) as new_folder:
        _write_files(run.experiment, run.recording, new_folder)
        if run.unseen is not None:
            run.unseen.blind().save(new_folder / VALIDATION_FILE)
        result = run_result(run, _estimates_source(new_folder))
        write_estimates(result, new_folder / ESTIMATES_FILE)
        (new_folder / RESULT_FILE).write_bytes(json_text(result.document()) + b"\n")


def write_recording_folder(
    experiment: Experiment, recording: Recording, folder: Path
) -> None:
    """Write a run folder with a recording, without a result.

    Args:
        experiment: Experiment that made the recording.
        recording: Measured signals.
        folder: Run folder; an existing folder is replaced once all files are complete.
    """
    with atomic_output(folder, folder=True) as new_folder:
        _write_files(experiment, recording, new_folder)


def _write_files(experiment: Experiment, recording: Recording, folder: Path) -> None:
    """Write a new folder with experiment, model file, motion file and recording."""
    folder.mkdir()
    model = copy_model(Path(experiment.model), folder / MODEL_FOLDER).relative_to(
        folder
    )
    changes: dict[str, object] = {"model": model.as_posix()}
    if experiment.motion.file:
        shutil.copyfile(experiment.motion.file, folder / MOTION_FILE)
        changes["motion"] = experiment.motion.model_copy(update={"file": MOTION_FILE})
    stored_experiment = experiment.model_copy(update=changes)
    (folder / EXPERIMENT_FILE).write_text(stored_experiment.as_toml(), encoding="utf-8")
    recording.save(folder / RECORDING_FILE)


def _experiment_hash(experiment: Experiment) -> str:
    """Hash of an experiment and the content of its model and motion files.

    Raises:
        ModelError: The model file does not exist.
    """
    path = Path(experiment.model)
    settings = experiment.model_dump_json(exclude={"model": True, "motion": {"file"}})
    content = model_format(path) + sha256_of_file(path) + settings
    if experiment.motion.file:
        content += sha256_of_file(Path(experiment.motion.file))
    return hashlib.sha256(content.encode()).hexdigest()


def _is_run_of(folder: Path, experiment: Experiment) -> bool:
    """Test whether a run folder's experiment has the same hash; False if unreadable."""
    try:
        return _experiment_hash(
            Experiment.from_toml(folder / EXPERIMENT_FILE)
        ) == _experiment_hash(experiment)
    except (OSError, ExperimentError):  # unreadable, or its model file is gone
        return False


def read_run(folder: Path) -> Run:
    """Read a run from its run folder.

    If estimates are missing, outdated or from other package versions, they are computed again, and
    the run has no validation.

    Args:
        folder: Run folder.

    Raises:
        ExperimentError: The folder is not a run folder, or the model file is not the run's.
    """
    missing = [
        name
        for name in (EXPERIMENT_FILE, RECORDING_FILE)
        if not (folder / name).is_file()
    ]
    if missing:
        raise ExperimentError(
            f"'{folder}' is no run folder: it has no {', '.join(missing)}"
        )
    experiment = Experiment.from_toml(folder / EXPERIMENT_FILE)
    recording = Recording.load(folder / RECORDING_FILE)
    model = Path(experiment.model)
    if not model.is_file():
        raise ExperimentError(f"the run's model file '{model}' is not there any more")
    if sha256_of_file(model) != recording.metadata.model_sha256:
        raise ExperimentError(
            f"'{model}' is not the model that was simulated; run it again"
        )
    run_without_estimates = evaluate(experiment, recording, methods=())
    run = read_estimates(
        run_without_estimates, folder / ESTIMATES_FILE, _estimates_source(folder)
    )
    if run is None:
        return evaluate(experiment, recording)
    validation_path = folder / VALIDATION_FILE
    return (
        replace(run, unseen=Recording.load(validation_path))
        if validation_path.is_file()
        else run
    )


def _estimates_source(folder: Path) -> dict[str, str]:
    """Package versions, and SHA-256 of a run folder's input files, by name."""
    files = [
        name
        for name in (EXPERIMENT_FILE, RECORDING_FILE, VALIDATION_FILE)
        if (folder / name).is_file()
    ]
    return package_versions() | {name: sha256_of_file(folder / name) for name in files}
