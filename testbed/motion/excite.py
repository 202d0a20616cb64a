"""The most informative motion beside a random one: designed, proven, its precision predicted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import encode
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.core.base.errors import few
from testbed.core.base.stages import unreported
from testbed.core.robot.tree import Tree
from testbed.motion.design import Design, DesignProblem, Watch, design
from testbed.motion.fourier import Fourier
from testbed.motion.information import Prediction, predict
from testbed.motion.proof import Rules


@dataclass(frozen=True, eq=False)
class Excitation(Diagnosed):
    """A designed motion, its predicted precision, and that of a random motion.

    Attributes:
        problem: Limits, unknowns and instruments that the motion is designed for.
        design: The motion and its proof.
        predicted: Standard deviations of the parameters by that motion.
        random: The same by a random motion; None where there is none.
        candidates: Number of random motions of which that one is the best.
    """

    problem: DesignProblem
    design: Design
    predicted: Prediction
    random: Prediction | None = None
    candidates: int = 1

    @property
    def rules(self) -> Rules:
        """Limits that the motion respects."""
        return self.problem.rules

    @property
    def tree(self) -> Tree:
        """The robot."""
        return self.rules.tree

    def document(self) -> dict[str, Any]:
        """The motion, its proof and both predictions as plain tables, for JSON."""
        motion = self.design.motion
        return {
            "fundamental": motion.fundamental,
            "harmonics": motion.harmonics,
            "criterion": self.problem.information.criterion,
            "value": self.design.value,
            "complete": self.design.complete,
            "searches": self.design.searches,
            "predicted": encode(self.predicted),
            "random": None if self.random is None else encode(self.random),
            "gain": self.gain,
            "diagnostics": encode(self.diagnostics),
            "proof": encode(self.design.proof),
        }

    @property
    def gain(self) -> float | None:
        """Rms relative sigma of the random motion over that of the designed one.

        None where there is no random motion, or one that does not identify all parameters.
        """
        if self.random is None or not np.isfinite(self.random.rms):
            return None
        return self.random.rms / self.predicted.rms

    @property
    def beside_random(self) -> str:
        """The gain in words."""
        origin = f"the best of {self.candidates} random motions"
        if self.random is None:
            return "no random motion within the limits was found for comparison"
        if self.gain is None:
            return f"{origin} does not identify all parameters"
        return f"{self.gain:.2f} times smaller than that of {origin} ({self.random.rms:.2%})"

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Parameters that the motion hardly excites."""
        names, relative = np.array(self.predicted.names), self.predicted.relative
        poor = names[relative > 1].tolist()
        return (diagnose("motion.uncertain", few(poor)),) if poor else ()


def excite(
    problem: DesignProblem,
    random: Fourier | None = None,
    candidates: int = 1,
    watch: Watch = unreported,
    interrupted: Callable[[], bool] = lambda: False,
) -> Excitation:
    """Design a motion, and predict its precision beside that of a random one.

    Args:
        problem: Limits, unknowns and instruments.
        random: A motion to compare with.
        candidates: Number of random motions of which that one is the best.
        watch: Called after every step of a search, with the relative sigma of the best.
        interrupted: Asked after every step whether to go on with the best so far.

    Raises:
        InfeasibleMotion: No motion inside the limits was found.
    """
    one_sample = np.sqrt(problem.pipeline.samples)

    def relative(done: int, total: int, best: float) -> None:
        watch(done, total, float(np.exp(best / 2) / one_sample))

    def forecast(motion: Fourier) -> Prediction:
        return predict(problem.information, problem.rows, motion, problem.pipeline)

    with one_blas_thread():
        found = design(problem, relative, interrupted)
        beside = None if random is None else forecast(random)
        return Excitation(problem, found, forecast(found.motion), beside, candidates)
