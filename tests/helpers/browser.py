"""A headless Chromium by its driver, enough of WebDriver to look at a page; and axe-core."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.paths import ROOT

ARGUMENTS = [
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND",
]  # fmt: skip


class Browser:
    """One page at a time."""

    def __init__(self, port: int, width: int, dark: bool, folder: Path) -> None:
        self._root = f"http://127.0.0.1:{port}"
        options = {
            "args": [*ARGUMENTS, f"--user-data-dir={folder}", f"--window-size={width},900"],
            "mobileEmulation": {"deviceMetrics": {"width": width, "height": 900, "pixelRatio": 1}},
        }
        always = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        made = self.post("/session", {"capabilities": {"alwaysMatch": always}})
        self._session = f"/session/{made['sessionId']}"
        if dark:
            media = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
            self.command("Emulation.setEmulatedMedia", media)

    def post(self, path: str, body: dict[str, Any]) -> Any:
        """One command."""
        request = urllib.request.Request(
            self._root + path, json.dumps(body).encode(), {"Content-Type": "application/json"}
        )
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.load(answer)["value"]

    def command(self, name: str, parameters: dict[str, Any]) -> Any:
        """One command of the browser's own."""
        body = {"cmd": name, "params": parameters}
        return self.post(f"{self._session}/goog/cdp/execute", body)

    def open(self, path: Path) -> None:
        """Go to a file."""
        self.post(f"{self._session}/url", {"url": path.as_uri()})

    def run(self, script: str) -> Any:
        """The value of a script."""
        return self.post(f"{self._session}/execute/sync", {"script": script, "args": []})

    def close(self) -> None:
        """End the browser; its driver alone would leave it running."""
        request = urllib.request.Request(self._root + self._session, method="DELETE")
        urllib.request.urlopen(request, timeout=60).close()

    def complaints(self) -> list[str]:
        """What the page wrote to the console."""
        found = self.post(f"{self._session}/se/log", {"type": "browser"})
        return [entry["message"] for entry in found if entry["level"] in ("SEVERE", "WARNING")]


@contextmanager
def browser(folder: Path, width: int = 1000, dark: bool = False) -> Iterator[Browser]:
    """A browser for a test; the test is skipped where there is none."""
    driver = shutil.which("chromedriver")
    if driver is None or not (shutil.which("chromium") or shutil.which("google-chrome")):
        pytest.skip("no Chromium with its driver on this machine")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    running = subprocess.Popen(
        [driver, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        for _ in range(100):
            try:
                with socket.create_connection(("127.0.0.1", port), timeout=1):
                    break
            except OSError:
                time.sleep(0.1)
        seen = Browser(port, width, dark, folder / "profile")
        try:
            yield seen
        finally:
            seen.close()
    finally:
        running.terminate()
        running.wait()


GRAVE = ("serious", "critical")


def axe() -> str:
    """The source of axe-core, or skipped where it is not: `npm install --no-save axe-core`."""
    given = os.environ.get("AXE_CORE", str(ROOT / "node_modules/axe-core/axe.min.js"))
    if not Path(given).exists():
        pytest.skip("no axe-core: npm install --no-save axe-core, or AXE_CORE=.../axe.min.js")
    return Path(given).read_text()


def complaints(seen: Browser, source: str) -> list[str]:
    """Rules that a browser's page breaks seriously or critically, with some elements.

    Args:
        seen: With the page open.
        source: Axe's.
    """
    seen.command("Runtime.evaluate", {"expression": source})
    found = seen.command(
        "Runtime.evaluate",
        {
            "expression": "axe.run(document, {resultTypes: ['violations']}).then(r => r.violations"
            ".map(v => ({rule: v.id, impact: v.impact, elements: v.nodes.map("
            "n => n.target.join(' ') + ' ' + n.html.slice(0, 90))})))",
            "awaitPromise": True,
            "returnByValue": True,
        },
    )["result"]["value"]
    return [
        f"{v['impact']} {v['rule']}, {len(v['elements'])} elements: {'; '.join(v['elements'][:3])}"
        for v in found
        if v["impact"] in GRAVE
    ]
