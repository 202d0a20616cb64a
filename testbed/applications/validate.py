"""How well an estimate predicts a recording that it was not made from.

The other recording's rows are made as identification makes them. What is left of its signals is
held against what must be left: the noise that the estimate's own recording had, and what the
covariance of the parameters adds along the other motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from testbed.bodies.estimate_summary import check_parameters
from testbed.bodies.prediction_errors import (
    PLAIN,
    REFITTED,
    PredictionErrors,
    errors_of_another,
)
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import with_properties
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose, sentences
from testbed.core.base.errors import RecordingError
from testbed.core.base.stages import Progress, unreported
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.dynamics.newton_euler import Motion, linear
from testbed.core.estimation.estimate import (
    METHODS,
    Estimate,
    EstimateSummary,
    Method,
    channel_label,
    channel_units,
    matters,
)
from testbed.core.estimation.model_errors.model_errors import WithoutModelErrors
from testbed.core.estimation.problem import Problem, tare_of
from testbed.core.estimation.regression.normal_equations import square_root
from testbed.core.estimation.regression.windows import motion_taps
from testbed.core.estimation.selection.chosen import with_chosen_settings
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.recordings.geometry import in_its_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import RecordingLike, Source, longest_segment
from testbed.core.robot.friction import ROOM, SLOPE, term_torque
from testbed.core.robot.tree import Tree
from testbed.sensors.corrected import corrected


def motion_in(
    recording: Recording, settings: Settings = DEFAULTS
) -> tuple[Motion, slice]:
    """The motion that a recording's longest segment shows, and which of its samples that is.

    Args:
        recording: Encoders, and velocities and accelerations where they were sensed.
        settings: Whose filter on positions to use; default those of `Settings()`.

    Returns:
        The motion, and the slice of samples that it covers: filters take both ends.
    """
    first, last = longest_segment(recording)
    shown = recording.part(first, last)
    if shown.velocity is not None and shown.acceleration is not None:  # both
        rates = shown.velocity, shown.acceleration
        return Motion(shown.time, shown.position, *rates), slice(first, last)
    fitted = settings.fitted(shown.rate)
    taps = motion_taps(shown.rate, fitted.position_low_pass)
    reach = taps.shape[1] // 2
    inner = slice(first + reach, last - reach)
    if shown.samples <= 2 * reach:
        raise RecordingError("the recording is too short for the filter on positions")
    signals = (
        np.apply_along_axis(np.convolve, 0, shown.position, tap[::-1], "valid")
        for tap in taps
    )
    return Motion(recording.time[inner], *signals), inner


def parameters_of(estimate: Estimate, others: Array | None = None) -> Array:
    """Barycentric parameters that an estimate's minimal ones allow, (n, 10).

    Of all that do, the smallest, or those nearest to `others`: forces are the same.

    Args:
        estimate: Of either method.
        others: What to keep of the parameters that the estimate cannot identify, (n, 10).
    """
    matrix = estimate.minimal.matrix
    start = np.zeros(matrix.shape[1]) if others is None else others.ravel()
    gap = estimate.base.values - matrix @ start
    theta: Array = start + np.linalg.lstsq(matrix, gap, rcond=None)[0]
    return estimate.minimal.carried(theta).reshape(-1, 10)


def predictions(
    tree: Tree,
    recording: Recording,
    motion: Motion,
    estimates: Mapping[Method, Estimate],
) -> tuple[dict[Method, Array], dict[Method, Array]]:
    """What plate and drives should have shown along a motion, by method.

    By the internal estimate the wrench is the external one's with those parameters put in that
    joint torques identify, and there is none without it; by the external one torques lack what the
    joints add of their own.

    Args:
        tree: The robot; its masses do not matter.
        recording: Says its gravity, and how much of the wrench is the pedestal's.
        motion: The motion it shows.
        estimates: By method, "external" and "internal", in any order.

    Returns:
        Wrenches, pedestal included, (M, 6) [N, N m]; and motor torques, (M, n) [N m or N].
    """
    tree = in_its_gravity(tree, recording)
    tare = tare_of(tree, recording)
    theta = np.zeros((tree.n, 10, len(estimates)))
    methods = [method for method in METHODS if method in estimates]
    for k, method in enumerate(methods):  # the external one comes first
        theta[..., k] = parameters_of(estimates[method], theta[..., 0] if k else None)
    joints, plate = linear(tree, motion, theta)
    first = int(np.searchsorted(recording.time, motion.t[0]))
    warmth = recording.temperature
    warmth = None if warmth is None else warmth[first : first + motion.samples] - ROOM
    torque = {
        m: joints[..., k] + own_torque(motion, estimates[m], warmth)
        for k, m in enumerate(methods)
    }
    whole = methods if "external" in methods else []
    return {m: plate[..., k] + tare for k, m in enumerate(whole)}, torque


def own_torque(
    motion: Motion, estimate: Estimate, warmth: Array | None = None
) -> Array:
    """What an estimate's joint terms add to the torques, (M, n) [N m or N].

    Without the drift of offsets, which is one recording's.

    Args:
        motion: M samples, joints in the order of `estimate.joints`.
        estimate: Of either method; the external one knows none.
        warmth: Temperatures over 25 degC, (M, n) [K]; default none.
    """
    found = np.zeros_like(motion.qd)
    drives = estimate.drives
    if drives is not None:
        own = estimate.values[estimate.minimal.count :]
        for term, value in zip(drives.terms, own, strict=True):
            known = warmth is not None and term.law.by == "temperature"
            by = warmth[:, term.joint] if warmth is not None and known else 0.0
            found += value * term_torque(drives.tree, term, motion.qd, motion.qdd, by)
    return found


def friction(speed: Array, estimate: Estimate) -> Array:
    """What an estimate's joint terms add to the torques at steady speed, (M, n) [N m or N].

    Args:
        speed: Joint velocities, (M, n) [rad/s or m/s], in the order of `estimate.joints`.
        estimate: Of the internal method.
    """
    steady = Motion(
        np.arange(len(speed), dtype=float), speed, speed, np.zeros_like(speed)
    )
    return own_torque(steady, estimate)


def variances(
    tree: Tree, recording: Recording, motion: Motion, estimate: Estimate
) -> Array:
    """Variances of predictions of an estimate's own signal by its covariance, (M, C).

    Args:
        tree: The robot; its masses do not matter.
        recording: Says its gravity.
        motion: M samples.
        estimate: Of either method.
    """
    tree = in_its_gravity(tree, recording)
    terms = () if estimate.drives is None else estimate.drives.terms
    root = square_root(_beside_correction(estimate))
    bodies, own = np.split(root, [estimate.minimal.count])
    lift = np.linalg.pinv(estimate.minimal.matrix) @ bodies
    theta = estimate.minimal.carried(lift).reshape(tree.n, 10, -1)
    found = []
    for first in range(0, motion.samples, BLOCK):
        part = motion[first : first + BLOCK]
        columns = linear(tree, part, theta)[estimate.method == "external"]
        for term, row in zip(terms, own, strict=False):  # other unknowns follow
            torque = term_torque(tree, term, part.qd, part.qdd)
            columns += torque[..., None] * row
        found.append((columns**2).sum(axis=2))
    return np.concatenate(found)


def _beside_correction(estimate: EstimateSummary) -> Array:
    """Covariance without that of model errors, which is in the doubt about them, (p, p)."""
    if estimate.correction is None:
        return estimate.covariance
    return np.asarray(estimate.covariance - estimate.correction.covariance)


BLOCK = 4096
"""Samples whose variances are computed together."""

LEVEL = 1.96
"""Standard deviations within which 95 % of a normal distribution are."""

LIMIT = 2.0
"""Times what noise and covariance allow beyond which a residual is worth a warning."""


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Diagnosed, Summarized):
    """An estimate against another recording, channel by channel.

    Attributes:
        method: Of the estimate.
        channels: The measured channels, C.
        units: One each, N or N m.
        rows: Rows that count; where there are none, all numbers are nan.
        signal: Rms of the measured rows, (C,) [N, N m].
        residual: Rms of what the estimate leaves of them, (C,) [N, N m].
        mean: Of what it leaves: a zero that is another than in the estimate's own recording
            shows here, (C,) [N, N m].
        noise: Rms of what the estimate left of its own recording, (C,) [N, N m].
        spread: Rms of what the parameters' covariance makes of the rows, (C,) [N, N m].
        within: Part of the rows inside the band of 95 % of noise, parameters and the doubt about
            model errors, (C,).
        zero_unknown: Whether the plate's zero is not known: means are then no errors.
        errors: Of all candidates, the estimate among them; None where there are no others.
        held: Which of them the estimate is: "plain" or "posterior".
    """

    method: Method
    channels: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[int, ...]
    signal: Array
    residual: Array
    mean: Array
    noise: Array
    spread: Array
    within: Array
    zero_unknown: bool = False
    errors: PredictionErrors | None = None
    held: str = PLAIN

    __get_pydantic_core_schema__ = with_properties(
        "relative_residual", "ratio", "diagnostics"
    )

    def __post_init__(self) -> None:
        c = len(self.channels)
        freeze(
            self,
            signal=(c,),
            residual=(c,),
            mean=(c,),
            noise=(c,),
            spread=(c,),
            within=(c,),
        )

    @property
    def summary(self) -> SummaryTable:
        """Residual of each channel, as a part of the signal, over what noise and sigma allow."""
        parts = zip(
            self.residual,
            self.units,
            self.relative_residual,
            self.ratio,
            self.within,
            strict=True,
        )
        cells = [
            (f"{r:.3g}", unit, f"{s:.2%}", f"{ratio:.2g}", f"{within:.0%}")
            for r, unit, s, ratio, within in parts
        ]
        rows = [(name, *cell) for name, cell in zip(self.channels, cells, strict=True)]
        heads = (
            "channel",
            "rms residual",
            "unit",
            "of the signal",
            "over allowed",
            "in band",
        )
        warnings = tuple(f"warning: {line}" for line in sentences(self.diagnostics))
        return SummaryTable("estimate on another recording", (heads, *rows), warnings)

    @property
    def relative_residual(self) -> Array:
        """Residual as part of the signal, (C,); nan where there is none."""
        return _over(self.residual, self.signal)

    @property
    def allowed(self) -> Array:
        """Rms that noise and covariance make together, (C,) [N, N m]."""
        return np.hypot(self.noise, self.spread)

    @property
    def ratio(self) -> Array:
        """Error over what is allowed, (C,): about one, or less."""
        return _over(self.error, self.allowed)

    @property
    def error(self) -> Array:
        """Residual that is the estimate's, (C,) [N, N m]: about its mean if the zero is unknown."""
        return self.scatter if self.zero_unknown else self.residual

    @property
    def scatter(self) -> Array:
        """Rms of the residual about its mean, (C,) [N, N m]."""
        return np.sqrt(np.maximum(self.residual**2 - self.mean**2, 0.0))

    @property
    def matters(self) -> tuple[bool, ...]:
        """Whether each channel's residual is large enough to matter among like channels."""
        return matters(self.error, self.signal, self.units)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Channels that are predicted worse than by the model file, or than sigma says."""
        worse: list[Diagnostic] = []
        if self.errors is not None:
            worse = [
                d
                for than in (PLAIN, REFITTED)
                for d in self.errors.worse(self.held, than)
            ]
        return (*worse, *_diagnostics(self))


def validate(
    tree: Tree,
    recording: RecordingLike,
    estimate: EstimateSummary,
    *,
    gravity: ArrayLike | None = None,
    settings: Settings | None = None,
    threads: int | None = None,
    progress: Progress = unreported,
    models: Mapping[str, Array] | None = None,
    held: str = PLAIN,
) -> Validation:
    """What an estimate leaves of a recording that it has not seen.

    Rows are made as by `identify`: same filters, rows that count, tare and gravity. Numbers of
    the instrument that were estimated are taken back first, but for those that are of one
    recording only, the plate's zero and drift; nor are constants subtracted: see `mean`. Model
    errors that the estimate names and other motions have are taken out, and their doubt allowed.

    Args:
        tree: The robot; its inertias are not used, except for `settings.zeros`.
        recording: Another one of the same robot and instrument, as for `identify`.
        estimate: What is to be validated.
        gravity: (3,) [m/s^2], bedplate frame; default the recording's, if it says, else the
            estimate's.
        settings: Default those of the estimate.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all.
        models: Values of the same unknowns by what else predicts (`Posterior.models`).
        held: What the estimate is among them: "plain" or "posterior".

    Raises:
        RecordingError: The recording cannot be used for the estimate's method.
        SettingsError: Robot and settings have other parameters than the estimate.
    """
    if settings is None:
        settings = estimate.settings
    elif isinstance(estimate, Estimate):
        settings = with_chosen_settings(settings, [estimate])
    problem = Problem.of(
        tree.with_gravity(estimate.gravity),
        recording,
        estimate.method,
        settings,
        gravity=gravity,
        threads=threads,
        progress=progress,
    )
    check_parameters(problem, estimate)
    source = corrected(problem.source, problem.tree, estimate.sensor_errors)
    with one_blas_thread():
        found = _validation(problem, source, estimate)
        if models:
            errors = errors_of_another(
                problem, source, {**models, held: estimate.values}
            )
            found = replace(found, errors=errors, held=held)
    return found


def _validation(
    problem: Problem, source: Source, estimate: EstimateSummary
) -> Validation:
    """Residuals of another recording's rows, faults of the instrument taken back."""
    doubt = np.zeros(len(problem.channels))
    covariance = _beside_correction(estimate)
    if estimate.correction is not None:
        source = WithoutModelErrors(
            problem, source, estimate.values, estimate.correction
        )
        doubt = source.doubt
    passes = problem.passes(2, source, whole=True)
    equations = problem.equations(passes)
    drifts = [name.startswith(SLOPE.kind + "/") for name in estimate.names]
    # the drift of offsets is one recording's
    values = np.where(drifts, 0.0, estimate.values)
    total, squares, within = np.zeros((3, len(problem.channels)))
    fixed = (estimate.residual**2 + doubt)[:, None]
    combined = np.column_stack([values, square_root(covariance)])
    for columns, measured in passes.rows(combined):
        left = measured - columns[..., 0]
        total += left.sum(axis=1)
        squares += (left**2).sum(axis=1)
        variance = fixed + (columns[..., 1:] ** 2).sum(axis=2)
        counts = columns[..., 1:].any(axis=2)
        within += (counts & (left**2 <= LEVEL**2 * variance)).sum(axis=1)
    used = np.where(equations.used > 0, equations.used, np.nan)
    added = np.maximum(np.einsum("cij,ij->c", equations.normal, covariance), 0.0)
    found = Validation(
        method=estimate.method,
        channels=equations.channels,
        units=channel_units(problem.tree, estimate.method),
        rows=tuple(int(n) for n in equations.used),
        signal=np.sqrt(equations.squares / used),
        residual=np.sqrt(squares / used),
        mean=total / used,
        noise=np.where(np.isnan(used), np.nan, estimate.residual),
        spread=np.sqrt(added / used + doubt),
        within=within / used,
        zero_unknown=bool(estimate.unidentifiable),
    )
    numbers = [found.signal, found.residual, found.mean, found.spread]
    if not np.isfinite(numbers)[:, equations.used > 0].all():
        raise RecordingError(
            "the recording or the estimate holds numbers too large for sums"
        )
    return found


def _diagnostics(found: Validation) -> Iterator[Diagnostic]:
    """Channels that are predicted worse than sigma says."""
    # never, if the zero is unknown
    steady = _over(found.scatter, found.allowed) <= LIMIT
    for c, (name, ratio) in enumerate(zip(found.channels, found.ratio, strict=True)):
        if ratio > LIMIT and found.matters[c]:
            yield diagnose(
                "estimate.prediction-offset" if steady[c] else "estimate.prediction",
                channel_label(found.method, name),
                float(ratio),
                method=found.method,
                residual=found.residual[c],
                allowed=found.allowed[c],
                mean=found.mean[c],
                unit=found.units[c],
            )


def _over(above: Array, below: Array) -> Array:
    """A quotient; nan where nothing is over nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return above / below
