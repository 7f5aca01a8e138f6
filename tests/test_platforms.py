"""What `docs/platforms.md` says of systems that are no Unix: commands work, or say why not, without Unix's modules."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from fnmatch import fnmatch
from pathlib import Path

from tests import CAPTURES, ROOT

_RUN = """
import json, sys
for name in ("fcntl", "termios", "pty", "tty", "resource", "grp", "pwd"):
    sys.modules[name] = None
from analyzer.cli import main
status = [main(words) for words in json.loads(sys.argv[1])]
print(status, file=sys.stderr)
"""


def without_unix(*commands: list[str], cwd: Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", _RUN, json.dumps(commands)]
    return subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=120)


def test_what_only_reads_files_needs_no_unix(tmp_path):
    capture = str(CAPTURES / "mks_rs485.log")
    done = without_unix(
        ["decode", capture, "-o", "a.mcap"], ["show", "a.mcap", "--limit", "3"], ["check", "a.mcap"],
        ["cut", "a.mcap", "--bus", "serial", "-o", "b.mcap"], ["export", "a.mcap", "-o", "a.csv"],
        ["explain", "FA 01 32 2D"], ["frame", "mks-rs485@1", "read_speed"], ["catalogue", "read_speed"],
        cwd=tmp_path,
    )  # fmt: skip
    assert "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1] == "[0, 0, 1, 0, 0, 0, 0, 0]", done.stderr


def test_drives_are_emulated_and_tested_without_pseudo_terminals(tmp_path):
    done = without_unix(
        ["test", "mks-rs485@1", "--claim", "*/shape/read_speed/answered", "--jobs", "1"],
        ["emulate", "mks-rs485@1", "--tcp", "127.0.0.1:0", "--duration", "0.1"],
        ["emulate", "mks-rs485@1", "--pty", "--duration", "0.1"],
        cwd=tmp_path,
    )
    assert "this system has no pseudo-terminals; use --tcp HOST:PORT" in done.stderr
    assert done.stderr.splitlines()[-1] == "[0, 0, 2]", done.stderr


def test_what_is_installed_has_every_file_that_the_packages_read():
    given = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    tracked = subprocess.run(["git", "ls-files", *given], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    read = [Path(name) for name in tracked if not name.endswith(".py")]
    assert len(read) > 10
    for path in read:
        package, rest = path.parts[0], "/".join(path.parts[1:])
        assert any(fnmatch(rest, pattern) for pattern in given[package]), f"{path} is not installed"
