"""A fault of servotap (exit status 70) fails the test in which it came, in this process or in one that it started."""

from __future__ import annotations

import importlib
import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from analyzer.cli import main
from analyzer.cli.boundary import FOLDER

_FOLDER = pytest.StashKey[Path]()
# python-can loads asammdf, and that pandas: a second in each worker. `by_python_can` has it where MF4 files are written.
with pytest.MonkeyPatch.context() as _patch:
    _patch.setitem(sys.modules, "asammdf", None)
    importlib.import_module("can")
# How long an example takes is the machine's business, and no test's.
settings.register_profile("servotap", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("servotap")
# `nohup make test` and `make test &` hand signals on as ignored, to each process that a test starts and sends one.
signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
# Tests start hundreds of processes; each would compile the whole project anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


@pytest.fixture(scope="session", autouse=True)
def _folder_of_faults(request, tmp_path_factory):
    folder = request.config.stash[_FOLDER] = tmp_path_factory.mktemp("faults")
    os.environ[FOLDER] = str(folder)


@pytest.fixture
def cli(capsys):
    """Return a function that runs `servotap WORDS`, checks its exit status, and returns what was printed: `out`, `err`."""

    def run(*words, status=0):
        assert main([str(word) for word in words]) == status
        return capsys.readouterr()

    return run


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    try:
        return (yield)
    finally:
        found = sorted(item.config.stash[_FOLDER].iterdir())
        told = [each.read_text(encoding="utf-8") for each in found]
        for each in found:
            each.unlink()
        if told:
            pytest.fail("a fault of servotap:\n" + "\n".join(told), pytrace=False)
