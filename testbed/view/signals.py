"""A report's figures, each with what it says and the same as a table."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import welch

from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import SIGNAL_OF, Method
from testbed.lab.experiment.predict import Channel, Predictions
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.summary import percent
from testbed.view.bodies import bodies_section
from testbed.view.drives import BAND, curve_lines, drive_section
from testbed.view.figures import Panel, thinned
from testbed.view.section import Section, Table

SEGMENT = 2048
"""Most samples of a segment of a spectrum."""
SHOWN = 10.0
"""Seconds of a motion that are drawn."""
CUTOFF = 10.0
"""Of the low-pass on signals that are drawn [Hz]."""
SLOW = 5.0
"""Frequency below which the motion is, and above which noise [Hz]."""
SHOWN_CHANNELS, SHOWN_OTHERS = 6, 3
"""Plots of the signals, and of other figures, that are not folded away."""


def sections(found: Predictions) -> list[Section]:
    """The figures that there are: measured against predicted, residuals' spectra, friction, bodies.

    Args:
        found: Predictions for the unseen recording, or for the one that was identified.
    """
    smooth = found.smoothed(CUTOFF)
    shown = [_measured(found, smooth)]
    if any(_shown_residuals(each) for each in found.channels):
        shown.append(_spectra(found))
    if found.unexplained_torque is not None:
        shown.append(_friction(found, found.unexplained_torque))
        if found.run.drives is not None:
            shown.append(drive_section(found.run.drives))
    if found.run.consistent is not None:
        shown.append(bodies_section(found.run.consistent))
    return shown


def _shown_residuals(channel: Channel) -> dict[Method, Array]:
    """Residuals that say something: joint torques of the external estimate lack friction."""
    residuals = channel.residuals
    if channel.kind == "torque" and "internal" in residuals:
        residuals.pop("external", None)
    return residuals


def _measured(found: Predictions, smooth: Predictions) -> Section:
    names = {method: found.run.instruments[method] for method in found.run.estimates}
    duration = float(np.ptp(smooth.motion.t))
    motion = "a held-out motion" if found.unseen else "the motion used for the fit"
    says = ["Measured signals (grey) and predictions; residuals below."]
    if "external" in names:
        plate = names["external"]
        says.append(
            f"The {plate}'s estimate contains no friction: its joint torques are those of a robot "
            "without friction. Parameters that joint torques cannot identify are taken from the "
            f"{plate}'s estimate."
        )
    if _validated(found):
        says.append(
            "The expected residual includes noise and the standard deviation of the prediction; "
            "about 95 % of the samples should be in its band."
        )
    return Section(
        id="prediction",
        title=f"Measured and predicted, on {motion}",
        says=" ".join(says),
        legend={"measured": "measured"} | names,
        panels=[_signal_panel(smooth, each) for each in smooth.channels],
        shown=SHOWN_CHANNELS,
        caption=f"The first {min(SHOWN, duration):.3g} s, low-pass {CUTOFF:g} Hz.",
        table=_residual_table(found, smooth, names),
    )


def _signal_panel(found: Predictions, channel: Channel) -> Panel:
    """One channel, measured and predicted, with its residuals below."""
    time = found.motion.t
    shown = time <= time[0] + SHOWN
    above, below = (
        {kind: thinned(time[shown], values[shown]) for kind, values in curves.items()}
        for curves in (channel.curves, _shown_residuals(channel))
    )
    parts = {f"residual [{channel.unit}]": below} if below else {}
    return Panel(f"{channel.name} [{channel.unit}]", above, "time [s]", below=parts)


def _residual_table(
    found: Predictions, smooth: Predictions, names: Mapping[Method, str]
) -> Table:
    """Spread and residuals of all channels."""
    heads = ["channel", "unit", "spread (rms)"]
    heads += [f"residual rms, {name}" for name in names.values()]
    heads += [f"of spread, {name}" for name in names.values()]
    for method in _validated(found):
        heads += [f"of expected residual, {names[method]}", f"in band, {names[method]}"]
    rows = [
        _residual_row(found.run, channel) + _ratio_cells(found, channel)
        for channel in smooth.channels
    ]
    return Table(heads, rows)


def _residual_row(run: Run, channel: Channel) -> list[str]:
    """Spread of a channel, residuals, and these as part of the spread; "" for what there is not."""
    spread = float(channel.measured.std())
    sizes = {
        by: float(np.sqrt(np.mean(left**2))) for by, left in channel.residuals.items()
    }
    shares = {by: percent(size / spread) for by, size in sizes.items() if spread}
    return [
        channel.name,
        channel.unit,
        f"{spread:.3g}",
        *(f"{sizes[by]:.3g}" if by in sizes else "" for by in run.estimates),
        *(shares.get(by, "") for by in run.estimates),
    ]


def _validated(found: Predictions) -> list[Method]:
    """Methods whose residuals on this motion are known in units of their noise."""
    return list(found.run.validation) if found.unseen else []


def _ratio_cells(found: Predictions, channel: Channel) -> list[str]:
    """Residuals over what noise and sigma allow, part in the band; "" for what there is not."""
    cells: list[str] = []
    for method in _validated(found):
        validation, c = found.run.validation[method], channel.index
        own = SIGNAL_OF[method] == channel.kind
        known = bool(own and validation.rows[c])
        cells += [
            f"{validation.ratio[c]:.3g}" if known else "",
            f"{validation.within[c]:.0%}" if known else "",
        ]
    return cells


def _spectra(found: Predictions) -> Section:
    rate, names = found.recording.rate, found.run.instruments
    panels, rows = [], []
    for channel in found.channels:
        name, unit = channel.name, channel.unit
        spectra = {
            by: spectrum(left, rate) for by, left in _shown_residuals(channel).items()
        }
        panels.append(
            Panel(f"{name} [{unit}/√Hz]", spectra, "frequency [Hz]", log=True)
        )
        for method, each in spectra.items():
            slow, fast = rms_within(*each, 0.0, SLOW), rms_within(*each, SLOW, np.inf)
            rows.append([name, unit, names[method], f"{slow:.3g}", f"{fast:.3g}"])
    return Section(
        id="spectra",
        title="Residual spectra",
        says=(
            "Amplitude spectral density of the residuals. White sensor noise is flat; encoder "
            "noise rises up to the cutoff of the position filter. Peaks at the frequencies of the "
            "motion are effects of the robot or its friction that the model does not contain."
        ),
        legend={method: names[method] for method in found.run.estimates},
        panels=panels,
        shown=SHOWN_OTHERS,
        caption=f"Welch's method, segments of at most {SEGMENT} samples.",
        table=Table(
            [
                "channel",
                "unit",
                "estimate",
                f"rms below {SLOW:g} Hz",
                f"rms above {SLOW:g} Hz",
            ],
            rows,
        ),
    )


def _friction(found: Predictions, torque: Array) -> Section:
    """Friction over velocity.

    Args:
        found: Predictions.
        torque: That no rigid body explains, (M, n) [N m or N].
    """
    run = found.run
    panels = [_friction_panel(found, j, torque[:, j]) for j in range(run.tree.n)]
    legend = {"measured": "unexplained torque"}
    caption = ["Points are samples."]
    if any("internal" in panel.curves for panel in panels):
        legend["internal"] = "friction identified from joint torques"
        caption.append(
            "That from joint torques is the friction model at constant velocity."
        )
    if run.drives is not None:
        legend["external"] = "friction curve from the force plate"
        caption.append(
            f"The curve from the force plate assumes no friction model; its band is "
            f"{BAND:g} standard deviations to either side."
        )
    return Section(
        id="friction",
        title="Friction",
        says=(
            "Measured motor torque minus the rigid-body torque of the force plate's estimate, "
            "over velocity: friction, and errors of the reported torque."
        ),
        legend=legend,
        panels=panels,
        shown=SHOWN_OTHERS,
        caption=" ".join(caption),
        table=Table(["joint", "term", "unit", "estimate", "truth"], _term_rows(run)),
    )


def _friction_panel(found: Predictions, j: int, torque: Array) -> Panel:
    """Unexplained torque, (M,) [N m or N], and the friction identified of one joint."""
    tree, drives = found.run.tree, found.run.drives
    speed_unit, unit = ("rad/s", "N m") if tree.joints[j].revolute else ("m/s", "N")
    speed = found.motion.qd[:, j]
    curves = {"measured": thinned(speed, torque)}
    grid = np.zeros((201, tree.n))
    grid[:, j] = np.linspace(-1, 1, 201) * np.abs(speed).max(initial=1e-9)
    model = found.friction(grid)
    if model is not None:
        curves["internal"] = grid[:, j], model[:, j]
    bands = {}
    if drives is not None:
        nodes, friction, sigma = curve_lines(drives.curves[j])
        curves["external"], bands["external"] = (nodes, friction), BAND * sigma
    title, x_label = f"{tree.joints[j].name} [{unit}]", f"velocity [{speed_unit}]"
    return Panel(title, curves, x_label, points=("measured",), bands=bands)


def _term_rows(run: Run) -> list[list[str]]:
    """Joint torques' terms, joint by joint."""
    internal = run.estimates.get("internal")
    terms = () if internal is None else internal.joint_terms
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
    """Amplitude density of a signal over frequency [Hz], [unit/sqrt(Hz)], by Welch's method.

    Args:
        signal: (M,).
        rate: Samples a second [Hz].
    """
    frequency, power = welch(signal, rate, nperseg=min(SEGMENT, len(signal)))
    return frequency[1:], np.sqrt(power[1:])


def rms_within(frequency: Array, density: Array, low: float, high: float) -> float:
    """Rms of the part of a signal between two frequencies [unit].

    Args:
        frequency: Evenly spaced [Hz].
        density: Amplitude density there [unit/sqrt(Hz)].
        low: Included [Hz].
        high: Not included [Hz].
    """
    part = (frequency >= low) & (frequency < high)
    step = float(frequency[1] - frequency[0]) if len(frequency) > 1 else 0.0
    return float(np.sqrt(np.sum(density[part] ** 2) * step))
