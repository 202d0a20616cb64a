"""Draw the robot at a posture, with the static reaction of the bedplate on it.

    python portrait.py MODEL.xml PICTURE.png [--posture 0.6 -0.7 1.9] [--camera portrait] [--plain]

The red arrow is the force and the blue one the moment about the plate's centre, both
read from the model's own sensors.  Where the robot is in front of an arrow, the arrow
shines through.  Needs Pillow, and on a machine without a display MUJOCO_GL=egl or osmesa.
"""

import argparse

import mujoco
import numpy as np
from PIL import Image

WIDTH, HEIGHT = 1280, 960
FINER = 2  # drawn this many times larger, then averaged down
METRES_PER_NEWTON = 0.5 / 450
METRES_PER_NEWTON_METRE = 0.5 / 35
THICKNESS = 0.011  # of an arrow [m]
FORCE, MOMENT = (0.85, 0.10, 0.08, 1), (0.05, 0.25, 0.85, 1)
SHINING_THROUGH = 0.6


def reaction(model, data):
    """Where the bedplate's sensor is, and the force and moment it reads at rest, world axes."""
    data.qvel[:] = data.qacc[:] = 0
    mujoco.mj_inverse(model, data)
    site = data.site("bedplate_sensor")
    turn = site.xmat.reshape(3, 3)
    return (
        site.xpos,
        turn @ data.sensor("bedplate_force").data,
        turn @ data.sensor("bedplate_moment").data,
    )


def set_scene(renderer, data, camera, arrows, hidden=None):
    """The robot, unless hidden, with the arrows (start, vector, colour, heads)."""
    renderer.update_scene(data, camera, hidden)
    scene = renderer.scene
    scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = True  # the floor fades into the background
    for start, vector, colour, heads in arrows:
        for head in range(heads):
            end = start + 2 * (1 - 0.2 * head) * vector  # MuJoCo draws half a connector arrow
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(
                geom,
                mujoco.mjtGeom.mjGEOM_ARROW,
                np.zeros(3),
                np.zeros(3),
                np.zeros(9),
                np.array(colour, dtype=np.float32),
            )
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, THICKNESS, start, end)
            geom.emission = 0.4
            geom.segid, geom.objid = scene.ngeom, 0  # to be found by segmentation
            scene.ngeom += 1


def draw(model, data, camera, arrows):
    """The picture as an array; arrows hidden by the robot shine through it."""
    nothing = mujoco.MjvOption()
    nothing.geomgroup[:] = nothing.sitegroup[:] = 0
    with mujoco.Renderer(model, FINER * HEIGHT, FINER * WIDTH) as renderer:
        set_scene(renderer, data, camera, arrows)
        picture = renderer.render().astype(float)
        set_scene(renderer, data, camera, arrows, nothing)
        alone = renderer.render().astype(float)
        renderer.enable_segmentation_rendering()
        arrow = renderer.render()[..., 0] >= 0
    picture[arrow] += SHINING_THROUGH * (alone - picture)[arrow]
    return (
        picture.reshape(HEIGHT, FINER, WIDTH, FINER, 3).mean(axis=(1, 3)).round().astype(np.uint8)
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("model")
    parser.add_argument("picture")
    parser.add_argument(
        "--posture", type=float, nargs=3, default=(0.6, -0.7, 1.9), help="joint angles [rad]"
    )
    parser.add_argument("--camera", default="portrait")
    parser.add_argument("--plain", action="store_true", help="leave the arrows out")
    options = parser.parse_args()

    model = mujoco.MjModel.from_xml_path(options.model)
    data = mujoco.MjData(model)
    data.qpos[:] = options.posture
    origin, force, moment = reaction(model, data)
    arrows = (
        []
        if options.plain
        else [
            (origin, METRES_PER_NEWTON * force, FORCE, 1),
            (origin, METRES_PER_NEWTON_METRE * moment, MOMENT, 2),
        ]
    )
    Image.fromarray(draw(model, data, options.camera, arrows)).save(options.picture, optimize=True)
    print(f"force {np.round(force, 1)} N, moment {np.round(moment, 2)} N m -> {options.picture}")


if __name__ == "__main__":
    main()
