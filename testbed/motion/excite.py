"""Design of an excitation trajectory, with predicted precision compared to a random motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import to_json_values
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, make_diagnostic
from testbed.core.base.errors import shortened_list
from testbed.core.base.stages import ignore_progress
from testbed.core.robot.tree import Tree
from testbed.motion.design import Design, DesignProblem, SearchCallback, design
from testbed.motion.fourier import Fourier
from testbed.motion.information import Prediction, predict
from testbed.motion.proof import MotionConstraints


@dataclass(frozen=True, eq=False)
class Excitation(Diagnosed):
    """Designed motion with predicted precision, and a random motion for comparison.

    Attributes:
        problem: Limits, unknowns and instruments of the design.
        design: The motion and its proof.
        predicted: Standard deviations of the parameters with the designed motion.
        random: Standard deviations with a random motion; None for no random motion.
        candidates: Number of random motions from which the best was selected for comparison.
    """

    problem: DesignProblem
    design: Design
    predicted: Prediction
    random: Prediction | None = None
    candidates: int = 1

    @property
    def rules(self) -> MotionConstraints:
        """Limits of the motion."""
        return self.problem.rules

    @property
    def tree(self) -> Tree:
        """Robot of the design problem."""
        return self.rules.tree

    def json_values(self) -> dict[str, Any]:
        """Motion, proof and both predictions as values for JSON."""
        motion = self.design.motion
        return {
            "fundamental": motion.fundamental,
            "harmonics": motion.harmonics,
            "criterion": self.problem.information.criterion,
            "value": self.design.value,
            "complete": self.design.is_complete,
            "searches": self.design.searches,
            "predicted": to_json_values(self.predicted),
            "random": None if self.random is None else to_json_values(self.random),
            "gain": self.gain,
            "diagnostics": to_json_values(self.diagnostics),
            "proof": to_json_values(self.design.proof),
        }

    @property
    def gain(self) -> float | None:
        """Ratio of the rms relative sigmas of random motion and designed motion.

        The ratio is None without a random motion, or if the random motion does not identify all
        parameters.
        """
        if self.random is None or not np.isfinite(self.random.rms):
            return None
        return self.random.rms / self.predicted.rms

    @property
    def beside_random(self) -> str:
        """Phrase for reports that compares rms relative sigmas of designed and random motion."""
        origin = f"the best of {self.candidates} random motions"
        if self.random is None:
            return "no random motion within the limits was found for comparison"
        if self.gain is None:
            return f"{origin} does not identify all parameters"
        return f"{self.gain:.2f} times smaller than that of {origin} ({self.random.rms:.2%})"

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostic of parameters with a predicted relative sigma above one."""
        names, relative = np.array(self.predicted.names), self.predicted.relative
        uncertain = names[relative > 1].tolist()
        return (
            (make_diagnostic("motion.uncertain", shortened_list(uncertain)),)
            if uncertain
            else ()
        )


def excite(
    problem: DesignProblem,
    random: Fourier | None = None,
    candidates: int = 1,
    watch: SearchCallback = ignore_progress,
    interrupted: Callable[[], bool] = lambda: False,
) -> Excitation:
    """Design a motion, and predict standard deviations for this motion and a random motion.

    Args:
        problem: Limits, unknowns and instruments.
        random: Random motion for comparison; None for no comparison.
        candidates: Number of random motions from which `random` was selected as the best.
        watch: Callback after every step of a search; instead of the criterion, it receives the
            relative sigma of the best motion for the whole recording.
        interrupted: Callback after every step; True stops the design with the best motion so far.

    Raises:
        NoFeasibleMotion: No motion inside the limits was found.
    """
    one_sample = np.sqrt(problem.pipeline.samples)

    def report_relative_sigma(done: int, total: int, best: float) -> None:
        watch(done, total, float(np.exp(best / 2) / one_sample))

    def forecast(motion: Fourier) -> Prediction:
        return predict(problem.information, problem.rows, motion, problem.pipeline)

    with one_blas_thread():
        result = design(problem, report_relative_sigma, interrupted)
        random_prediction = None if random is None else forecast(random)
        return Excitation(
            problem, result, forecast(result.motion), random_prediction, candidates
        )
