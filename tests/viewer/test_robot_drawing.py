"""What the viewer draws hangs on the body that it belongs to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from testbed.robot.visuals.appearance import Appearance
from testbed.robot.visuals.shapes import Shape
from testbed.viewer.robot_drawing import log_appearance, send_poses
from tests.helpers.runs import ROBOTS, robot


class Stream:
    """Keeps what is logged, by its place."""

    def __init__(self) -> None:
        self.logged: dict[str, Any] = {}
        self.moved: list[str] = []

    def log(self, entity: str, what: Any, *, static: bool) -> None:
        assert static
        self.logged[entity] = what

    def send_columns(self, entity: str, *, indexes: Any, columns: Any) -> None:
        del indexes, columns
        self.moved.append(entity)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_shape_moves_with_its_body(name: str) -> None:
    tree, stream = robot(name), Stream()
    grey = np.array([0.5, 0.5, 0.5, 1.0])
    shapes = tuple(
        Shape(j, "ellipsoid", np.full(3, 0.1 + j), np.zeros(3), np.eye(3), grey)
        for j in range(-1, tree.n)
    )
    look = Appearance(tree, shapes)
    log_appearance(stream, look, "world")  # type: ignore[arg-type]
    send_poses(stream, look, np.zeros(1), np.zeros((1, tree.n)), "world")  # type: ignore[arg-type]
    for k, shape in enumerate(shapes):
        home = "world/bedplate" if shape.body < 0 else stream.moved[shape.body]
        (radii,) = stream.logged[f"{home}/shape{k}"].half_sizes.as_arrow_array().to_pylist()
        np.testing.assert_allclose(radii, shape.size, rtol=1e-6)
    for j, joint in enumerate(tree.joints):
        assert stream.logged[f"{stream.moved[j]}/axis"].labels.as_arrow_array().to_pylist() == [
            joint.name
        ]
