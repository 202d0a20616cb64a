"""The pictures of the pages that explain, made anew: `python -m docs.pictures.explained`.

Schemes are drawn; whatever looks like a measurement is one of the simulated robot.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

import testbed as tb
from docs.pictures.drawing import (
    CELL,
    HERE,
    LEFT,
    arrow,
    dot,
    error_dots,
    line,
    placed,
    save,
    square,
    table,
    turn,
    words,
)
from testbed.bodies.posterior import compute_posterior, corrected_row_parts
from testbed.bodies.prior import prior_of
from testbed.core.estimation.problem import Problem
from testbed.core.parameters.identifiability import (
    IDENTIFIABLE_ALONE,
    IDENTIFIABLE_IN_COMBINATION,
    identifiability,
)
from testbed.core.parameters.symbols import STANDARD_NAMES
from testbed.lab.instruments.chain import remeasured
from testbed.view.drawing import svg
from testbed.view.figures import Panel
from testbed.view.minimal_sets import IDENTIFIABILITY_GLYPHS

MODEL, EXPERIMENT = "models/puma562.xml", "experiments/table6.toml"
UR5 = "tests/golden/robots/ur5.urdf"
SIDE, FILLS = 21, (0.0, 0.3, 1.0)
"""Of a square [pixels]; how full it is: never, in combination, alone."""
BOLD = "font-weight: 600"
SMALL = "font-size: 12px"
METHODS = {"wrench": "force plate", "torque": "joint torques"}
WALL, SPRING = 0.05, 0.1
"""Of a barrier that keeps bodies possible, and of what keeps them near [kg]."""
PATIENT = {"maxiter": 8000, "maxfev": 8000, "adaptive": True}
TIMES = 40
"""Experiments that differ by their noise alone."""


def main() -> None:
    """All of them."""
    save_forces()
    save_augmented()
    save_same_forces()
    save_map()
    save_sensors()
    save_errors()
    save_overview()
    save_sigma()
    save_real_arm()


def save_forces() -> None:
    """Which forces act on the plate, and which only on the drives."""
    parts = []
    for x, title in ((150, "what joint torques contain"), (530, "what the plate measures")):
        parts.append(words(x, 24, title, "middle", BOLD))
        parts += [line((x - 110, 330, x + 110, 330), "ink", 8)]  # the plate
        parts += [line((x, 322, x, 220), "faint", 14), line((x, 220, x + 90, 140), "faint", 12)]
        parts += [line((x + 90, 140, x + 40, 70), "faint", 10)]
        parts += [dot(x, 220, 10, "ink"), dot(x + 90, 140, 9, "ink"), dot(x + 40, 70, 6, "faint")]
    for x, y in ((150, 220), (240, 140)):
        parts += [turn(x, y, 24, (110, 250), "torque"), turn(x, y, 24, (70, -70), "measured")]
    parts.append(words(118, 214, "motor", "end", SMALL, "torque"))
    parts.append(words(184, 238, "friction, rotor,", "start", SMALL, "faint"))
    parts.append(words(184, 254, "wrong constant", "start", SMALL, "faint"))
    for x, y in ((530, 220), (620, 140)):  # on one link and on the other: a pair that cancels
        parts += [turn(x, y, 24, (100, 250), "measured"), turn(x, y, 24, (80, -70), "measured")]
    parts.append(words(654, 136, "on one link and,", "start", SMALL, "faint"))
    parts.append(words(654, 152, "opposite, on the other:", "start", SMALL, "faint"))
    parts.append(words(654, 168, "they cancel", "start", SMALL, "faint"))
    parts.append(arrow(530, 322, 530, 254, "force", 4))
    parts.append(words(516, 262, "force", "end", SMALL, "force"))
    parts.append(arrow(590, 316, 634, 286, "moment", 4))
    parts.append(words(640, 296, "moment", "start", SMALL, "moment"))
    parts.append(words(150, 362, "bodies + friction + drives", "middle"))
    parts.append(words(530, 362, "bodies alone", "middle"))
    save("forces", 820, 380, parts, "Motor torques contain friction and drives; in the wrench of "
         "the plate these cancel, and only the bodies are left")  # fmt: skip


def save_augmented() -> None:
    """A body, what it carries, and its augmented body."""
    parts = [words(150, 24, "a robot of three bodies", "middle", BOLD)]
    parts.append(words(560, 24, "the augmented body 2", "middle", BOLD))
    joints = ((50, 300), (110, 180), (210, 130), (285, 70))
    for (x0, y0), (x1, y1), colour in zip(joints, joints[1:], ("measured", "wrench", "torque"),
                                          strict=False):  # fmt: skip
        parts.append(line((x0, y0, x1, y1), colour, 14))
    for k, (x, y) in enumerate(joints[:3], start=1):
        parts += [dot(x, y, 8, "ink"), words(x + 2, y + 30, f"joint {k}", "start", SMALL, "faint")]
    for x, y, k in ((70, 236, 1), (150, 145, 2), (236, 92, 3)):
        parts.append(words(x - 14, y - 8, f"body {k}", "end", SMALL))
    parts.append(line((10, 312, 90, 312), "ink", 6))
    parts.append(arrow(330, 180, 400, 180, "faint"))
    x0, y0, x1, y1 = 450, 230, 640, 135
    parts += [line((x0, y0, x1, y1), "wrench", 14), dot(x0, y0, 8, "ink")]
    parts.append(dot(x1, y1, 17, "torque"))
    parts.append(words(x1 + 26, y1 - 6, "all that joint 3 carries,"))
    parts.append(words(x1 + 26, y1 + 12, "as a point at joint 3"))
    parts.append(words(x0, y0 + 34, "joint 2", "middle", SMALL, "faint"))
    parts.append(words(560, 290, "mass, first moments and inertia about joint 2:", "middle"))
    parts.append(words(560, 312, "ten numbers that never change as the robot moves", "middle"))
    save("augmented", 830, 335, parts, "Body 2 with what it carries as a point mass at the "
         "joint that carries it: the augmented body")  # fmt: skip


def save_same_forces() -> None:
    """Two robots of other masses that no motion distinguishes."""
    tree = tb.load_tree(MODEL)
    other = indistinguishable(tree)
    sampled = fourier(tree)
    torque = [tb.joint_forces(each, sampled)[:, 1] for each in (tree, other)]
    wrench = [tb.base_wrench(each, sampled) for each in (tree, other)]
    assert np.allclose(*torque, rtol=0, atol=1e-9)
    assert np.allclose(*wrench, rtol=0, atol=1e-9)
    assert all(np.linalg.eigvalsh(body.pseudo).min() > 0 for body in other.inertias)
    parts = [words(20, 24, "Two robots: their second links", "start", BOLD)]
    rows = [tb.standard(each)[1] for each in (tree, other)]
    for k, (name, one, two) in enumerate(zip(STANDARD_NAMES, *rows, strict=True)):
        y = 56 + 22 * k
        parts.append(words(60, y, name, "end"))
        parts.append(words(160, y, f"{one:.3f}", "end", "", "faint"))
        parts.append(words(250, y, f"{two:.3f}", "end", "", "wrench"))
    parts.append(words(400, 24, "Torque of the shoulder on one motion [N m]", "start", BOLD))
    panel = Panel(
        "",
        {"measured": (sampled.t, torque[0]), "wrench": (sampled.t, torque[1])},
        "time [s]",
    )
    parts.append(placed(svg(panel), 300, 40, 500, 225))
    parts += [line((400, 284, 430, 284), "measured", 4), words(438, 289, "the first robot")]
    parts += [line((580, 284, 610, 284), "wrench", 2), words(618, 289, "the other one")]
    save("same_forces", 820, 310, parts, "Two robots whose second links have other masses, first "
         "moments and inertias, and whose shoulder torques are one curve")  # fmt: skip


def save_map() -> None:
    """Which parameters of the PUMA are identifiable, with known zeros."""
    tree = tb.load_tree(MODEL)
    parts: list[str] = []
    top = 24.0
    names = {"torques": "Joint torques", "bedplate": "Plate"}
    for seen in identifiability(tree, zeros=True)[:2]:
        rows = {
            name: [IDENTIFIABILITY_GLYPHS[k] for k in codes]
            for name, codes in zip(tree.names, seen.standard, strict=True)
        }
        title = f"{names[seen.instrument]}: {seen.count} base parameters"
        parts += table(top, title, STANDARD_NAMES, rows, 40)
        top += 26 + CELL * (tree.n + 1) + 12
    parts.append(
        words(8, top, "#: alone; +: in combination; ·: not identifiable", "start", "", "faint")
    )
    save("map", LEFT + 40 * len(STANDARD_NAMES) + 8, top + 14, parts, "Which of the ten parameters "
         "of each link are identifiable from joint torques and with the plate")  # fmt: skip


def save_sensors() -> None:
    """What four instruments identify of a UR5, a square a parameter."""
    wrist = tb.ForceSensor("b6")
    torques, plate = identifiability(tb.load_tree(UR5))[:2]
    tool = identifiability(tb.load_tree(UR5, sensor=wrist))[0]
    scaled = np.minimum(
        torques.standard, IDENTIFIABLE_IN_COMBINATION
    )  # constants are unknown: ratios only
    panels = (
        ("Force plate", f"{plate.count} base parameters", plate.standard),
        ("Force sensor at the wrist", f"all {tool.count} of what it carries", tool.standard),
        ("Joint torques", f"{torques.count} base parameters, friction", torques.standard),
        ("Motor currents", f"ratios of the {torques.count}, friction", scaled),
    )
    parts: list[str] = []
    for k, (title, label, seen) in enumerate(panels):
        x, y = 8 + SIDE * 13.5 * (k % 2), 24 + SIDE * 9.8 * (k // 2)
        parts += [words(x, y, title, "start", BOLD), words(x, y + 18, label, colour="faint")]
        for place, name in enumerate(STANDARD_NAMES):
            at = x + 20 + SIDE * (place + 0.45)
            parts.append(words(at, y + 38, name, "middle", "font-size: 10px", "faint"))
        for row, codes in enumerate(seen):
            level = y + 44 + SIDE * row
            parts.append(words(x + 4, level + 15, str(row + 1), "start", SMALL, "faint"))
            parts += [
                square(x + 20 + SIDE * place, level, SIDE - 3, FILLS[code])
                for place, code in enumerate(codes)
            ]
    y = 24 + SIDE * 19.6
    for x, code, label in (
        (8, IDENTIFIABLE_ALONE, "alone"),
        (90, IDENTIFIABLE_IN_COMBINATION, "in combination"),
        (230, 0, "never"),
    ):
        parts += [square(x, y - 13, SIDE - 5, FILLS[code]), words(x + 22, y, label, colour="faint")]
    save("sensors", SIDE * 27, y + 12, parts, "Which of the ten parameters of each link of a UR5 "
         "a force plate, a wrist sensor, joint torques and currents identify")  # fmt: skip


def fourier(tree: tb.Tree) -> tb.Motion:
    """Some motion of all joints, 4 s at 100 Hz."""
    time = np.arange(0, 4, 0.01)[:, None]
    rate = 2 * np.pi * np.array([0.5, 0.75, 1.0])[: tree.n]
    size = np.array([0.8, 0.6, 0.7])[: tree.n]
    return tb.Motion(
        time[:, 0],
        size * np.sin(rate * time),
        size * rate * np.cos(rate * time),
        -size * rate**2 * np.sin(rate * time),
    )


def indistinguishable(tree: tb.Tree) -> tb.Tree:
    """The same tree with other bodies of the same minimal parameters, by torques and plate.

    They can exist, too: the second link is light, while a barrier keeps pseudo-inertias positive
    and a spring the rest near what it was.
    """
    from scipy.optimize import minimize

    from testbed.core.parameters.symbols import forms_on_standard, with_standard_parameters

    seen = np.concatenate(
        [
            forms_on_standard(tree, tb.minimal_set(tree, model).matrix)
            for model in ("torque", "wrench")
        ]
    )
    blind = np.linalg.svd(seen)[2][np.linalg.matrix_rank(seen) :]
    own = tb.standard(tree).ravel()

    def other(step: np.ndarray) -> tb.Tree:
        return with_standard_parameters(tree, (own + step @ blind).reshape(tree.n, 10))

    def heavy(step: np.ndarray) -> float:
        bodies = [body.pseudo for body in other(step).inertias]
        if min(np.linalg.eigvalsh(body).min() for body in bodies) <= 0:
            return np.inf
        mass = (own + step @ blind)[10]
        wall = sum(np.linalg.slogdet(body)[1] for body in bodies)
        return mass - WALL * wall + SPRING * float(step @ step)

    found = minimize(heavy, np.zeros(len(blind)), method="Nelder-Mead", options=PATIENT)
    return other(found.x)


def short(more: list[str]) -> tb.Experiment:
    """The experiment of Table 6, made short."""
    return tb.Experiment.from_toml(EXPERIMENT, ["motion.candidates=10", *more])


def save_errors() -> None:
    """Table 6 by plate and by torques."""
    run = tb.carry_out(tb.Experiment.from_toml(EXPERIMENT))
    width, height, parts = error_dots(errors_of_run(run), METHODS)
    save("errors", width, height, parts, "Relative errors of the nine parameters that both "
         "identify: by the plate around 0.02 %, by joint torques around 7 %")  # fmt: skip


def save_overview() -> None:
    """The README's: the robot on its plate, and what each method makes of a minute."""
    files = ((HERE / f"{name}.svg").read_text() for name in ("gallery/puma", "errors"))
    robot, dots = (re.sub(r' width="\d+" height="\d+"', "", text, count=1) for text in files)
    robot = robot.replace('font-size="20"', 'font-size="27"')
    robot = robot.replace("viewBox=", 'overflow="visible" viewBox=')
    parts = [
        placed(robot, 0, 6, 290, 326),
        words(400, 26, "Errors of the base parameters that both methods identify", style=BOLD),
        words(400, 46, "60 s of motion; torque constants 4 to 8 % off", colour="faint"),
        placed(dots, 290, 60, 600, 272),
    ]
    save("overview", 890, 340, parts, "A robot on a force plate with its reaction, and relative "
         "errors of nine parameters: by the plate around 0.02 %, by joint torques around "
         "7 %")  # fmt: skip


def errors_of_run(run: Any) -> dict[str, dict[str, float]]:
    """Relative errors in percent of the inertial parameters, by parameter and method.

    Args:
        run: Judged.
    """
    found: dict[str, dict[str, float]] = {}
    for method, errors in run.score.errors.items():
        count = run.estimates[method].minimal.count
        for name, error in zip(errors.names[:count], errors.relative[:count], strict=True):
            if np.isfinite(error):
                found.setdefault(name, {})[method] = 100 * abs(float(error))
    both = {name: row for name, row in found.items() if len(row) == len(run.estimates)}
    return both or found


def save_sigma() -> None:
    """One parameter by experiments that differ by their noise alone, with intervals of 95 %."""
    experiment = short(["motion.duration=10"])
    clean = replace(experiment.measurement, encoder_noise=0.0, encoder_resolution=0.0,
                    force_noise=0.0, moment_noise=0.0, torque_noise=0.0)  # fmt: skip
    perfect = tb.record(experiment.model_copy(update={"measurement": clean}))
    tree = tb.load_tree(experiment.model)
    name = "K3yy"
    minimal = tb.minimal_set(tree, "wrench", zeros=True)
    truth = minimal.values(tb.barycentric(tree))[minimal.names.index(name)]
    noise = replace(clean, force_noise=0.5, moment_noise=0.1)
    found = []
    for seed in range(1, TIMES + 1):
        estimate = tb.identify(tree, remeasured(perfect, noise, seed), zeros=True)
        k = estimate.names.index(name)
        found.append((estimate.values[k], 1.96 * estimate.sigma[k]))
    low = min(v - s for v, s in found) - 2e-4
    scale = 230 / (max(v + s for v, s in found) + 2e-4 - low)
    parts, miss = [words(20, 24, f"{name} by {TIMES} experiments, each with its interval of 95 %",
                         "start", BOLD)], 0  # fmt: skip
    y = 290 - (truth - low) * scale
    parts += [line((70, y, 750, y), "truth", 2), words(755, y + 5, "truth", "start", "", "truth")]
    for k, (value, half) in enumerate(found):
        x, middle = 80 + 17 * k, 290 - (value - low) * scale
        holds = abs(value - truth) < half
        miss += not holds
        colour = "wrench" if holds else "torque"
        parts.append(line((x, middle - half * scale, x, middle + half * scale), colour, 2.5))
        parts.append(dot(x, middle, 4, colour))
    parts.append(words(20, 320, f"{TIMES - miss} of {TIMES} contain the true value."))
    for value in (truth - 1e-3, truth, truth + 1e-3):
        level = 290 - (value - low) * scale
        if 40 < level < 300:
            parts.append(words(64, level + 4, f"{value:.3f}", "end", SMALL, "faint"))
    save("sigma", 810, 335, parts, f"Forty estimates of {name} with their intervals of 95 % around "
         "the truth")  # fmt: skip


def save_real_arm() -> None:
    """The wrench of a real arm below 2 Hz: measured, by the model file, with the file as prior."""
    folder = HERE.parent.parent / "examples/ur5e_plate"
    recording = tb.import_recording(folder / "ur5e.toml")
    file, source, _ = tb.hold_still(tb.ModelFile(folder / "ur5e_arm.urdf"), recording)
    tree, settings = file.tree(), tb.Settings(cutoff=2.0)
    rows = corrected_row_parts(Problem.from_recording(tree, source, "wrench", settings), None)
    found = compute_posterior(rows, prior_of(tree))
    low = butter(4, 2.0 / (source.rate / 2), output="sos")
    part = source.part(0, source.samples).ordered(tree)
    q, measured = (
        sosfiltfilt(low, each, axis=0) for each in (part.position, part.measured("wrench"))
    )
    qd = np.gradient(q, 1 / source.rate, axis=0)
    motion = tb.Motion(part.time, q, qd, np.gradient(qd, 1 / source.rate, axis=0))
    minimal = tb.minimal_set(tree, "wrench")
    phi = tb.regressor(tree, motion, minimal)
    curves = {"measured": measured}
    for colour, values in (("torque", found.file), ("wrench", found.values)):
        wrench = phi @ values[: minimal.count]
        curves[colour] = wrench + (measured - wrench).mean(axis=0)  # the plate's zero
    parts = []
    labels = ("measured", "model file", "with the recording")
    for k, (colour, label) in enumerate(zip(curves, labels, strict=True)):
        parts.append(line((90 + 190 * k, 16, 120 + 190 * k, 16), colour, 3))
        parts.append(words(128 + 190 * k, 21, label))
    for row, (channel, name) in enumerate(((3, "Mx [N m]"), (4, "My [N m]"), (2, "Fz [N]"))):
        top, height = 40 + 150 * row, 120
        every = np.concatenate([each[:, channel] for each in curves.values()])
        least, most = float(every.min()), float(every.max())
        parts.append(words(8, top + 66, name))
        for value, y in ((most, top), (least, top + height)):
            parts.append(line((90, y, 690, y), "faint", 0.5))
            parts.append(words(84, y + 5, f"{value:.3g}", "end", SMALL, "faint"))
        x = 90 + 600 * (part.time - part.time[0]) / (part.time[-1] - part.time[0])
        for colour, each in curves.items():
            y = top + height * (most - each[:, channel]) / (most - least)
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[::6], y[::6], strict=True))
            parts.append(
                f'<polyline points="{points}" fill="none" stroke="var(--{colour})" '
                f'stroke-width="{3 if colour == "measured" else 1.6}"/>'
            )
    parts.append(words(390, 488, "18.5 s", "middle", SMALL, "faint"))
    save("real_arm", 720, 500, parts, "Moments and vertical force of a real UR5e: measured, by "
         "the model file, and by the model file with the recording")  # fmt: skip


if __name__ == "__main__":
    main()
