"""Every command as a person calls it: what it prints and writes is what somebody approved."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

import testbed as tb
from tests.experiment.test_comparison import LATE
from tests.helpers.approved import hold, tags, timeless
from tests.helpers.command import command_line
from tests.helpers.paths import ROOT
from tests.helpers.viewer import content

pytestmark = pytest.mark.slow

PUMA = "puma562.xml"
SETS = ("motion.duration=8", "simulation.step=5e-4", "motion.candidates=4")
SEEN = ("table.toml", *(word for each in SETS for word in ("--set", each)))

COMPARISON = f"""
name = "late"
experiment = "table.toml"
{LATE}
[[variant]]
name = "quiet"
set = ["measurement.force_noise=0.4"]
says = "nothing of the kind"
"""

CAMPAIGN = """
name = "noises"
experiment = "table.toml"
replicates = 3
set = [
    "motion.duration=2", "motion.candidates=1", "simulation.step=1e-3",
    "excitation.clearance=off",
]
[[factor]]
name = "noise"
set = ["measurement.force_noise=$", "measurement.moment_noise=$*0.2"]
values = [0.5, 2.0]
"""

QUICK = ("excitation.starts=1", "excitation.harmonics=4", "motion.duration=10")
QUICKLY = tuple(word for each in QUICK for word in ("--set", each))
ROBOT = ("--model", PUMA)
DRIVES = ("--zeros", "--set", "identification.drives=given")
PLATE = ("--set", 'identification.nuisances=["matrix"]', "--set", "identification.known={mass=20}")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot, two recordings of it, what they tell, and a run."""
    folder = tmp_path_factory.mktemp("place")
    shutil.copy(ROOT / "models/puma562.xml", folder / PUMA)
    text = (ROOT / "experiments/table6.toml").read_text()
    (folder / "table.toml").write_text(re.sub(r'"[^"]*puma562.xml"', f'"{PUMA}"', text))
    (folder / "variants.toml").write_text(COMPARISON)
    (folder / "noises.toml").write_text(CAMPAIGN)
    for name, more in (
        ("one", []),
        ("other", ["seed=9"]),
        ("loaded", ['simulation.effect=[{kind="payload",mass=1.5,centre=[0,0,0.1]}]', "seed=4"]),
    ):
        experiment = tb.Experiment.load(folder / "table.toml", [*SETS, *more])
        tb.simulate(experiment).save(folder / f"{name}.parquet")
    said = command_line("identify", "one.parquet", *ROBOT, "--zeros", "--json", cwd=folder).stdout
    (folder / "result.json").write_text(said)
    return folder


COMMANDS = {
    "minimal": ("minimal", PUMA),
    "minimal_zeros": ("minimal", PUMA, "--zeros", "--map", "--verify"),
    "minimal_terms": ("minimal", PUMA, "--terms", "rotor", "--terms", "offset", "--numbers"),
    "minimal_latex": ("minimal", PUMA, "--latex", "--zero", "mb1x", "--tared"),
    "identify": ("identify", "one.parquet", *ROBOT, "--zeros"),
    "identify_consistent": (
        *("identify", "one.parquet", *ROBOT, "--consistent", "--write", "made.xml"),
        *("--set", "identification.cutoff=8"),
    ),
    "consistent_known": (
        *("identify", "one.parquet", *ROBOT, "--consistent", "--set", "consistent.known={mass=20}"),
        *("--set", 'consistent.symmetric={link3="yz"}', "--set", "consistent.prior_error=0.2"),
    ),
    "consistent_near": (
        *("identify", "one.parquet", *ROBOT, "--consistent", "--method", "external"),
        *("--set", "consistent.metric=frobenius", "--set", "consistent.centres_in_shapes=true"),
    ),
    "identify_terms": (
        *("identify", "one.parquet", *ROBOT, "--terms", "auto"),
        *("--method", "internal"),
    ),
    "identify_both": ("identify", "one.parquet", "other.parquet", *ROBOT, "--zeros"),
    "validate": ("validate", "other.parquet", "result.json"),
    "identify_narrow": ("identify", "one.parquet", *ROBOT, "--zeros"),
    "compare_narrow": ("compare", "variants.toml", *SEEN[1:]),
    "calibrate": (
        *("calibrate", "one.parquet", *ROBOT, "--known", "mass=20", "--known", "gain/Fz=1+-1e-3"),
        *("--set", 'identification.nuisances=["matrix"]'),
    ),
    "drives": ("drives", "one.parquet", *ROBOT, "--zeros", "--choose-terms"),
    "payload": ("payload", "one.parquet", "loaded.parquet", *ROBOT),
    "payload_rest": ("payload", "one.parquet", "loaded.parquet", *ROBOT, "--at-rest"),
    "run": ("run", *SEEN, "--out", "seen"),
    "compare": ("compare", "variants.toml", *SEEN[1:]),
    "campaign_plan": ("campaign", "noises.toml", "--dry-run"),
    "campaign": ("campaign", "noises.toml", "--workers", "0", "--out", "many"),
    "campaign_summary": ("campaign", "--summary", "many"),
    "campaign_against": ("campaign", "--summary", "many", "--against", "many"),
    "compare_json": ("compare", "variants.toml", *SEEN[1:], "--json"),
    "payload_json": ("payload", "one.parquet", "loaded.parquet", *ROBOT, "--json"),
    "drives_json": ("drives", "one.parquet", *ROBOT, "--zeros", "--json"),
    "minimal_json": ("minimal", PUMA, "--zeros", "--json", "--no-matrices"),
    "excite_json": ("excite", "motion.toml", "--check", "--json"),
    "simulate": ("simulate", *SEEN, "--out", "simulated.parquet"),
    "validate_json": ("validate", "other.parquet", "result.json", "--json"),
    "excite": (
        *("excite", PUMA, *QUICKLY, "--page", "motion.html", "--trajectory", "t.csv"),
        *("--rate", "20"),
    ),
    "new": ("new", PUMA, "--out", "made.toml"),
    "faults": ("faults", "plate_pose"),
    "effects": ("effects", "payload"),
    "equations": ("equations", PUMA, "--what", "mass-matrix", "--form", "reduced", "--zeros"),
}


WRITTEN = {
    "report.html": ("run", ("report", "seen", "--out", "report.html")),
    "recording.html": (
        "identify",
        (
            *("report", "one.parquet", *ROBOT, "--validate", "other.parquet", "--consistent"),
            *("--out", "recording.html"),
        ),
    ),
    "motion.html": ("excite", ()),
    "many/summary.html": ("campaign", ("campaign", "--summary", "many", "--rrd", "many.rrd")),
    "many/figures.csv": ("campaign", ("campaign", "--summary", "many")),
    "many/parameters.csv": ("campaign", ("campaign", "--summary", "many")),
    "many.rrd": ("campaign", ("campaign", "--summary", "many", "--rrd", "many.rrd")),
    "drives.html": (
        "identify",
        ("report", "one.parquet", *ROBOT, *DRIVES, "--out", "drives.html", "--terms", "auto"),
    ),
    "drives.rrd": (
        "identify",
        ("view", "one.parquet", *ROBOT, *DRIVES, "--save", "drives.rrd"),
    ),
    "plate.html": (
        "identify",
        ("report", "one.parquet", *ROBOT, *PLATE, "--out", "plate.html"),
    ),
    "run.rrd": ("run", ("view", "seen", "--save", "run.rrd")),
    "recording.rrd": (
        "identify",
        ("view", "one.parquet", "loaded.parquet", *ROBOT, "--save", "recording.rrd"),
    ),
    "motion.rrd": ("excite", ("view", "motion.toml", "--save", "motion.rrd")),
    "made.toml": ("new", ("new", PUMA, "--out", "again.toml")),
    "result.json": ("identify", ("identify", "one.parquet", *ROBOT, "--zeros", "--json")),
}
"""By file: what must have run, and what writes it, if that has not."""


AFTER = {"campaign_summary": "campaign", "campaign_against": "campaign", "excite_json": "excite"}
"""By name: what must have run."""


@pytest.mark.parametrize("name", COMMANDS)
def test_what_a_command_prints(place: Path, name: str) -> None:
    if name in AFTER:
        printed(place, AFTER[name])
    hold(f"{name}.txt", printed(place, name))


@pytest.mark.parametrize("file", WRITTEN)
def test_what_a_command_writes(place: Path, file: str) -> None:
    before, words = WRITTEN[file]
    printed(place, before)
    if words:
        done = command_line(*words, cwd=place)
        assert done.returncode == 0, done.stderr
    read = {".html": lambda at: tags(at.read_text()), ".rrd": content, ".json": indented}
    text = read.get(Path(file).suffix, Path.read_text)(place / file)
    hold(f"{file.replace('/', '_')}.txt", timeless(text.replace(str(place), "")))


def indented(path: Path) -> str:
    """Numbers for programs, a line each."""
    return json.dumps(json.loads(path.read_text()), indent=0)


def printed(place: Path, name: str) -> str:
    """What a command prints, and how it ends; it runs once."""
    kept = place / f"{name}.said"
    if not kept.exists():
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("COLUMNS", "60" if name.endswith("narrow") else "100")
            done = command_line(*COMMANDS[name], cwd=place)
        words = " ".join(COMMANDS[name])
        text = f"$ testbed {words}\n{done.stdout}\n{done.stderr}\n{done.returncode}\n"
        kept.write_text(timeless(text.replace(str(place), "")))
    return kept.read_text()
