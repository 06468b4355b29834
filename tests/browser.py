"""A page seen by a headless Chromium: what it became, what it complained of. Skips where there is none."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
TIMEOUT = 90
"""Of one page [s]; a guard against a hang, not a measure."""


@dataclass(frozen=True)
class Seen:
    """A page after its scripts.

    Attributes:
        told: what the test's own script gave to ``tell``.
        console: messages of the page, errors and warnings among them.
    """

    told: Mapping[str, Any]
    console: list[str]


def browser() -> str:
    """Path of a Chromium, or skip."""
    for name in NAMES:
        if path := shutil.which(name):
            return path
    pytest.skip("no Chromium on this machine")


def look(
    page: Path, folder: Path, script: str, *, size: tuple[int, int] = (1366, 768), dark: bool = False
) -> Seen:
    """Open a page in a frame of the given size: no window is as narrow as a telephone.

    Args:
        page: HTML file.
        folder: for the browser's own files.
        script: run after the page's own; ends with ``tell({...})``.
        size: of the frame, width and height.
        dark: preferred colours.
    """
    path = browser()
    probed, frame = page.with_name(f"probed-{page.name}"), page.with_name(f"frame-{page.name}")
    tell = "const tell = (found) => parent.postMessage(JSON.stringify(found), '*');"
    text = page.read_text(encoding="utf-8")
    probed.write_text(text.replace("</body>", f"<script>{tell}{script}</script></body>"), encoding="utf-8")
    frame.write_text(
        "<!doctype html><html><body><script>addEventListener('message', (event) => {"
        "document.documentElement.dataset.told = btoa(unescape(encodeURIComponent(event.data))); });</script>"
        f'<iframe src="{probed.name}" width="{size[0]}" height="{size[1]}"></iframe></body></html>',
        encoding="utf-8",
    )
    profile = folder / "profile"
    command = [
        path, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        "--disable-extensions", "--disable-dev-shm-usage",
        "--enable-logging=stderr", f"--user-data-dir={profile}", "--window-size=1500,1000",
        "--virtual-time-budget=5000", f"--blink-settings=preferredColorScheme={0 if dark else 1}",
        "--dump-dom", frame.resolve().as_uri(),
    ]  # fmt: skip
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip("the Chromium of this machine does not answer")
    finally:
        shutil.rmtree(profile, ignore_errors=True)
    if "<html" not in done.stdout:
        pytest.skip(f"the Chromium of this machine does not start: {done.stderr.strip()[-200:]}")
    console = [line for line in done.stderr.splitlines() if ":CONSOLE" in line]
    told = re.search(r'data-told="([^"]*)"', done.stdout)
    return Seen(json.loads(base64.b64decode(told[1])) if told else {}, console)
