"""Results as JSON lines on standard output."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any


def print_lines(lines: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Print each line as it comes; returns all."""
    found = []
    for line in lines:
        print(json.dumps(line), flush=True)
        found.append(line)
    return found
