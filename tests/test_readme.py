"""The README: each command works as printed, and prints what stands below it."""

from __future__ import annotations

import argparse
import importlib.util
import re
from importlib import import_module

import pytest

from analyzer.cli import _every_command
from analyzer.live import endpoint
from tests import ROOT
from tests.test_layers import PACKAGES

_SPEC = importlib.util.spec_from_file_location("make_docs", ROOT / "docs" / "make.py")
make = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(make)

README = (ROOT / "README.md").read_text()
PAGES = "".join((ROOT / "docs" / page).read_text() for page in ("devices.md", "logic.md"))


@pytest.mark.parametrize("block", make.commands(README) + make.commands(PAGES), ids=lambda b: b[0][:60])
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


def test_the_files_that_a_newcomer_is_sent_to_exist():
    page = (ROOT / "docs" / "adding.md").read_text()
    named = re.findall(rf"((?:{'|'.join(PACKAGES)}|tests|docs)/[\w/.]*)", page)
    assert len(named) > 20
    assert [path for path in named if not (ROOT / path).exists() and "DIALECT" not in path] == []


#: Pages and modules, whose texts name commands: `servotap record serial:PORT,baud=auto`.
TEXTS = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(p for name in PACKAGES for p in (ROOT / name).rglob("*.py"))]
#: Places that a text leaves open.
OPEN = {"ENDPOINT": "serial:/dev/x", "PORT": "/dev/x"}


def named_commands(text):
    """Return the words of the commands that a text names between backticks, and of those on lines of their own."""
    quoted, alone = (
        re.findall(r"`servotap ([^`]+)`", text),
        re.findall(r"^ *(?:\$ )?servotap (.*?)(?:\s{2,}.*)?$", text, re.MULTILINE),
    )
    return [
        [re.findall(r"'[^']*'|\"[^\"]*\"|[^\s\\]+", each.partition(" | ")[0]) for each in found] for found in (quoted, alone)
    ]


def test_every_command_that_a_text_names_is_there_with_its_options():
    options = {}
    for name, (module, _) in _every_command().items():
        parser = argparse.ArgumentParser()
        import_module(module).add_arguments(parser)
        options[name] = set(parser._option_string_actions)
    count = 0
    for path in TEXTS:
        quoted, alone = named_commands(path.read_text())
        assert {name for name, *_ in quoted if name[:1] not in "-{"} <= {*options, "COMMAND"}, path.name
        for name, *words in (each for each in quoted + alone if each and each[0] in options):
            count += 1
            given = {word.partition("=")[0] for word in words if re.match(r"--\w|-[a-z]$", word)}
            assert given <= options[name], (path.name, name, words)
            for place in (word for word in words[:1] if name == "record" and re.search(r"[:,]", word)):
                endpoint.parse(re.sub("|".join(OPEN), lambda m: OPEN[m[0]], place))
    assert count > 100
