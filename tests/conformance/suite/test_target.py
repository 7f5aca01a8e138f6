"""Targets: the drives under test as a user names them."""

from __future__ import annotations

import pytest

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Risk, Role, Verb, always
from analyzer.errors import UsageError
from analyzer.layout import Layout, u8
from analyzer.link import HeadLink, sum8
from conformance.suite import target

READ = Command("read_speed", Verb.READ_SPEED, 0x21, "1", "x", (always(Risk.READ),), Layout(), Layout(u8("speed")))
TOY = Dialect(
    "toy-rs485",
    "A toy",
    "Its manual",
    "serial",
    HeadLink(heads={0xAA: Role.REQUEST, 0x55: Role.REPLY}, check=sum8),
    (READ,),
    addresses=(1, 15),
    models=("S", "L"),
    baud_rates=(9600,),
)
PORT = "serial:/dev/ttyUSB0,baud=9600"


@pytest.fixture
def toy(monkeypatch):
    """A dialect that another package brings, and that no emulated drive speaks."""
    dialects.get.cache_clear()
    monkeypatch.setattr(dialects, "_added", lambda: {TOY.name: TOY})
    yield TOY
    dialects.get.cache_clear()


def test_a_dialect_without_an_emulated_drive_is_tested_on_hardware(toy):
    found = target.parse("toy-rs485@0x0B,model=l", PORT)
    assert (found.dialect, found.address, found.model, found.emulated) == (toy, 11, "L", False)
    assert found.endpoint.bits_per_second == 9600
    with pytest.raises(UsageError, match="no emulated drive speaks toy-rs485"):
        target.parse("toy-rs485@1")


@pytest.mark.parametrize(
    ("drive", "told"),
    [
        ("toy-rs485", "which address"),
        ("toy-rs485@16", "toy-rs485@16: got the address '16', expected 1..15"),
        ("toy-rs485@x", "expected 1..15"),
        ("toy-rs485@1,model=XL", "no model 'XL', expected S or L"),
        ("lk-rs485@1,model=S", "no model 'S', expected MF or MG or MH or MS"),
        ("toy-rs485@1,fault=x", "a drive on hardware has no fault"),
        ("toy-rs485@1,model", "expected model=M"),
        ("toy-rs484@1", "did you mean toy-rs485"),
        ("mks-can@1", "mks-can@1 is a drive on can, and serial:/dev/ttyUSB0,baud=9600 is a serial bus"),
    ],
)
def test_what_is_no_drive_on_hardware_says_what_was_expected(toy, drive, told):
    with pytest.raises(UsageError) as raised:
        target.parse(drive, PORT)
    assert told in str(raised.value)
