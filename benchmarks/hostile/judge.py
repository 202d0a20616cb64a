"""What a command must do with a hostile input, and where it did not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.hostile.case import Case
from benchmarks.hostile.worker import MEGABYTES, SECONDS
from testbed.core.base.errors import MAX_MESSAGE_LENGTH

START = "testbed: "


def complaints(
    case: Case, done: Mapping[str, Any], before: Mapping[str, bytes], after: Mapping[str, bytes]
) -> list[str]:
    """What is wrong with how a command ended; nothing, if it took or refused its input well.

    Args:
        case: The input.
        done: As `worker.carried_out` reports, or `{"died": signal}`.
        before: Content of the case's folder, by name, before the command.
        after: The same afterwards.
    """
    if "died" in done:
        return [f"died: {done['died']}"]
    found = []
    if done["code"] not in (0, 1, 2):
        found.append("a traceback" if done["code"] == 70 else f"exit code {done['code']}")
    elif done["code"] == 2:
        found += _refusal(done["stderr"])
        found += [f"{name} is not named" for name in case.named if name not in done["stderr"]]
    found += _words(done)
    if max(done["seconds"], done["wall"]) > SECONDS:
        found.append(f"more than {SECONDS} s")
    if done["megabytes"] > MEGABYTES:
        found.append(f"more than {MEGABYTES} MB")
    if any(after.get(name) != content for name, content in before.items()):
        found.append("an input changed")
    kept = "kept in" in done["stderr"]  # a run whose recording is worth keeping says so
    allowed = case.outputs if done["code"] != 2 or kept else ()
    left = [n for n in after if n not in before and n.partition("/")[0] not in allowed]
    if left or any(".testbed-" in name for name in after):
        found.append(f"left behind: {left[0] if left else '.testbed-'}"[:60])
    return found


def _refusal(stderr: str) -> list[str]:
    """Of what is said on standard error where the input is refused."""
    lines = [line for line in stderr.split("\n") if line]
    notes = [line for line in lines if line.startswith("note: ") or line.endswith(" ...")]
    if len(lines) - len(notes) != 1 or not lines[-1].startswith(START):
        return [f"{len(lines)} lines of refusal"]
    return [] if lines[-1].removeprefix(START).strip() else ["a refusal without words"]


def _words(done: Mapping[str, Any]) -> list[str]:
    """Of what the terminal is given."""
    found = []
    errors = done["stderr"].split("\n")
    if not all(line.isprintable() for line in errors):
        found.append("control characters on standard error")
    if any(len(line) > MAX_MESSAGE_LENGTH + len(START) for line in errors):
        found.append("a message too long")
    if not all(line.isprintable() for line in done["stdout"].split("\n")):
        found.append("control characters on standard output")
    if "Traceback" in done["stderr"] or "Exception ignored" in done["stderr"]:
        found.append("words of the interpreter")
    return found
