"""What commands do when nothing is said: every switch is off, and few options have a value."""

from __future__ import annotations

from pathlib import Path

import click
import typer

from testbed.cli.commands import app

VALUES = {
    ("calibrate", "--out"): Path("plate.toml"),
    ("excite", "--out"): Path("motion.toml"),
    ("excite", "--rate"): 1000.0,
    ("identify", "--method"): "both",
    ("identify", "--fixed"): "lump",
    ("equations", "--form"): "full",
    ("equations", "--language"): "paper",
    ("view", "--port"): 9090,
}
"""As docs/ and the README say them."""


def options() -> dict[tuple[str, str], click.Parameter]:
    """Of all commands, by command and first name."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    return {
        (name, option.opts[0]): option
        for name, command in commands.items()
        for option in command.params
    }


def test_every_switch_is_off() -> None:
    """Nothing unusual is accepted, skipped or printed unless it is asked for."""
    switches = {at: option for at, option in options().items() if getattr(option, "is_flag", 0)}
    assert len(switches) > 50
    assert [at for at, option in switches.items() if option.default] == []


def test_other_options_have_no_value_but_these() -> None:
    said = {at: option.default for at, option in options().items() if option.default}
    assert said == VALUES
