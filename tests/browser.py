"""A page in Chromium: what it complains about, what stands in it, how it looks."""

from __future__ import annotations

import shutil
import subprocess

import pytest

needs_chromium = pytest.mark.skipif(shutil.which("chromium") is None, reason="needs Chromium")


def chromium(page, home, *words, scheme="light"):
    """Return what Chromium prints for a page, and fail where its console has anything to say."""
    given = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={home}", "--enable-logging=stderr"]
    given += ["--disable-background-networking", "--disable-sync", "--no-first-run", "--virtual-time-budget=3000"]
    given += [f"--blink-settings=preferredColorScheme={int(scheme == 'light')}", *words, page.as_uri()]
    done = subprocess.run(given, capture_output=True, text=True, timeout=60, check=True)
    assert "CONSOLE" not in done.stderr, done.stderr
    return done.stdout
