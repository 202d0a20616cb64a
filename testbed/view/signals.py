"""A report's figures, each with what it says and the same as a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import METHODS, SIGNAL_OF, Method
from testbed.lab.experiment.predict import Predictions, Signal
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.summary import percent
from testbed.view.bodies import bodies_section
from testbed.view.drives import BAND, curve_lines, drive_section
from testbed.view.figures import Panel, thinned
from testbed.view.section import Section, Table

SEGMENT = 2048
"""Most samples of a segment; halves overlap, Hann's window, means taken off."""
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
    if any(_methods_of(signal) for signal in found.signals):
        shown.append(_spectra(found))
    if found.unexplained_torque is not None:
        shown.append(_friction(found, smooth))
        if found.run.drives is not None:
            seconds = seconds_shown(found.motion.t)
            shown.append(drive_section(smooth, found.run.drives, CUTOFF, seconds))
    if found.run.consistent is not None:
        shown.append(bodies_section(found.run, found.run.consistent))
    return shown


def _methods_of(signal: Signal) -> list[Method]:
    """The methods whose residual says something: joint torques of the external lack friction."""
    lacking = "external" if signal.kind == "torque" and "internal" in signal.predicted else None
    return [method for method in signal.predicted if method != lacking]


def _channels(found: Predictions) -> list[tuple[Signal, int]]:
    """Every channel: its signal and its place there."""
    return [(signal, c) for signal in found.signals for c in range(len(signal.channels))]


def seconds_shown(time: Array) -> float:
    """How much of a recording its figures show [s].

    Args:
        time: Of the samples, (K,) [s].
    """
    return min(SHOWN, float(time[-1] - time[0]))


def _measured(found: Predictions, smooth: Predictions) -> Section:
    time = smooth.motion.t
    shown = time <= time[0] + SHOWN
    panels, rows = [], []
    for signal, c in _channels(smooth):
        name, unit = signal.channels[c], signal.units[c]
        lines: dict[str, Array] = {"measured": signal.measured[:, c]}
        lines |= {m: signal.predicted[m][:, c] for m in reversed(METHODS) if m in signal.predicted}
        rest: dict[str, Array] = {m: signal.residual(m)[:, c] for m in _methods_of(signal)}
        above, below = (
            {label: thinned(time[shown], line[shown]) for label, line in curves.items()}
            for curves in (lines, rest)
        )
        parts = {f"residual [{unit}]": below} if below else {}
        panels.append(Panel(f"{name} [{unit}]", above, "time [s]", below=parts))
        rows.append(
            [name, unit, *_residual_cells(smooth, signal, c), *_ratio_cells(found, signal, c)]
        )
    seen = "the motion used for the fit"
    motion = "a held-out motion" if found.unseen else seen
    methods, names = list(found.run.estimates), found.run.instruments
    return Section(
id="prediction",
title=f"Measured and predicted, on {motion}",
says=("Measured signals (grey) and predictions; residuals below."
        + (
            f" The {names['external']}'s estimate contains no friction: its joint torques are "
            "those of a robot without friction. Parameters that joint torques cannot identify are "
            f"taken from the {names['external']}'s estimate."
            if "external" in methods
            else ""
        )
        + (
            " The expected residual includes noise and the standard deviation of the prediction."
            if _validated(found)
            else ""
        )),
legend={"measured": "measured"} | {m: names[m] for m in methods},
panels=panels,
shown=SHOWN_CHANNELS,
caption=f"The first {seconds_shown(time):.3g} s, low-pass {CUTOFF:g} Hz.",
table=Table([
            "channel", "unit", "spread (rms)",
            *(f"residual rms, {names[method]}" for method in methods),
            *(f"of spread, {names[method]}" for method in methods),
            *(f"of expected residual, {names[method]}" for method in _validated(found)),
        ], rows),
)  # fmt: skip


def _residual_cells(found: Predictions, signal: Signal, c: int) -> list[str]:
    """Spread of a channel, residuals, and these as part of the spread; "" for what there is not."""
    spread = float(signal.measured[:, c].std())
    sizes, shares = [], []
    for method in found.run.estimates:
        if method in signal.predicted:
            size = float(np.sqrt(np.mean(signal.residual(method)[:, c] ** 2)))
            sizes.append(f"{size:.3g}")
            shares.append(percent(size / spread) if spread else "")
        else:
            sizes.append("")
            shares.append("")
    return [f"{spread:.3g}", *sizes, *shares]


def _validated(found: Predictions) -> list[Method]:
    """Methods whose residuals on this motion are known in units of their noise."""
    return list(found.run.validation) if found.unseen else []


def _ratio_cells(found: Predictions, signal: Signal, c: int) -> list[str]:
    """Residuals over what noise and sigma allow; "" for what there is not."""
    cells = []
    for method in _validated(found):
        validation = found.run.validation[method]
        own = SIGNAL_OF[method] == signal.kind
        cells.append(f"{validation.ratio[c]:.3g}" if own and validation.rows[c] else "")
    return cells


def _spectra(found: Predictions) -> Section:
    rate = found.recording.rate
    panels, rows, weights = [], [], []
    for signal, c in _channels(found):
        name, unit, methods = signal.channels[c], signal.units[c], _methods_of(signal)
        spectra: dict[str, tuple[Array, Array]] = {
            m: spectrum(signal.residual(m)[:, c], rate) for m in methods
        }
        panels.append(Panel(f"{name} [{unit}/√Hz]", spectra, "frequency [Hz]", log=True))
        sizes = {
            m: (rms_within(*spectra[m], 0.0, SLOW), rms_within(*spectra[m], SLOW, np.inf))
            for m in methods
        }
        named = found.run.instruments
        rows += [[name, unit, named[m], *(f"{size:.3g}" for size in sizes[m])] for m in methods]
        weights.append(max((slow / fast for slow, fast in sizes.values() if fast), default=0.0))
    return Section(
id="spectra",
title="Residual spectra",
says=("Amplitude spectral density of the residuals. White sensor noise is flat; encoder "
        "noise rises up to the cutoff of the position filter. Peaks at the frequencies of the "
        "motion are effects of the robot or its friction that the model does not contain."),
legend={method: found.run.instruments[method] for method in found.run.estimates},
panels=telling_first(panels, weights),
shown=SHOWN_OTHERS,
caption=f"Welch's method, segments of at most 2048 samples; {_ordered(panels)}",
table=Table([
            "channel", "unit", "estimate", f"rms below {SLOW:g} Hz", f"rms above {SLOW:g} Hz",
        ], rows),
)  # fmt: skip


def telling_first(panels: Sequence[Panel], weights: Sequence[float]) -> list[Panel]:
    """Plots, those that say most first where some are to be folded away.

    Args:
        panels: In their own order.
        weights: How much each says.
    """
    if len(panels) <= SHOWN_OTHERS:
        return list(panels)
    return [panels[k] for k in np.argsort(-np.asarray(weights), kind="stable")]


def _ordered(panels: Sequence[Panel]) -> str:
    if len(panels) <= SHOWN_OTHERS:
        return "one plot a channel."
    return f"sorted by the share below {SLOW:g} Hz."


def _friction(found: Predictions, smooth: Predictions) -> Section:
    rest, run = found.unexplained_torque, found.run
    assert rest is not None  # the caller has looked
    panels = []
    for j, joint in enumerate(run.tree.joints):
        units = ("rad/s", "N m") if joint.revolute else ("m/s", "N")
        speed = found.motion.qd[:, j]
        curves = {"unexplained": thinned(speed, rest[:, j], 2000)}
        grid = np.zeros((201, run.tree.n))
        grid[:, j] = np.linspace(-1, 1, 201) * np.abs(speed).max(initial=1e-9)
        model = found.friction(grid)
        if model is not None:
            curves["internal"] = grid[:, j], model[:, j]
        bands = {}
        if run.drives is not None:
            nodes, torque, sigma = curve_lines(run.drives.curves[j])
            curves["external"], bands["external"] = (nodes, torque), BAND * sigma
        title, x = f"{joint.name} [{units[1]}]", f"velocity [{units[0]}]"
        panels.append(Panel(title, curves, x, points=("unexplained",), bands=bands))
    modelled = any("internal" in panel.curves for panel in panels)
    return Section(
        id="friction",
        title="Friction",
        says=(
            "Measured motor torque minus the rigid-body torque of the force plate's estimate, "
            "over velocity: friction, and errors of the reported torque."
            + (" The line is the friction identified from joint torques." if modelled else "")
        ),
        legend={"unexplained": "unexplained torque"}
        | ({"internal": "friction from joint torques"} if modelled else {})
        | ({} if run.drives is None else {"external": "friction curve from the force plate"}),
        panels=telling_first(panels, clear_shares(rest, smooth)),
        shown=SHOWN_OTHERS,
        caption=_friction_caption(len(panels), modelled=modelled, curves=run.drives is not None),
        table=Table(["joint", "term", "unit", "estimate", "truth"], _term_rows(run)),
    )


def clear_shares(rest: Array, smooth: Predictions) -> list[float]:
    """How much of each joint's unexplained torque is no noise.

    Args:
        rest: The unexplained torque, (M, n) [N m or N].
        smooth: Predictions through a low-pass.
    """
    clear = smooth.unexplained_torque
    assert clear is not None  # the caller has looked
    shares: list[float] = (clear.std(axis=0) / np.maximum(rest.std(axis=0), 1e-12)).tolist()
    return shares


def _friction_caption(count: int, *, modelled: bool, curves: bool) -> str:
    said = ["Points are samples."]
    if modelled:
        said.append("The line is the friction model at constant velocity.")
    if curves:
        said.append(
            f"The curve from the force plate assumes no friction model; its band is "
            f"{BAND:g} standard deviations to either side."
        )
    if count > SHOWN_OTHERS:
        said.append("Sorted by signal over noise.")
    return " ".join(said)


def _term_rows(run: Run) -> list[list[str]]:
    """What the internal estimate found of each joint's own torque, joint by joint."""
    internal = run.estimates.get("internal")
    terms = () if internal is None else internal.joint_terms
    rows = []
    for joint in dict.fromkeys((*run.tree.names, *(term.joint for term in terms))):
        for term in terms:
            if term.joint == joint:
                truth = run.truths.get(term.name)
                found = f"{term.value:.4g} +- {term.sigma:.2g}"
                true = "" if truth is None else f"{truth:.4g}"
                rows.append([joint, term.kind, term.unit, found, true])
    return rows


def spectrum(signal: Array, rate: float) -> tuple[Array, Array]:
    """Amplitude density of a signal over frequency [Hz], [unit/sqrt(Hz)]: Welch's means.

    The square's integral over frequency is the signal's variance.

    Args:
        signal: (M,).
        rate: Samples a second [Hz].
    """
    size = min(SEGMENT, len(signal))
    parts = sliding_window_view(signal, size)[:: size - size // 2]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size)
    lines = np.fft.rfft(window * (parts - parts.mean(axis=1, keepdims=True)))
    power = 2 * (np.abs(lines) ** 2).mean(axis=0) / (rate * (window @ window))
    if size % 2 == 0:
        power[-1] /= 2  # half the sampling rate stands for itself alone
    return np.asarray(np.fft.rfftfreq(size, 1 / rate)[1:]), np.asarray(np.sqrt(power[1:]))


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
