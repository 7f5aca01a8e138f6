"""Claims of another package: the page's own example, found by its entry point and run on an emulated drive."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import textwrap

from tests import ROOT


def test_the_example_of_the_page_is_a_claim(tmp_path):
    page = (ROOT / "docs/proving.md").read_text()
    code = re.search(r"(    from analyzer.*?)\n\nA package adds", page, re.DOTALL)
    assert code is not None
    (tmp_path / "my_package.py").write_text(textwrap.dedent(code[1]))
    info = tmp_path / "my_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[servotap.claims]\nmine = my_package\n")
    env = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    words = ["test", "mks-can@1", "--claim", "mks-can/timing/read_speed/our-loop", "--json"]
    done = subprocess.run([sys.executable, "-m", "analyzer", *words], env=env, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    verdict = json.loads(done.stdout.splitlines()[0])
    assert verdict["outcome"] == "confirmed"
    assert verdict["statement"] == "read_speed is answered within 2 ms."


def test_packages_that_fail_are_named_and_left_out(tmp_path):
    """A broken dialect, broken claims and a broken command: each is named where it is needed, and the rest goes on."""
    (tmp_path / "broken.py").write_text("raise RuntimeError('\\x1b[2Jbroken')\n")
    (tmp_path / "late.py").write_text("def claims(dialect):\n    raise KeyError(dialect.name)\n")
    info = tmp_path / "broken-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    points = (
        "[servotap.dialects]\nd = broken:D\n[servotap.claims]\nc = broken\nl = late:claims\n[servotap.commands]\nx = broken\n"
    )
    (info / "entry_points.txt").write_text(points)
    env = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}

    def run(*words):
        done = subprocess.run([sys.executable, "-m", "analyzer", *words], env=env, cwd=tmp_path, capture_output=True, text=True)
        assert "\x1b" not in done.stdout + done.stderr
        return done.returncode, done.stderr

    why = r"failed and is left out: RuntimeError: \x1b[2Jbroken"
    assert run("x") == (2, f"servotap: the command x (broken) {why}\n")
    status, err = run("test", "mks-can@1", "--claim", "mks-can/shape/read_speed*")
    assert status == 0
    assert f"servotap: d (broken:D) of servotap.dialects {why}\n" in err
    assert f"servotap: c (broken) of servotap.claims {why}\n" in err
    assert "servotap: l of servotap.claims failed and is left out: KeyError: 'mks-can'\n" in err
    assert run("show", str(ROOT / "captures/mks_rs485.log"))[0] == 0
    assert run("--help") == (0, "")
