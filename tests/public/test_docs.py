"""The page about Python and the session: each example runs, and prints what stands below it."""

from __future__ import annotations

import doctest
import re
import runpy

import matplotlib

from tests import CAPTURES, ROOT

matplotlib.use("Agg")


def test_the_examples_of_the_page_print_what_stands_below_them(tmp_path, monkeypatch):
    (tmp_path / "captures").symlink_to(CAPTURES)
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL)
    text = "\n".join(blocks)
    test = doctest.DocTestParser().get_doctest(text, {}, "python.md", str(ROOT / "docs" / "python.md"), 0)
    assert len(test.examples) > 15
    told: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=told.append)
    assert not told, "".join(told)
    assert (tmp_path / "plot.png").stat().st_size > 1000
    matplotlib.pyplot.close("all")


def test_the_session_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(ROOT / "docs" / "session.py"))
    told = capsys.readouterr().out
    assert "error: current: got 6000 mA" in told
    assert re.search(r"it stands at \d+ degrees", told)
    assert (tmp_path / "session.png").read_bytes()[:4] == b"\x89PNG"
    matplotlib.pyplot.close("all")
