"""Any words to any command end in order: what its own declaration asks for, filled with what it does not expect."""

from __future__ import annotations

import argparse
import random
import shutil
from importlib import import_module
from importlib.metadata import entry_points

import pytest

from analyzer import cli
from tests import CAPTURES

#: Those that wait for a bus, a port or a person, and those that take long, are attacked by `tests/fuzz`.
NAMES = ("show", "cut", "merge", "frame", "explain", "catalogue", "export", "restore", "rerun", "replay", "emulate", "send")
FILES = ("mks_rs485.log", "mks_rs485.mcap", "mks_can.blf")
VALUES = (
    *FILES, "folder", "loop", "none", "empty", "new.mcap", "new\udcff.mcap", "/dev/full", "x" * 300, "", "-", "--", "\udcff",
    "\x1b[2J", "\u202e", "\n", "[/red]", "{0}", "%s", "~" * 330, "9" * 5000, "-1", "0", "1e400", "nan", "inf", "0x" + "F" * 40,
    "\u0661\u0662", "\u00bd", "1-5", "5-1", ",", "=", "mks-rs485@1", "mks-rs485@1,latency=9e99ms", "mks-can@0x7ff,=",
    "lk-rs485", "99999999999h", "2026-13-45T99:99:99Z", "0001-01-01T00:00:00Z", "speed=" + "9" * 5000, "run_speed", "0xF6",
    "FA 01 F6", "csv",
)  # fmt: skip


def _words(chance: random.Random, name: str) -> list[str]:
    parser = argparse.ArgumentParser()
    modules = {n: m for n, (m, _) in cli.COMMANDS.items()} | {p.name: p.value for p in entry_points(group=cli.GROUP)}
    import_module(modules[name]).add_arguments(parser)
    words = [name]
    for action in parser._actions:
        given = chance.random() < (0.15 if action.option_strings else 0.9)
        if given and not isinstance(action, argparse._HelpAction):
            words += action.option_strings[-1:]
            words += [chance.choice([*(action.choices or ()), *VALUES]) for _ in range(action.nargs != 0)]
    return [*words, *{"emulate": ["--duration", "0.01"], "send": ["--dry-run"], "replay": ["--dry-run"]}.get(name, [])]


@pytest.mark.parametrize("name", NAMES)
def test_any_words(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for file in FILES:
        shutil.copy(CAPTURES / file, tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "empty").touch()
    chance = random.Random(name)
    for _ in range(5):
        words = _words(chance, name)
        try:
            status = cli.main(words)
        except SystemExit as ended:
            status = ended.code
        said = "".join(capsys.readouterr())
        assert status in (0, 1, 2, 10), words
        assert "Traceback" not in said
        assert "\x1b" not in said, words
