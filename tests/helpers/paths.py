"""Where the project, its golden data and other people's robots stand."""

import sysconfig
from pathlib import Path

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "tests/golden"
REAL = Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix/share/example-robot-data/robots"
"""The robots of the package example-robot-data."""
