"""Sessions of the first hour and the README: each command works in its order, on an emulated drive, and prints what it says."""

from __future__ import annotations

import re

import pytest

from tests import ROOT
from tests.test_readme import README, make

PAGE = (ROOT / "docs" / "first-hour.md").read_text()
#: Commands that print what is on this machine.
_OF_THE_MACHINE = ("$ servotap ports",)


@pytest.mark.parametrize("session", make.sessions(PAGE) + make.sessions(README), ids=lambda s: s[0].split()[1].split(",")[0])
def test_a_session(session, tmp_path):
    drive, blocks = session
    count = 0
    for (kind, command, old), (_, output, status) in zip(blocks, make.play(drive, blocks, tmp_path), strict=True):
        assert status == 0, f"{command}\n{output}"
        if kind == "view":
            assert re.search(r"\[1\] \w+/\w+ (position|speed)", output), output
            assert re.search(r"deg|rpm", output)
        elif not command.startswith(_OF_THE_MACHINE):
            assert make.alike(output, old), f"{command}\n{output}"
        count += 1
        if "savefig" in command:
            assert (tmp_path / "first.png").stat().st_size > 10_000
    assert count == len(blocks)


def test_every_command_of_the_page_is_run():
    played = {command for _, blocks in make.sessions(PAGE) for _, command, _ in blocks}
    assert all(len(blocks) > 8 for _, blocks in make.sessions(PAGE))
    shown = set(re.findall(r"^(?:\$ .*|\^C)$", PAGE, re.MULTILINE))
    assert shown == played
    assert len(make.sessions(PAGE)) == 3


def test_the_links_of_the_page_lead_somewhere():
    heads = {
        re.sub(r"[^\w -]", "", line.lstrip("# ").lower()).replace(" ", "-") for line in PAGE.splitlines() if line[:1] == "#"
    }
    for link in re.findall(r"\]\(([^)]+)\)", PAGE):
        assert link[1:] in heads if link[0] == "#" else (ROOT / "docs" / link).exists(), link
