"""Folders for a while: what a killed run left is removed by the next one, what a running one holds is not."""

import os
import signal
import subprocess
import sys
import tempfile

import pytest

from analyzer.system.scratch import PREFIX, scratch_folder

pytestmark = pytest.mark.skipif(not hasattr(os, "O_DIRECTORY"), reason="the system has no such locks")

HOLDS = """
from analyzer.system.scratch import scratch_folder
with scratch_folder() as folder:
    (folder / "copy").write_bytes(b"x")
    print(folder, flush=True)
    input()
"""


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.fixture
def holder(temporary):
    """A process that holds a folder with a file."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDS],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
        text=True,
    ) as process:
        yield process, process.stdout.readline().rstrip("\n")
        process.kill()


def test_a_folder_goes_with_what_is_in_it(temporary):
    with scratch_folder() as folder:
        (folder / "deep").mkdir()
        (folder / "deep" / "file").write_text("x")
        assert folder.parent == temporary
    assert list(temporary.iterdir()) == []


def test_what_a_killed_run_left_goes_with_the_next(temporary, holder):
    process, left = holder
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert os.listdir(left) == ["copy"]
    with scratch_folder() as folder:
        assert list(temporary.iterdir()) == [folder]


def test_what_a_run_holds_stays(temporary, holder):
    _, held = holder
    with scratch_folder():
        pass
    assert os.listdir(held) == ["copy"]


def test_what_is_not_ours_stays(temporary):
    others = temporary / "others"
    others.mkdir()
    (others / "file").write_text("x")
    (temporary / f"{PREFIX}link").symlink_to(others)
    (temporary / f"{PREFIX}file").write_text("x")
    (temporary / "servotap-captures").mkdir()
    before = sorted(temporary.iterdir())
    with scratch_folder():
        pass
    assert sorted(temporary.iterdir()) == before
    assert (others / "file").exists()


@pytest.mark.parametrize("opened_first", [True, False], ids=["after it was opened", "before it is opened"])
def test_one_that_was_taken_for_left_is_made_anew(opened_first, temporary, monkeypatch):
    """Between making a folder and holding it, another run may remove it."""
    made = []

    def mkdtemp(prefix):
        folder = temporary / f"{prefix}{len(made)}"
        folder.mkdir()
        made.append(folder)
        return str(folder)

    real = os.open

    def opened(path, *flags):
        if path != made[0]:
            return real(path, *flags)
        if not opened_first:
            made[0].rmdir()
        descriptor = real(path, *flags)
        made[0].rmdir()
        return descriptor

    monkeypatch.setattr(tempfile, "mkdtemp", mkdtemp)
    monkeypatch.setattr(os, "open", opened)
    with scratch_folder() as folder:
        assert [path.exists() for path in made] == [False, True]
        assert folder == made[1]
