"""A page seen by a headless Chromium: what became of it, and what it complained of.

These tests need a Chromium (``apt-get install chromium``; ``.ci/run`` does it). Without one they are skipped;
where the environment variable ``CI`` is set, they fail.
"""

import base64
import json
import os
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
    """Path of a Chromium; without one the test is skipped, or fails under CI."""
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is not None:
        return path
    missing = "needs a browser: apt-get install chromium"
    if os.environ.get("CI", "").lower() in ("", "0", "false"):
        pytest.skip(missing)
    pytest.fail(missing)


def look(page: Path, folder: Path, script: str, *, size: tuple[int, int] = (1366, 768)) -> Seen:
    """Open a page in a frame of the given size: no window is as narrow as a telephone.

    Args:
        page: HTML file.
        folder: for the browser's own files.
        script: body of an asynchronous function, run after the page's own; ends with ``tell({...})``.
        size: of the frame, width and height.
    """
    probed, frame = page.with_name(f"probed-{page.name}"), page.with_name(f"frame-{page.name}")
    tell = "const tell = (found) => parent.postMessage(JSON.stringify(found), '*');"
    text = page.read_text(encoding="utf-8")
    body, _, end = text.rpartition("</body>")
    failed = "(e) => { tell({ error: `${e}` }); throw e; }"
    script = f"<script>{tell}(async () => {{{script}}})().catch({failed});</script></body>"
    probed.write_text(body + script + end, encoding="utf-8")
    frame.write_text(
        "<!doctype html><html><body><script>addEventListener('message', (event) => {"
        "document.documentElement.dataset.told = btoa(unescape(encodeURIComponent(event.data))); });</script>"
        f'<iframe src="{probed.name}" width="{size[0]}" height="{size[1]}"></iframe></body></html>',
        encoding="utf-8",
    )
    profile = folder / "profile"
    command = [
        browser(),
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--no-first-run",
        "--disable-extensions",
        "--enable-logging=stderr",
        f"--user-data-dir={profile}",
        "--window-size=1500,1000",
        "--virtual-time-budget=60000",
        "--dump-dom",
        frame.resolve().as_uri(),
    ]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    finally:
        shutil.rmtree(profile, ignore_errors=True)
    assert "<html" in done.stdout, f"Chromium does not start: {done.stderr.strip()[-200:]}"
    console = [line for line in done.stderr.splitlines() if ":CONSOLE" in line]
    told = re.search(r'data-told="([^"]*)"', done.stdout)
    return Seen(json.loads(base64.b64decode(told[1])) if told else {}, console)
