"""What came of a recording, as `--json`, result.json and estimates.json.gz have it: format 2.

One value for runs and for `identify`. Programs get it without the sums of products, and null where
there is no number; a run folder has, compressed, all of it to the last digit, so that who looks at
it computes nothing again.
"""

from __future__ import annotations

import gzip
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from testbed.codec import Makers, decode, encode, from_json, json_text
from testbed.diagnostics.diagnostic import Diagnostic
from testbed.dynamics.drive_set import drive_set
from testbed.experiment.experiment import RecordingTables
from testbed.experiment.experiment_tables import Bound
from testbed.experiment.run import Run
from testbed.experiment.score import Score
from testbed.experiment.versions import versions
from testbed.files import fingerprint, replacing
from testbed.identification.consistency.consistent import Consistent
from testbed.identification.diagnostics.cross_check import diagnostics_of
from testbed.identification.drives.identify_drives import DriveFindings
from testbed.identification.estimate import METHODS, MODEL_OF, Estimate, Method
from testbed.identification.problem import set_of
from testbed.identification.selection.term_choice import with_chosen_terms
from testbed.identification.sensor.catalogue import NUISANCES, TESTED
from testbed.identification.sensor.nuisance import Nuisance
from testbed.identification.validate import Validation
from testbed.parameters.joint_terms import DriveSet
from testbed.parameters.minimal_set import MinimalSet
from testbed.robot.friction import JointLaw, joint_law
from testbed.robot.model_file import ModelFile

FIELDS = (
    "estimates", "failures", "score", "diagnostics", "validation", "drives", "consistent",
)  # fmt: skip
"""Of a run."""

LARGEST = 500_000_000
"""Bytes of a run folder's estimates; a humanoid's have a tenth."""

FOR_OURSELVES = {"estimates": {"__all__": {"normal_equations"}}}
"""Sums of products, which are most of an estimate."""


@dataclass(frozen=True)
class UsedModel:
    """A model file, and how it was read.

    Attributes:
        path: Of the file.
        sha256: Of its content.
        weld_root: Whether a floating root was welded to the bedplate.
        lock: Joints that were held, and where [rad or m]; None where they rest.
    """

    path: str
    sha256: str
    weld_root: bool
    lock: Mapping[str, float | None]


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
        sha256 = str(run.recording.facts.get("model_sha256", ""))
        used = UsedModel(run.model.path.name, sha256, run.model.weld_root, run.model.lock)
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
) -> Result:
    """Estimates of a recording, and what is needed to make their robot again.

    Args:
        estimates: By one method or by both.
        model: The model file, and how it was read.
        tables: What else was said of robot and identification.
        diagnostics: Of the recording.
        consistent: Bodies, where they were asked for.
    """
    found = {estimate.method: estimate for estimate in estimates}
    settings = _settled(tables, found.values()).model_dump(mode="json", exclude_none=True)
    for key in ("lock", "lock_mimic"):  # the model's lock is all that was held
        settings["robot"].pop(key)
    used = UsedModel(str(model.path), fingerprint(model.path), model.weld_root, model.lock)
    return Result(
        estimates=found,
        diagnostics=(*diagnostics, *diagnostics_of(found.values())),
        consistent=consistent,
        model=used,
        settings=settings,
    )


def _settled(tables: RecordingTables, estimates: Iterable[Estimate]) -> RecordingTables:
    """The same with the terms and the shafts that the estimates have."""
    robot, estimates = tables.robot, list(estimates)
    for drives in (estimate.drives for estimate in estimates):
        if drives is not None and drives.tree.shafts:
            names = drives.tree.names
            said = {s.name: {names[j]: turn for j, turn in s.turns} for s in drives.tree.shafts}
            robot = robot.model_copy(update={"coupling": said})
    identification = with_chosen_terms(tables.identification, estimates)
    return tables.model_copy(update={"robot": robot, "identification": identification})


def write_estimates(result: Result, path: Path) -> None:
    """Write all that came of a run.

    Args:
        result: With the source by which it is known again.
        path: Where to; what stands there is replaced.
    """
    with replacing(path) as fresh:
        fresh.write_bytes(gzip.compress(json_text(encode(result), exact=True), mtime=0))


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
    settings = with_chosen_terms(run.settings, found.estimates.values())
    return replace(run, settings=settings, **{name: getattr(found, name) for name in FIELDS})


def _makers(run: Run) -> Makers:
    """What makes values of their names: the robot's sets, laws, unknowns of the instrument."""
    tree, settings = run.tree, run.settings
    sets = {MODEL_OF[method]: set_of(tree, method, settings) for method in METHODS}
    return {
        MinimalSet: sets.__getitem__,
        DriveSet: lambda words: drive_set(tree, sets["dynamic"], words),
        JointLaw: joint_law,
        Nuisance: {each.kind: each for each in (*NUISANCES, *TESTED)}.__getitem__,
    }
