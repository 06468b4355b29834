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
from pathlib import Path
from typing import Any, NamedTuple

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
TIMEOUT = 90
"""Time for one page [s]; a guard against a hang, not a measure."""


class Seen(NamedTuple):
    """A page after its scripts."""

    told: Mapping[str, Any]  # what the test's own script gave to ``tell``
    console: list[str]  # messages of the page, errors and warnings among them


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
    """Open a page in a frame of the given width and height: no window is as narrow as a telephone.

    ``script`` is the body of an asynchronous function that runs after the page's own and ends with
    ``tell({...})``; the browser's own files go into ``folder``.
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
    options = (
        "headless no-sandbox disable-gpu disable-dev-shm-usage no-first-run disable-extensions "
        "enable-logging=stderr window-size=1500,1000 virtual-time-budget=60000 dump-dom"
    )
    command = [browser(), *(f"--{option}" for option in options.split()), f"--user-data-dir={profile}"]
    command.append(frame.resolve().as_uri())
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    finally:
        shutil.rmtree(profile, ignore_errors=True)
    assert "<html" in done.stdout, f"Chromium does not start: {done.stderr.strip()[-200:]}"
    console = [line for line in done.stderr.splitlines() if ":CONSOLE" in line]
    told = re.search(r'data-told="([^"]*)"', done.stdout)
    return Seen(json.loads(base64.b64decode(told[1])) if told else {}, console)
