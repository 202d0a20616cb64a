"""What came of a recording, as JSON and as a run folder that repeats it."""

from __future__ import annotations

import gzip
import hashlib
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from testbed.applications.drives.identify_drives import DriveFindings
from testbed.applications.validate import Validation
from testbed.bodies.consistency.consistent import Consistent
from testbed.bodies.posterior import Posterior
from testbed.bodies.prediction_errors import PLAIN, POSTERIOR
from testbed.bodies.verdict import verdict_of
from testbed.core.base.codec import Makers, decode, encode, from_json, json_text
from testbed.core.base.contents import fingerprint
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import ExperimentError
from testbed.core.base.files import replacing
from testbed.core.base.installation import versions
from testbed.core.base.toml_text import Finite
from testbed.core.base.whole_files import write_whole
from testbed.core.dynamics.drive_set import drive_set
from testbed.core.estimation.diagnostics.torques import diagnostics_of
from testbed.core.estimation.estimate import METHODS, Estimate, Method
from testbed.core.estimation.problem import set_of
from testbed.core.estimation.selection.chosen import with_chosen_settings
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.recordings.recording import Recording
from testbed.core.robot.asset_files import ENDINGS
from testbed.core.robot.friction import joint_law
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.model_file import ModelFile, copy_model, model_format
from testbed.lab.experiment.evaluate import evaluate
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import Bound
from testbed.lab.experiment.robot_tables import RecordingTables, StrictTable
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.score import Score

DIGITS = 16
"""Of a fingerprint, in a comment."""


def provenance(
    found: Consistent, model: ModelFile, recordings: Sequence[Path]
) -> list[str]:
    """Where the numbers of a written file come from, for a comment.

    Args:
        found: What is written.
        model: The file that is copied.
        recordings: What it was identified from.
    """
    methods = " and ".join(each.method for each in found.bent)
    return [
        f"testbed {versions()['testbed']}: inertials and joint losses are physically consistent",
        f"ones by the {methods} method from",
        *(f"{each.name} (sha256 {fingerprint(each)[:DIGITS]})," for each in recordings),
        f"prior {model.path.name} (sha256",
        f"{fingerprint(model.path)[:DIGITS]}) wrong by {found.prior_error:.2g}; all else",
        "is that file, unchanged",
    ]


FIELDS = (
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
"""Of a run."""

LARGEST = 500_000_000
"""Bytes of a run folder's estimates; a humanoid's have a tenth."""

FOR_OURSELVES = {"estimates": {"__all__": {"normal_equations", "measured_equations"}}}
"""Sums of products, which are most of an estimate."""


class UsedModel(StrictTable):
    """A model file, and how it was read."""

    path: str
    """Of the file."""
    sha256: str
    """Of its content."""
    weld_root: bool
    """Whether a floating root was welded to the bedplate."""
    lock: dict[str, Finite | None]
    """Joints that were held, and where [rad or m]; None where they rest."""

    @staticmethod
    def of(model: ModelFile, path: str, sha256: str) -> UsedModel:
        """How a model file is read.

        Args:
            model: The file.
            path: What it is called.
            sha256: Of its content.
        """
        lock = dict(model.lock)
        return UsedModel(path=path, sha256=sha256, weld_root=model.weld_root, lock=lock)


@dataclass(frozen=True, eq=False, kw_only=True)
class Result:
    """What came of a recording.

    Attributes:
        format: Of this document.
        source: What made it: versions, and SHA-256 of the files in a run folder.
        name: Of a run.
        claim: Of its experiment.
        expect: What was claimed, by metric.
        verdicts: Whether each claim holds.
        as_expected: Whether all do.
        estimates: By method.
        failures: Why a method has no estimate.
        score: Of the estimates, where the truth is known.
        diagnostics: What a careful reader should know.
        validation: By method, on another motion.
        drives: What the plate says of them.
        consistent: Bodies that can exist.
        posterior: What the recording adds to the model file, by method.
        plain: Whether least squares are the answer all the same.
        verdict: What to know first of the answer.
        model: The robot's file; that of a run is in its folder.
        settings: Tables of robot and identification; those of a run are in its folder.
    """

    format: Literal[2] = 2
    source: Mapping[str, str] = field(default_factory=versions)
    name: str = ""
    claim: str = ""
    expect: Mapping[str, Bound] = field(default_factory=dict)
    verdicts: Mapping[str, bool] = field(default_factory=dict)
    as_expected: bool = True
    estimates: Mapping[Method, Estimate]
    failures: Mapping[Method, str] = field(default_factory=dict)
    score: Score | None = None
    diagnostics: tuple[Diagnostic, ...] = ()
    validation: Mapping[Method, Validation] = field(default_factory=dict)
    drives: DriveFindings | None = None
    consistent: Consistent | None = None
    posterior: Mapping[Method, Posterior] = field(default_factory=dict)
    plain: bool = False
    verdict: tuple[Diagnostic, ...] = ()
    model: UsedModel | None = None
    settings: dict[str, Any] | None = None

    def document(self) -> dict[str, Any]:
        """For programs, as JSON takes it."""
        found: dict[str, Any] = encode(self, exclude=FOR_OURSELVES)
        return found


def result_of(run: Run, source: Mapping[str, str] | None = None) -> Result:
    """What came of a run.

    Args:
        run: The run.
        source: What it came of; default the versions.
    """
    asked, used = run.experiment, None
    if run.model is not None:
        sha256 = run.recording.metadata.model_sha256
        used = UsedModel.of(run.model, run.model.path.name, sha256)
    return Result(
        source=versions() if source is None else source,
        name=run.name,
        claim="" if asked is None else asked.claim,
        expect={} if asked is None else asked.expect,
        verdicts=run.verdicts,
        as_expected=run.as_expected,
        model=used,
        **{name: getattr(run, name) for name in FIELDS},
    )


def identified(
    estimates: Iterable[Estimate],
    model: ModelFile,
    tables: RecordingTables,
    diagnostics: Iterable[Diagnostic] = (),
    consistent: Consistent | None = None,
    posterior: Mapping[Method, Posterior] = {},
    *,
    plain: bool = False,
) -> Result:
    """Estimates of a recording, and what is needed to make their robot again.

    Args:
        estimates: By one method or by both.
        model: The model file, and how it was read.
        tables: What else was said of robot and identification.
        diagnostics: Of the recording.
        consistent: Bodies, where they were asked for.
        posterior: What the recording adds to the model file, by method.
        plain: Whether least squares are the answer all the same.
    """
    found = {estimate.method: estimate for estimate in estimates}
    settings = _settled(tables, found.values()).model_dump(
        mode="json", exclude_none=True
    )
    for key in ("lock", "lock_mimic"):  # the model's lock is all that was held
        settings["robot"].pop(key)
    used = UsedModel.of(model, str(model.path), fingerprint(model.path))
    return Result(
        estimates=found,
        diagnostics=(*diagnostics, *diagnostics_of(found.values())),
        consistent=consistent,
        posterior=posterior,
        plain=plain,
        verdict=verdict_of(
            found.values(),
            posterior.values(),
            PLAIN if plain else POSTERIOR,
            diagnostics,
        ),
        model=used,
        settings=settings,
    )


def _settled(tables: RecordingTables, estimates: Iterable[Estimate]) -> RecordingTables:
    """The same with the terms and the shafts that the estimates have."""
    robot, estimates = tables.robot, list(estimates)
    for drives in (estimate.drives for estimate in estimates):
        if drives is not None and drives.tree.shafts:
            names = drives.tree.names
            said = {
                s.name: {names[j]: turn for j, turn in s.turns}
                for s in drives.tree.shafts
            }
            robot = robot.model_copy(update={"coupling": said})
    identification = with_chosen_settings(tables.identification, estimates)
    return tables.model_copy(update={"robot": robot, "identification": identification})


def write_estimates(result: Result, path: Path) -> None:
    """Write all that came of a run.

    Args:
        result: With the source by which it is known again.
        path: Where to; what stands there is replaced.
    """
    write_whole(path, gzip.compress(json_text(encode(result), exact=True), mtime=0))


def read_estimates(run: Run, path: Path, source: Mapping[str, str]) -> Run | None:
    """A run with what came of it.

    Args:
        run: The same without estimates.
        path: The file.
        source: What the run comes of.

    Returns:
        None where there is no such file, or what it holds came of something else.
    """
    try:
        with gzip.open(path) as file:
            content = from_json(file.read(LARGEST))
        if content["source"] != source:
            return None
        found: Result = decode(Result, content, _makers(run))
        for each in found.estimates.values():
            if each.names != (each.drives or each.minimal).names:
                return None
    except Exception:  # a file that was damaged may be wrong in any way
        return None
    settings = with_chosen_settings(run.settings, found.estimates.values())
    return replace(
        run, settings=settings, **{name: getattr(found, name) for name in FIELDS}
    )


def _makers(run: Run) -> Makers:
    """What makes values of their names: the robot's sets, laws, unknowns of the instrument."""
    tree, settings = run.tree, run.settings
    sets = {
        found.model: found for found in (set_of(tree, m, settings) for m in METHODS)
    }
    return {
        MinimalSet: sets.__getitem__,
        DriveSet: lambda words: drive_set(tree, sets["dynamic"], words),
        JointLaw: joint_law,
    }


EXPERIMENT, RECORDING, RESULT = "experiment.toml", "recording.parquet", "result.json"
MOTION, UNSEEN, ESTIMATES = "motion.toml", "unseen.parquet", "estimates.json.gz"
MODEL = "model"
"""Folder of the model file and what it refers to."""


def default_folder(experiment: Experiment) -> Path:
    """runs/NAME-HASH, the hash over the experiment and the model file's content."""
    return Path("runs") / f"{experiment.name}-{_identity(experiment)[:8]}"


def check_folder(folder: Path, experiment: Experiment, *, force: bool = False) -> None:
    """Whether a run may be written there: a new place, the same run again, or any by force.

    Args:
        folder: Where to.
        experiment: Of the run.
        force: Whether a run of another experiment may be replaced.

    Raises:
        ExperimentError: Something else is there.
    """
    if not folder.is_dir():
        return
    present = {p.name for p in folder.iterdir()}
    own = {EXPERIMENT, RECORDING, RESULT, MODEL, MOTION, UNSEEN, ESTIMATES}
    others = sorted(present - own)
    kept = (each for each in (folder / MODEL).rglob("*") if each.is_file())
    others += [
        f"{MODEL}/{each.name}" for each in kept if each.suffix.lower() not in ENDINGS
    ]
    if present and (others or EXPERIMENT not in present):
        listed = ", ".join((others or sorted(present))[:3])
        raise ExperimentError(
            f"'{folder}' is no run folder: it holds {listed}"
            f"{' ...' if len(others) > 3 else ''}; name another with --out"
        )
    if present and not _is_of(folder, experiment):
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
    """Write a run folder; an older one stays until all of the new one is there.

    Args:
        run: Of an experiment.
        folder: Where to.

    Raises:
        ExperimentError: No experiment made the run.
    """
    if run.experiment is None:
        raise ExperimentError(
            f"run '{run.name}' is of no experiment: it has no run folder"
        )
    with replacing(folder, folder=True) as fresh:
        _write_files(run.experiment, run.recording, fresh)
        if run.unseen is not None:
            run.unseen.blind().save(fresh / UNSEEN)
        result = result_of(run, _source(fresh))
        write_estimates(result, fresh / ESTIMATES)
        (fresh / RESULT).write_bytes(json_text(result.document()) + b"\n")


def write_recorded(experiment: Experiment, recording: Recording, folder: Path) -> None:
    """Write a run folder without a result.

    Args:
        experiment: What was carried out.
        recording: What was measured.
        folder: Where to; an older run stays until all of the new one is there.
    """
    with replacing(folder, folder=True) as fresh:
        _write_files(experiment, recording, fresh)


def _write_files(experiment: Experiment, recording: Recording, folder: Path) -> None:
    """Write a new folder with an experiment, its model file and motion, and the recording."""
    folder.mkdir()
    model = copy_model(Path(experiment.model), folder / MODEL).relative_to(folder)
    changed: dict[str, object] = {"model": model.as_posix()}
    if experiment.motion.file:
        shutil.copyfile(experiment.motion.file, folder / MOTION)
        changed["motion"] = experiment.motion.model_copy(update={"file": MOTION})
    here = experiment.model_copy(update=changed)
    (folder / EXPERIMENT).write_text(here.as_toml(), encoding="utf-8")
    recording.save(folder / RECORDING)


def _identity(experiment: Experiment) -> str:
    """Hash of an experiment and its model file's content.

    Raises:
        ModelError: There is no such model file.
    """
    path = Path(experiment.model)
    said = experiment.model_dump_json(exclude={"model": True, "motion": {"file"}})
    content = model_format(path) + fingerprint(path) + said
    if experiment.motion.file:
        content += fingerprint(Path(experiment.motion.file))
    return hashlib.sha256(content.encode()).hexdigest()


def _is_of(folder: Path, experiment: Experiment) -> bool:
    """Whether a run folder is of an experiment."""
    try:
        return _identity(Experiment.from_toml(folder / EXPERIMENT)) == _identity(
            experiment
        )
    except (OSError, ExperimentError):  # unreadable, or its model file is gone
        return False


def read_run(folder: Path) -> Run:
    """A run folder's run, as it was when it was written.

    Estimates are made again where the folder has none, or was changed, or is of other versions;
    they are then not yet validated.

    Args:
        folder: The run folder.

    Raises:
        ExperimentError: It is no run folder, or the model file is not the run's.
    """
    missing = [
        name for name in (EXPERIMENT, RECORDING) if not (folder / name).is_file()
    ]
    if missing:
        raise ExperimentError(
            f"'{folder}' is no run folder: it has no {', '.join(missing)}"
        )
    experiment = Experiment.from_toml(folder / EXPERIMENT)
    recording = Recording.load(folder / RECORDING)
    model = Path(experiment.model)
    if not model.is_file():
        raise ExperimentError(f"the run's model file '{model}' is not there any more")
    if fingerprint(model) != recording.metadata.model_sha256:
        raise ExperimentError(
            f"'{model}' is not the model that was simulated; run it again"
        )
    bare = evaluate(experiment, recording, methods=())
    run = read_estimates(bare, folder / ESTIMATES, _source(folder))
    if run is None:
        return evaluate(experiment, recording)
    other = folder / UNSEEN
    return replace(run, unseen=Recording.load(other)) if other.is_file() else run


def _source(folder: Path) -> dict[str, str]:
    """All that estimates in a run folder came of: its files, and what computed them."""
    files = [
        name for name in (EXPERIMENT, RECORDING, UNSEEN) if (folder / name).is_file()
    ]
    return versions() | {name: fingerprint(folder / name) for name in files}
