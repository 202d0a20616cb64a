"""The pictures of the README and the documents, made anew: `python -m docs.pictures`.

Runs table6, opens it in Rerun's viewer and its report in Chromium, both without a screen, and
carries out the campaign over noise and friction, and runs three robots of example-robot-data (the
extra `dev`), ten minutes of one processor. Needs Mesa's
software Vulkan driver and Chromium with its driver: on Debian mesa-vulkan-drivers, chromium,
chromium-driver.
"""

from __future__ import annotations

import base64
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
WIDTH = 1440
DARKEST_SHARE = 48.0
"""Share of the colour in the darkest cell, on which text is legible [%]."""
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
        campaign(Path(folder) / "campaign")


def testbed(*words: str) -> None:
    """One command of the tool."""
    subprocess.run([sys.executable, "-m", "testbed", *words], cwd=ROOT, check=True)


def viewer(run: Path, folder: Path) -> None:
    """What the viewer shows first of a run."""
    from testbed.lab.experiment.results import read_run
    from testbed.view.viewer.log import write_runs_rrd
    from testbed.view.viewer.scene import build_scene
    from tests.helpers.viewer import headless_viewer

    scene = build_scene(read_run(run))
    path = folder / "viewer_wrench.rrd"
    write_runs_rrd([scene], path)
    with headless_viewer(folder, SIZE) as (seen, _):
        seen.open(str(path))
        for _ in range(ZOOM):
            seen.run_command("ui.zoom_in_ui")
        time.sleep(6)
        seen.set_time("time", duration=sum(scene.window) / 2, play_state="paused")
        time.sleep(4)
        seen.save_screenshot(str(HERE / "viewer_wrench.png"))
    smaller(HERE / "viewer_wrench.png", WIDTH)


def report(run: Path, folder: Path) -> None:
    """The report's head, light and dark."""
    from tests.helpers.browser import browser

    page = folder / "report.html"
    testbed("report", str(run), "--out", str(page))
    for name, dark in (("report", False), ("report_dark", True)):
        with browser(folder / name, 1000, dark) as seen:
            seen.open(page)
            clip = {"x": 0, "y": 0, "width": 1000, "height": 1100, "scale": 1}
            shot = seen.command(
                "Page.captureScreenshot", {"clip": clip, "captureBeyondViewport": True}
            )
            (HERE / f"{name}.png").write_bytes(base64.b64decode(shot["data"]))
        smaller(HERE / f"{name}.png", 1000)


def campaign(folder: Path) -> None:
    """Errors of both methods over plate noise and friction, if the folder is new, from new runs."""
    from docs.pictures.drawing import CELL, LEFT, save, table, words
    from testbed.campaigns.results import RESULTS_FILE, read_campaign_results
    from testbed.campaigns.summary import summarise
    from testbed.core.base.errors import round_significant

    if not folder.exists():
        file = "experiments/campaigns/noise_friction.toml"
        testbed("campaign", file, "--out", str(folder))
    wide, top, parts = 62, 24.0, []
    cells = summarise(read_campaign_results(folder / RESULTS_FILE).rows)
    errors = {(each.estimator, *map(float, each.levels.values())): each.error for each in cells}
    columns = sorted({noise for _, _, noise in errors})
    lightest = math.log(min(errors.values()))
    span = math.log(max(errors.values())) - lightest
    for method, caption in (("wrench", "Wrench"), ("torque", "Joint torques")):
        rows: dict[str, list[str]] = {}
        for k, friction in enumerate(sorted({friction for _, friction, _ in errors})):
            values = [errors[method, friction, noise] for noise in columns]
            rows[f"{friction:g}"] = [f"{round_significant(100 * value, 2):g}" for value in values]
            for c, value in enumerate(values):
                share = DARKEST_SHARE * (math.log(value) - lightest) / span
                parts.append(
                    f'<rect x="{LEFT + wide * c}" y="{top + 6 + CELL * (k + 1)}" width="{wide}" '
                    f'height="{CELL}" fill="var(--wrench)" opacity="{share / 100:.2f}"/>'
                )
        parts += table(top, f"{caption} [%]", [f"{noise:g}" for noise in columns], rows, wide)
        top += 26 + CELL * (len(rows) + 1) + 12
    row, column = cells[0].levels
    parts.append(words(8, top, f"Rows: {row}. Columns: {column}.", "start", "", "faint"))
    label = "Rms relative error of both methods over friction that the model lacks and plate noise"
    save("campaign", LEFT + wide * len(columns) + 8, top + 14, parts, label)


def smaller(path: Path, width: int) -> None:
    """A picture as wide as a page needs [pixels]."""
    from PIL import Image

    picture = Image.open(path).convert("RGB")
    size = (width, round(picture.height * width / picture.width))
    picture.resize(size, Image.Resampling.LANCZOS).quantize(256, kmeans=3).save(path, optimize=True)


if __name__ == "__main__":
    main()
