"""The gallery's page, from what its pictures are of: `python -m docs.gallery`.

`python -m docs.pictures.gallery` draws the robots, carries out the experiments, draws what came
of them, and keeps the figures that the page shows.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from docs.marks import prose, write

DOCUMENT = Path(__file__).with_suffix(".md")
MODULE = "docs.gallery"
ROOT = DOCUMENT.parent.parent
PLACE = DOCUMENT.parent / "pictures/gallery"
FAULTS = ROOT / "experiments/campaigns/faults.toml"
FIGURES = PLACE / "figures.json"
"""What came of robots and experiments, by their names."""


@dataclass(frozen=True)
class Robot:
    """One robot of the gallery.

    Attributes:
        name: Of its picture.
        title: What it is.
        file: Of the project; of the package example-robot-data if it begins with "robots/".
        weld: Weld its floating root.
        lock: Words of --lock.
        mimic: Hold joints that follow others.
    """

    name: str
    title: str
    file: str
    weld: bool = False
    lock: tuple[str, ...] = ()
    mimic: bool = False

    @property
    def command(self) -> str:
        """What counts its parameters."""
        said = ["--weld-root"] * self.weld
        said += [f"--lock {word}" for word in self.lock] + ["--lock-mimic"] * self.mimic
        shown = self.file.rpartition("/")[2] if self.file.startswith("robots/") else self.file
        return " ".join(["testbed minimal", shown, *said])


ROBOTS = (
    Robot("puma", "PUMA 562, the paper's three joints", "models/puma562.xml"),
    Robot("ur5", "UR5", "robots/ur_description/urdf/ur5_robot.urdf"),
    Robot(
        "panda",
        "Panda, its fingers held",
        "robots/panda_description/urdf/panda.urdf",
        lock=("panda_finger_joint1=0",),
        mimic=True,
    ),
    Robot("tx40", "Staubli TX40", "examples/tx40/tx40.urdf"),
    Robot(
        "gantry",
        "A gantry with a wrist",
        "tests/golden/robots/gantry_ppp_rrr.urdf",
    ),
    Robot(
        "anymal",
        "ANYmal B, held by its trunk",
        "robots/anymal_b_simple_description/robots/anymal.urdf",
        weld=True,
    ),
    Robot(
        "talos_arm",
        "Talos's left arm",
        "robots/talos_data/robots/talos_left_arm.urdf",
    ),
    Robot(
        "g1",
        "Unitree G1, 29 joints, held by its pelvis",
        "robots/g1_description/urdf/g1_29dof_rev_1_0.urdf",
        weld=True,
    ),
)


def experiments() -> list[Path]:
    """Files of the experiments, and of a campaign over faults."""
    return sorted([FAULTS, *(ROOT / "experiments").glob("*.toml")], key=lambda path: path.stem)


def as_markdown(of: str) -> str:
    """The robots or the experiments of the page.

    Args:
        of: Which of both.
    """
    figures = json.loads(FIGURES.read_text())
    lines = of_robots(figures) if of == "robots" else of_experiments(figures)
    return "\n".join(["", *lines, ""])


def of_robots(figures: dict[str, Any]) -> Iterator[str]:
    """A picture, the counts and the command of each robot."""
    for robot in ROBOTS:
        found = figures[robot.name]
        about = f"{robot.title}: drawn on its bedplate, with the force and moment at rest"
        yield from (f"### {robot.title}", "", f"![{about}](pictures/gallery/{robot.name}.svg)", "")
        yield (
            f"{found['joints']} joints, {10 * found['joints']} parameters, **{found['torque']}** "
            f"base parameters from joint torques, **{found['wrench']}** from the plate. "
            f"`{robot.command}`"
        )
        yield ""


def of_experiments(figures: dict[str, Any]) -> Iterator[str]:
    """Claim, picture and figures of each experiment."""
    for path in experiments():
        if path.stem not in figures:  # the test of pictures reports what to do
            continue
        found = figures[path.stem]
        title = path.stem.replace("_", " ").capitalize()
        yield from (f"### {title}", "", prose(" ".join(found["claim"].split())), "")
        yield from (f"![{found['shows']}](pictures/gallery/{path.stem}.svg)", "")
        obtained = found["obtained"].replace("torque to wrench", "torques' over plate's")
        obtained = obtained.replace("wrench ", "plate's ").replace("torque ", "torques' ")
        yield from (f"{obtained} `testbed {found['command']} {path.relative_to(ROOT)}`", "")


if __name__ == "__main__":
    write(DOCUMENT, MODULE, as_markdown)
