"""The README: each command works as printed, and prints what stands below it."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
_SPEC = importlib.util.spec_from_file_location("make_docs", ROOT / "docs" / "make.py")
make = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(make)

README = (ROOT / "README.md").read_text()


@pytest.mark.parametrize("block", make.commands(README), ids=lambda b: b[0][:60])
def test_a_command_prints_what_stands_below_it(block, tmp_path):
    command, output = block
    assert make.tidy(make.run(command, tmp_path)) == output


@pytest.mark.parametrize("block", make.live(README), ids=lambda b: b[0][:60])
def test_a_live_command_prints_what_stands_below_it_but_for_the_numbers(block, tmp_path):
    command, output = block
    assert make.masked(make.tidy(make.run(command, tmp_path))) == make.masked(output)


def test_the_two_commands_and_the_files_exist():
    makefile = (ROOT / "Makefile").read_text()
    for target in ("demo", "test"):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE)
    for link in re.findall(r"\]\(([^)]+)\)", README):
        assert (ROOT / link).exists(), link


@pytest.mark.parametrize("page", ["findings", "statements", "troubles"])
def test_a_page_that_is_made_is_up_to_date(page):
    assert (ROOT / "docs" / f"{page}.md").read_text() == getattr(make, page)(), f"python docs/make.py {page}.md"


def test_demo_names_three_commands_that_work(tmp_path):
    named = re.findall(r"@echo '  \$\(BIN\)/(servotap .*)'", (ROOT / "Makefile").read_text())
    assert len(named) == 3
    for command in named:
        output = make.run(command, tmp_path)
        assert output
        assert "Traceback" not in output
        assert "servotap: " not in output.splitlines()[-1], output
