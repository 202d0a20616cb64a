"""Sections of a report on signals, residual spectra and friction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import welch

from testbed.core.base.arrays import Array
from testbed.core.parameters.rules import Signal
from testbed.lab.experiment.predict import Channel, Predictions
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.summary import percent_text
from testbed.view.bodies import bodies_section
from testbed.view.drives import BAND_SIGMAS, curve_lines, drive_section
from testbed.view.figures import Panel, subsampled_curve
from testbed.view.section import Section, Table

MAX_SEGMENT_SAMPLES = 2048
"""Largest number of samples of a segment in Welch's method."""
PLOTTED_DURATION = 10.0
"""Duration of plotted signals [s]."""
LOW_PASS_CUTOFF = 10.0
"""Cutoff of the low-pass on plotted signals [Hz]."""
MOTION_BANDWIDTH = 5.0
"""Frequency between the bands of motion (below) and noise (above) [Hz]."""
VISIBLE_CHANNELS, VISIBLE_PANELS = 6, 3
"""Number of plots that are not folded away: of signals, and of other figures."""


def sections(predictions: Predictions) -> list[Section]:
    """Sections of a report: signals, residual spectra, friction, drives, consistent bodies.

    Sections without data are left out.

    Args:
        predictions: Predictions on the held-out recording, or on the recording of the fit.
    """
    smooth = predictions.smoothed(LOW_PASS_CUTOFF)
    report = [_prediction_section(predictions, smooth)]
    if any(_relevant_residuals(each) for each in predictions.channels):
        report.append(_spectrum_section(predictions))
    if predictions.unexplained_torque is not None:
        report.append(_friction_section(predictions, predictions.unexplained_torque))
        if predictions.run.drives is not None:
            report.append(drive_section(predictions.run.drives))
    if predictions.run.consistent is not None:
        report.append(bodies_section(predictions.run.consistent))
    return report


def _relevant_residuals(channel: Channel) -> dict[Signal, Array]:
    """Residuals `measured - predicted` of a channel, keyed by method, (M,) each [N or N m].

    The joint torques predicted from the plate contain no friction. The residual of this prediction
    is left out for a torque that is also predicted from joint torques.
    """
    residuals = channel.residuals
    if channel.kind == "torque" and "torque" in residuals:
        residuals.pop("wrench", None)
    return residuals


def _prediction_section(predictions: Predictions, smooth: Predictions) -> Section:
    """Section with measured and predicted signals and residuals, one panel per channel.

    The table contains the rms residuals and, for a held-out recording, their expected size.

    Args:
        predictions: Predictions from the estimates of a run, with the run's validation.
        smooth: The low-pass filtered predictions, for plots and rms values.
    """
    names = {
        method: predictions.run.instruments[method]
        for method in predictions.run.estimates
    }
    duration = float(np.ptp(smooth.motion.t))
    motion = (
        "a held-out motion" if predictions.unseen else "the motion used for the fit"
    )
    explanation = ["Measured signals (grey) and predictions; residuals below."]
    if "wrench" in names:
        plate = names["wrench"]
        explanation.append(
            f"The {plate}'s estimate contains no friction: its joint torques are those of a robot "
            "without friction. Parameters that joint torques cannot identify are taken from the "
            f"{plate}'s estimate."
        )
    if _validated_methods(predictions):
        explanation.append(
            "The expected residual includes noise and the standard deviation of the prediction; "
            "about 95 % of the samples should be in its band."
        )
    return Section(
        id="prediction",
        title=f"Measured and predicted, on {motion}",
        explanation=" ".join(explanation),
        legend={"measured": "measured"} | names,
        panels=[_signal_panel(smooth, each) for each in smooth.channels],
        shown=VISIBLE_CHANNELS,
        caption=(
            f"The first {min(PLOTTED_DURATION, duration):.3g} s, "
            f"low-pass {LOW_PASS_CUTOFF:g} Hz."
        ),
        table=_residual_table(predictions, smooth, names),
    )


def _signal_panel(predictions: Predictions, channel: Channel) -> Panel:
    """Panel of one channel, with the signals above and the relevant residuals below.

    The signals are the measured and the predicted ones. Only the first `PLOTTED_DURATION` seconds
    are drawn, with at most 1000 points per curve.
    """
    time = predictions.motion.t
    in_window = time <= time[0] + PLOTTED_DURATION
    above, below = (
        {
            kind: subsampled_curve(time[in_window], values[in_window])
            for kind, values in curves.items()
        }
        for curves in (channel.curves, _relevant_residuals(channel))
    )
    lower_plots = {f"residual [{channel.unit}]": below} if below else {}
    return Panel(
        f"{channel.name} [{channel.unit}]", above, "time [s]", lower_plots=lower_plots
    )


def _residual_table(
    predictions: Predictions, smooth: Predictions, names: Mapping[Signal, str]
) -> Table:
    """Table with one row per channel: standard deviation, rms residuals, and residual ratios.

    For each method, the columns are the rms residual, its ratio to the signal's standard deviation
    and, if validated, its ratio to the expected residual and the fraction of samples in the 95 %
    band.

    Args:
        predictions: Predictions with the run's validation.
        smooth: The low-pass filtered predictions, for the rms values.
        names: Names of the instruments, keyed by method.
    """
    heads = ["channel", "unit", "spread (rms)"]
    heads += [f"residual rms, {name}" for name in names.values()]
    heads += [f"of spread, {name}" for name in names.values()]
    for method in _validated_methods(predictions):
        heads += [f"of expected residual, {names[method]}", f"in band, {names[method]}"]
    rows = [
        _residual_row(predictions.run, channel) + _ratio_cells(predictions, channel)
        for channel in smooth.channels
    ]
    return Table(heads, rows)


def _residual_row(run: Run, channel: Channel) -> list[str]:
    """Table row of a channel: name, unit, standard deviation, rms and relative residuals.

    There is one residual per method; relative residuals are divided by the standard deviation of
    the measured signal. A cell is "" if the method does not predict the channel, and a relative
    residual is "" if the channel is constant.
    """
    spread = float(channel.measured.std())
    rms_residuals = {
        method: float(np.sqrt(np.mean(residual**2)))
        for method, residual in channel.residuals.items()
    }
    shares = {
        method: percent_text(rms / spread)
        for method, rms in rms_residuals.items()
        if spread
    }
    return [
        channel.name,
        channel.unit,
        f"{spread:.3g}",
        *(
            f"{rms_residuals[method]:.3g}" if method in rms_residuals else ""
            for method in run.estimates
        ),
        *(shares.get(method, "") for method in run.estimates),
    ]


def _validated_methods(predictions: Predictions) -> list[Signal]:
    """Methods validated on the held-out recording.

    The result is empty if the predictions are for the recording of the fit.
    """
    return list(predictions.run.validation) if predictions.unseen else []


def _ratio_cells(predictions: Predictions, channel: Channel) -> list[str]:
    """Table cells with the residual ratio and the fraction of samples in the band.

    The residual ratio is the residual divided by the expected residual. There are two cells per
    validated method. They are "" for channels of the other signal, and for channels without rows in
    use.
    """
    cells: list[str] = []
    for method in _validated_methods(predictions):
        validation, c = predictions.run.validation[method], channel.index
        is_measured = method == channel.kind
        has_rows = bool(is_measured and validation.rows[c])
        cells += [
            f"{validation.ratio[c]:.3g}" if has_rows else "",
            f"{validation.within[c]:.0%}" if has_rows else "",
        ]
    return cells


def _spectrum_section(predictions: Predictions) -> Section:
    """Section with the amplitude spectral densities of the relevant residuals of each channel.

    The table contains the rms residuals below and above `MOTION_BANDWIDTH`.
    """
    rate, names = predictions.recording.rate, predictions.run.instruments
    panels, rows = [], []
    for channel in predictions.channels:
        name, unit = channel.name, channel.unit
        spectra = {
            method: spectrum(residual, rate)
            for method, residual in _relevant_residuals(channel).items()
        }
        panels.append(
            Panel(f"{name} [{unit}/√Hz]", spectra, "frequency [Hz]", log_scale=True)
        )
        for method, residual_spectrum in spectra.items():
            motion_rms, noise_rms = (
                rms_within(*residual_spectrum, 0.0, MOTION_BANDWIDTH),
                rms_within(*residual_spectrum, MOTION_BANDWIDTH, np.inf),
            )
            rows.append(
                [name, unit, names[method], f"{motion_rms:.3g}", f"{noise_rms:.3g}"]
            )
    return Section(
        id="spectra",
        title="Residual spectra",
        explanation=(
            "Amplitude spectral density of the residuals. White sensor noise is flat; encoder "
            "noise rises up to the cutoff of the position filter. Peaks at the frequencies of the "
            "motion are effects of the robot or its friction that the model does not contain."
        ),
        legend={method: names[method] for method in predictions.run.estimates},
        panels=panels,
        shown=VISIBLE_PANELS,
        caption=f"Welch's method, segments of at most {MAX_SEGMENT_SAMPLES} samples.",
        table=Table(
            [
                "channel",
                "unit",
                "estimate",
                f"rms below {MOTION_BANDWIDTH:g} Hz",
                f"rms above {MOTION_BANDWIDTH:g} Hz",
            ],
            rows,
        ),
    )


def _friction_section(predictions: Predictions, torque: Array) -> Section:
    """Section with unexplained torque and identified friction over velocity for each joint.

    The table contains the joint terms identified from joint torques, with the truth if known.

    Args:
        predictions: Predictions.
        torque: Difference of motor torque and rigid-body torque, (M, n) [N m or N].
    """
    run = predictions.run
    panels = [_friction_panel(predictions, j, torque[:, j]) for j in range(run.tree.n)]
    legend = {"measured": "unexplained torque"}
    caption = ["Points are samples."]
    if any("torque" in panel.curves for panel in panels):
        legend["torque"] = "friction identified from joint torques"
        caption.append(
            "That from joint torques is the friction model at constant velocity."
        )
    if run.drives is not None:
        legend["wrench"] = "friction curve from the force plate"
        caption.append(
            f"The curve from the force plate assumes no friction model; its band is "
            f"{BAND_SIGMAS:g} standard deviations to either side."
        )
    return Section(
        id="friction",
        title="Friction",
        explanation=(
            "Measured motor torque minus the rigid-body torque of the force plate's estimate, "
            "over velocity: friction, and errors of the reported torque."
        ),
        legend=legend,
        panels=panels,
        shown=VISIBLE_PANELS,
        caption=" ".join(caption),
        table=Table(["joint", "term", "unit", "estimate", "truth"], _term_rows(run)),
    )


def _friction_panel(predictions: Predictions, j: int, torque: Array) -> Panel:
    """Panel of one joint: unexplained torque and identified friction over velocity.

    The points are samples. The lines, if identified, are the friction at constant velocity from the
    joint terms, and the friction curve from the plate with a band of `BAND_SIGMAS` standard
    deviations.

    Args:
        predictions: Predictions.
        j: Index of the joint.
        torque: Difference of motor torque and rigid-body torque, (M,) [N m or N].
    """
    tree, drives = predictions.run.tree, predictions.run.drives
    speed_unit, unit = ("rad/s", "N m") if tree.joints[j].revolute else ("m/s", "N")
    speed = predictions.motion.qd[:, j]
    curves = {"measured": subsampled_curve(speed, torque)}
    grid = np.zeros((201, tree.n))
    grid[:, j] = np.linspace(-1, 1, 201) * np.abs(speed).max(initial=1e-9)
    model = predictions.friction(grid)
    if model is not None:
        curves["torque"] = grid[:, j], model[:, j]
    bands = {}
    if drives is not None:
        nodes, friction, sigma = curve_lines(drives.curves[j])
        curves["wrench"], bands["wrench"] = (nodes, friction), BAND_SIGMAS * sigma
    title, x_label = f"{tree.joints[j].name} [{unit}]", f"velocity [{speed_unit}]"
    return Panel(title, curves, x_label, points=("measured",), bands=bands)


def _term_rows(run: Run) -> list[list[str]]:
    """Table rows of the joint terms identified from joint torques, joint by joint.

    A row contains joint, kind, unit, value with sigma, and the truth, or "" if unknown. Terms of
    motor shafts come last.
    """
    estimate = run.estimates.get("torque")
    terms = () if estimate is None else estimate.joint_terms
    order = [*run.tree.names, *(term.joint for term in terms)]
    return [
        [
            term.joint,
            term.kind,
            term.unit,
            f"{term.value:.4g} +- {term.sigma:.2g}",
            f"{run.truths[term.name]:.4g}" if term.name in run.truths else "",
        ]
        for term in sorted(terms, key=lambda term: order.index(term.joint))
    ]


def spectrum(signal: Array, rate: float) -> tuple[Array, Array]:
    """One-sided amplitude spectral density of a signal, by Welch's method.

    Segments have at most `MAX_SEGMENT_SAMPLES` samples. The value at frequency zero is omitted.

    Args:
        signal: Signal, (M,).
        rate: Sampling rate [Hz].

    Returns:
        Frequencies [Hz] and densities [unit/sqrt(Hz)].
    """
    frequency, power = welch(
        signal, rate, nperseg=min(MAX_SEGMENT_SAMPLES, len(signal))
    )
    return frequency[1:], np.sqrt(power[1:])


def rms_within(frequency: Array, density: Array, low: float, high: float) -> float:
    """Rms of the components of a signal between two frequencies [unit].

    Args:
        frequency: Evenly spaced frequencies [Hz].
        density: Amplitude spectral density [unit/sqrt(Hz)].
        low: Lower limit, included [Hz].
        high: Upper limit, excluded [Hz].
    """
    in_band = (frequency >= low) & (frequency < high)
    step = float(frequency[1] - frequency[0]) if len(frequency) > 1 else 0.0
    return float(np.sqrt(np.sum(density[in_band] ** 2) * step))
