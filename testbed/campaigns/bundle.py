"""Runs of a campaign: what each is known by, and how a bundle of them is carried out by a worker.

Plain values in, plain values out. A run that fails is an outcome like any other. What a run gives
does not depend on the runs beside it, to the bit: they only share what they would all compute.
"""

from __future__ import annotations

import hashlib
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

import testbed
from testbed.campaigns.campaign import experiment_of
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import ExperimentError, TestbedError, printable
from testbed.core.base.files import fingerprint
from testbed.core.base.installation import versions
from testbed.core.estimation.estimate import Method
from testbed.core.robot.model_file import model_format, references
from testbed.lab.experiment.experiment import Experiment

LENGTH = 32
"""Hexadecimal digits of a hash."""

ONLY_SHOWN = ("cli", "reporting", "viewer", "symbolic")
"""Rooms that no result depends on."""

_MODELS = (".xml", ".mjcf", ".urdf")
Status = Literal["done", "failed", "killed"]
"""Of a run: killed ones are made again by the next command, since nobody knows why."""


def run_hash(experiment: Experiment, methods: Sequence[str]) -> str:
    """The hash of a run: its experiment, its model files (meshes aside), the version of the code.

    Args:
        experiment: Of the run, resolved.
        methods: Which estimates are made.

    Raises:
        ModelError: There is no such model file.
    """
    left_out: Any = {"model": True, "name": True, "claim": True, "motion": {"file"}}
    said = [experiment.model_dump_json(exclude=left_out), ",".join(methods), code_version()]
    said.append(_model_digest(experiment.model, _stamp(experiment.model)))
    if experiment.motion.file:
        said.append(_digest(experiment.motion.file, _stamp(experiment.motion.file)))
    return hashlib.sha256("\n".join(said).encode()).hexdigest()[:LENGTH]


@cache
def code_version() -> str:
    """A digest of the modules that make results, and of the packages that they use."""
    home = Path(testbed.__file__).parent
    made_by = versions() | {"numba": version("numba")}
    digest = hashlib.sha256(repr(sorted(made_by.items())).encode())
    for path in sorted(home.rglob("*.py")):
        place = path.relative_to(home)
        if place.parts[0] not in ONLY_SHOWN:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _stamp(path: str) -> tuple[int, int]:
    """What shows that a file has changed."""
    try:
        found = Path(path).stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=256)
def _model_digest(path: str, stamp: tuple[int, int]) -> str:
    del stamp
    model = Path(path)
    parts = [model_format(model), fingerprint(model)]
    held = sorted(file for file in references(model) if file.suffix.lower() in _MODELS)
    parts += [fingerprint(file) for file in held if file != model.resolve()]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()


@lru_cache(maxsize=256)
def _digest(path: str, stamp: tuple[int, int]) -> str:
    del stamp
    return fingerprint(Path(path))


if TYPE_CHECKING:
    from testbed.core.recordings.recording import Recording
    from testbed.lab.experiment.run import Run


@dataclass(frozen=True)
class Bundle:
    """Runs that go to a worker together.

    Attributes:
        base: The experiment's file.
        content: Its tables, unchecked.
        methods: Which estimates are made.
        keeps: Whether recordings come back.
        code: Version of the code that asks.
        runs: Hash and words of each run.
    """

    base: str
    content: Mapping[str, Any]
    methods: tuple[Method, ...]
    keeps: bool
    code: str
    runs: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass(frozen=True)
class Outcome:
    """What came of a run, as plain values.

    Attributes:
        run: Its hash.
        status: Whether it has a result.
        error: Why not, in a line.
        metrics: Figures of merit by name.
        estimates: By method: names, truth, values, sigma, relative errors, a list each.
        diagnostics: What a careful reader should know.
        recording: Content of its Parquet file; None where it is dropped.
    """

    run: str
    status: Status
    error: str = ""
    metrics: Mapping[str, float] | None = None
    estimates: Mapping[str, Mapping[str, Any]] | None = None
    diagnostics: tuple[Diagnostic, ...] = ()
    recording: bytes | None = None


def carry_out_bundle(bundle: Bundle) -> tuple[list[Outcome], float]:
    """Carry out the runs of a bundle.

    Returns:
        An outcome each, in their order, and the seconds that all took.

    Raises:
        ExperimentError: The worker has another version of the code than who asks.
    """
    start = time.perf_counter()
    if bundle.code != code_version():
        raise ExperimentError(
            "a worker has another version of testbed, Python or its packages than this command; "
            "install the same ones everywhere"
        )
    with warnings.catch_warnings(), one_blas_thread():
        warnings.simplefilter("ignore")  # numerical doubt is a field of the result
        outcomes = _outcomes(bundle)
    return outcomes, time.perf_counter() - start


def _outcomes(bundle: Bundle) -> list[Outcome]:
    from testbed.lab.experiment.record import record

    found: dict[str, Outcome] = {}
    asked: dict[str, Experiment] = {}
    for run, words in bundle.runs:
        try:
            experiment = experiment_of(bundle.content, Path(bundle.base), words)
            if run_hash(experiment, bundle.methods) != run:
                raise ExperimentError("the worker finds other files than this command did")
            asked[run] = experiment
        except TestbedError as error:
            found[run] = _failed(run, error)
    for run, experiment in asked.items():
        recording: Recording | Exception
        try:
            recording = record(experiment)
        except Exception as error:
            recording = error
        found[run] = _outcome(run, experiment, recording, bundle)
    return [found[run] for run, _ in bundle.runs]


def _outcome(
    run: str, experiment: Experiment, recording: Recording | Exception, bundle: Bundle
) -> Outcome:
    """What comes of a simulated run."""
    from testbed.lab.experiment.carry_out import with_payload_metrics
    from testbed.lab.experiment.evaluate import evaluate

    if isinstance(recording, Exception):
        return _failed(run, recording)
    try:
        done = evaluate(experiment, recording, methods=bundle.methods, threads=1)
        done = with_payload_metrics(done)
        if not done.estimates:
            raise ExperimentError("; ".join(done.failures.values()))
        return Outcome(
            run,
            "done",
            metrics=dict(done.metrics),
            estimates=_estimates(done),
            diagnostics=done.diagnostics,
            recording=_file_of(recording) if bundle.keeps else None,
        )
    except Exception as error:
        return _failed(run, error)


def _failed(run: str, error: Exception) -> Outcome:
    """A run that gave no result; one that lacked memory may do better another time."""
    name = "" if isinstance(error, TestbedError) else f"{type(error).__name__}: "
    status: Status = "killed" if isinstance(error, MemoryError) else "failed"
    return Outcome(run, status, printable(name + str(error)))


def _estimates(run: Run) -> dict[str, dict[str, Any]]:
    """Every estimate with its truth, a list each."""
    assert run.score is not None
    found: dict[str, dict[str, Any]] = {}
    for method, estimate in run.estimates.items():
        errors = run.score.errors[method]
        found[method] = {
            "names": list(estimate.names),
            "truth": errors.truth.tolist(),
            "values": estimate.values.tolist(),
            "sigma": estimate.sigma.tolist(),
            "relative_error": [x if np.isfinite(x) else None for x in errors.relative.tolist()],
        }
    return found


def _file_of(recording: Recording) -> bytes:
    with TemporaryDirectory(prefix="testbed-") as folder:
        path = Path(folder) / "recording.parquet"
        recording.save(path)
        return path.read_bytes()
