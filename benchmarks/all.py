"""What costs time and memory: the benchmarks of speed, one after the other."""

from __future__ import annotations

from benchmarks import equations, identify, minimal, pictures, regressor, simulate


def main() -> None:
    """Speed of minimal sets, rows, answers, equations, pictures and simulation."""
    for module in (regressor, identify, equations, pictures, simulate, minimal):
        module.main()
