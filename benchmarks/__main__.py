"""Benchmarks and large checks: `python -m benchmarks NAME [OPTIONS]` runs `main` of a module.

Times are the least of several runs, rivals in turns in one process; machines are noisy, so
compare ratios.
"""

from __future__ import annotations

import ast
import os
import re
import sys
from importlib import import_module
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core against one core

import typer

FOLDER = Path(__file__).parent


def commands() -> dict[str, Path]:
    """Modules that have a function `main`, by name; of a package its `__main__`."""
    modules = {path.stem: path for path in FOLDER.glob("[!_]*.py")}
    modules |= {path.parent.name: path for path in FOLDER.glob("*/__main__.py")}
    return {
        name: path
        for name, path in sorted(modules.items())
        if re.search(r"^(def main\(|main = )", path.read_text(), re.MULTILINE)
    }


def run(words: list[str]) -> None:
    """Carry out a command, or list all."""
    known = commands()
    if not words or words[0] not in known:
        print(f"{__doc__}\nNAME is one of")
        for name, path in known.items():
            said = ast.get_docstring(ast.parse(path.read_text())) or ""
            print(f"  {name:<12} {said.splitlines()[0]}")
        raise SystemExit(words not in ([], ["--help"]))
    path = known[words[0]].relative_to(FOLDER).with_suffix("")
    main = import_module(".".join(("benchmarks", *path.parts))).main
    app = main
    if not isinstance(main, typer.Typer):
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        app.command()(main)
    app(words[1:], prog_name=f"python -m benchmarks {words[0]}")


if __name__ == "__main__":
    run(sys.argv[1:])
