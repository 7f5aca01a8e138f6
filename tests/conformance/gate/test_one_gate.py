"""Bytes leave in one place: all requests go through the gate, and only lines open ports."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pytest

from analyzer import dialects
from analyzer.encoder import build
from conformance.bus.emulated import EmulatedLine
from conformance.drives import make
from conformance.gate.gate import Allowance, Gate
from conformance.suite.preflight import find_drive
from conformance.talk.dialogue import Dialogue
from conformance.talk.scan import scan

ROOT = Path(__file__).parents[3]
MODULES = sorted((ROOT / "conformance").rglob("*.py"))
#: Emulated drives answer hosts, and a tap passes on what a program sends: neither is the host.
SERVERS = ("serve", "tap", "drives")
_OPENERS = re.compile(
    r"serial\.Serial\(|serial_for_url\(|can\.Bus\(|can\.Notifier|create_connection\(|socket\.socket\(|openpty\(|os\.open\("
)


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


@pytest.mark.parametrize("path", [p for p in MODULES if not {*p.parts} & {*SERVERS}], ids=name_of)
def test_only_lines_open_ports(path: Path):
    found = _OPENERS.search(path.read_text())
    allowed = path.parent.name == "bus"
    assert found is None or allowed, f"{found.group() if found else ''} in {path.name}"


class Caught(EmulatedLine):
    """A line that notes who writes to it."""

    def __init__(self, *names: str) -> None:
        super().__init__([make.make(make.parse(n)) for n in names], speed=38400)
        self.writers: set[str] = set()

    def write(self, item: Any) -> int:
        self.writers.add(sys._getframe(1).f_code.co_qualname)
        return super().write(item)


def test_whoever_asks_and_looks_does_so_through_the_gate():
    line = Caught("mks-rs485@1")
    gate = Gate(line, Allowance())
    mks = dialects.get("mks-rs485")
    Dialogue(gate, [mks]).ask(build(mks, "read_speed", 1), 10_000_000)
    scan(gate, [mks], addresses=[1, 2])
    find_drive(gate, mks, 3, widely=False)
    assert line.writers == {"Gate._put"}
