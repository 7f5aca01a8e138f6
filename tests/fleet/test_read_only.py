"""A lake in read-only folders answers all the same. A command that has to write to it says so in a line."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place
from tests.fleet.lakes import hall, ingest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="permissions bind root only where it can give up capabilities")

#: Of Linux's prctl.h and capability.h.
_DROP, _IGNORES_PERMISSIONS = 24, 1


def bound_by_permissions() -> None:
    """Have permissions bind the program that is to be run, for root too."""
    if os.geteuid() == 0 and ctypes.CDLL(None).prctl(_DROP, _IGNORES_PERMISSIONS, 0, 0, 0):
        raise OSError("root cannot give up that permissions do not bind it")


def servotap(*words: object) -> subprocess.CompletedProcess[str]:
    """Run a command that permissions bind."""
    command = [sys.executable, "-m", "analyzer", *map(str, words)]
    return subprocess.run(command, preexec_fn=bound_by_permissions, capture_output=True, text=True, timeout=120)


@pytest.fixture(scope="module")
def read_only(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return a lake of three captures whose files and folders may only be read."""
    try:
        subprocess.run([sys.executable, "-c", ""], preexec_fn=bound_by_permissions, check=True)
    except subprocess.SubprocessError:
        pytest.skip("root may not give up here that permissions do not bind it")
    folder = tmp_path_factory.mktemp("lakes")
    path = folder / "lake"
    ingest(Lake(Place(str(path)), make=True), hall(folder / "in", 3))
    all_of_it = [path, *path.rglob("*")]
    for each in all_of_it:
        each.chmod(0o555 if each.is_dir() else 0o444)
    yield path
    for each in all_of_it:
        each.chmod(0o755)


def test_a_lake_that_may_only_be_read_answers(read_only):
    asked = servotap("ask", read_only, "select count(*) n, sum(frames) > 0 framed from captures where status = 'decoded'")
    assert (asked.returncode, asked.stderr) == (0, "")
    assert asked.stdout.split() == ["n", "framed", "3", "True"]


def test_a_page_is_made_of_a_lake_that_may_only_be_read(read_only, tmp_path):
    made = servotap("fleet", read_only, "-o", tmp_path / "fleet.html")
    assert (made.returncode, made.stderr) == (0, "")
    assert made.stdout.startswith(f"{read_only}: 4 captures")
    assert "</html>" in (tmp_path / "fleet.html").read_text()


@pytest.mark.parametrize("command", [("ingest", "{new}", "--to", "{lake}", "--workers", "1"), ("compact", "{lake}")])
def test_what_writes_to_it_says_that_it_cannot(read_only, tmp_path, command):
    new = hall(tmp_path / "new", 1, first=9)
    refused = servotap(*(word.format(lake=read_only, new=new) for word in command))
    assert refused.returncode == 2
    assert "cannot be written" in refused.stderr
    assert "ermission denied" in refused.stderr
    assert "Traceback" not in refused.stderr
