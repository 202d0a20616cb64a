"""The pictures of the README and the documents, made anew: `python -m docs.pictures`.

Runs table6, opens it in Rerun's viewer and its report in Chromium, both without a screen,
and draws the robot's portrait. Needs Mesa's software Vulkan driver, Chromium with its
driver and EGL: on Debian mesa-vulkan-drivers, chromium, chromium-driver.
"""

from __future__ import annotations

import base64
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
WIDTH = 1440
SIZE, ZOOM = "1920x1440", 10
"""Of the viewer's window [pixels], and steps of its zoom: words can be read on a page."""


def main() -> None:
    """Make all pictures."""
    sys.path.insert(0, str(ROOT))
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "table6"
        testbed("run", "experiments/table6.toml", "--out", str(run))
        viewer(run, Path(folder))
        report(run, Path(folder))
    portrait()


def testbed(*words: str) -> None:
    """One command of the tool."""
    subprocess.run([sys.executable, "-m", "testbed.cli", *words], cwd=ROOT, check=True)


def viewer(run: Path, folder: Path) -> None:
    """What the viewer shows in some of its tabs."""
    from testbed.experiment.growth import growth
    from testbed.experiment.run_folder import read_run
    from testbed.viewer.log import write_rrd
    from testbed.viewer.scene import scene_of
    from tests.helpers.viewer import headless_viewer

    found = read_run(run)
    scene = scene_of(found, growth(found))
    for tab in ("overview", "wrench", "friction", "estimates"):
        path = folder / f"{tab}.rrd"
        write_rrd([scene], path, tab)
        with headless_viewer(folder, SIZE) as (seen, _):
            seen.open(str(path))
            for _ in range(ZOOM):
                seen.run_command("ui.zoom_in_ui")
            time.sleep(6)
            seen.set_time("time", duration=sum(scene.window) / 2, play_state="paused")
            time.sleep(4)
            seen.save_screenshot(str(HERE / f"viewer_{tab}.png"))
        smaller(HERE / f"viewer_{tab}.png")


def report(run: Path, folder: Path) -> None:
    """The report's head and its map of what can be told."""
    from tests.helpers.browser import browser

    page = folder / "report.html"
    testbed("report", str(run), "--out", str(page))
    for name, anchor, height in (("report", "", 1100), ("map", "map", 520)):
        with browser(folder / name, 1000) as seen:
            seen.open(page)
            top = seen.run(
                f"const e = document.getElementById('{anchor}');"
                "return e ? e.getBoundingClientRect().top + window.scrollY : 0"
            )
            clip = {"x": 0, "y": top, "width": 1000, "height": height, "scale": 1}
            shot = seen.command(
                "Page.captureScreenshot", {"clip": clip, "captureBeyondViewport": True}
            )
            (HERE / f"{name}.png").write_bytes(base64.b64decode(shot["data"]))


def smaller(path: Path) -> None:
    """A picture as wide as a page needs."""
    from PIL import Image

    picture = Image.open(path).convert("RGB")
    size = (WIDTH, round(picture.height * WIDTH / picture.width))
    picture.resize(size, Image.Resampling.LANCZOS).quantize(200).save(path, optimize=True)


def portrait() -> None:
    """The robot with the reaction at rest."""
    command = [sys.executable, str(HERE / "portrait.py"), "models/puma562.xml"]
    environment = os.environ | {"MUJOCO_GL": os.environ.get("MUJOCO_GL", "egl")}
    subprocess.run([*command, str(HERE / "puma562.png")], cwd=ROOT, env=environment, check=True)


if __name__ == "__main__":
    main()
