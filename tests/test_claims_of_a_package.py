"""Claims of another package: the page's own example, found by its entry point and run on an emulated drive."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

ROOT = Path(__file__).parents[1]


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
