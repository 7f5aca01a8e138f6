"""A package of one module that adds a dialect: what an installer leaves in a site folder."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from analyzer import dialects
from tests import ROOT


def make_site(folder: Path, module: str, text: str, dialect: str) -> Path:
    """Put a module into a folder, with the entry point by which its dialect is found."""
    (folder / f"{module}.py").write_text(text)
    info = folder / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module.replace('_', '-')}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{dialects.GROUP}]\n{dialect} = {module}:DIALECT\n")
    return folder


def servotap(site: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a command as someone does who has installed the package."""
    env = {**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}
    done = subprocess.run([sys.executable, "-m", "analyzer", *words], env=env, cwd=site, capture_output=True, text=True)
    assert "Traceback" not in done.stderr, done.stderr
    return done


@contextmanager
def installed(site: Path) -> Iterator[None]:
    """Let this process, and those that it starts, have the package."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(site)
        patch.setenv("PYTHONPATH", f"{site}{os.pathsep}{ROOT}")
        _forget()
        try:
            yield
        finally:
            _forget()
            for module in site.glob("*.py"):
                sys.modules.pop(module.stem, None)


def _forget() -> None:
    dialects._added.cache_clear()
    dialects.get.cache_clear()
