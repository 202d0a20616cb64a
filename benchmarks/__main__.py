"""Benchmarks: `python -m benchmarks minimal [--trees N]`; for people, and JSON lines.

Times are the least of several runs in one process; machines are noisy, so compare ratios.
"""

from __future__ import annotations

import json
from typing import Annotated

import typer

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True)


@app.callback()
def main() -> None:
    """Benchmarks and large checks that are too slow for the tests."""


@app.command()
def minimal(
    trees: Annotated[int, typer.Option(help="Random trees to verify besides.")] = 0,
) -> None:
    """Cost of a minimal set over the number of joints; and, asked, agreement of witnesses."""
    from benchmarks.minimal import agreement, scaling

    print(json.dumps(scaling()))
    if trees:
        print(json.dumps(agreement(trees)))


if __name__ == "__main__":
    app()
