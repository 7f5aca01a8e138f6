"""Rules: one table of ids, and the issues of a message and of junk."""

from __future__ import annotations

import re

import pytest

from analyzer.catalogue import Role
from analyzer.context import Context
from analyzer.findings import JUNK_RULES, RULES, Issue, finding, of_junk, of_message
from analyzer.records import Junk, JunkReason, Severity
from tests.collect import crc, serial, sum8

MESSAGES = {
    "good": ("mks-rs485", sum8("FA 01 32"), []),
    "wrong checksum": ("mks-rs485", "FA 01 F6 01 40 02 35", ["bad_checksum"]),
    "out of range": ("mks-rs485", sum8("FA 01 F6 0F A0 02"), ["out_of_range"]),
    "reserved bits": ("mks-rs485", sum8("FA 01 F6 71 40 02"), ["reserved_bits"]),
    "exception": ("mks-modbus", crc("01 84 02"), ["modbus_exception"]),
}


def test_every_rule_has_an_id_of_its_own_and_a_meaning():
    for name, rule in RULES.items():
        assert rule.id == name
        assert re.fullmatch(r"[a-z_]+", name)
        assert rule.meaning[0].islower() or rule.meaning.startswith("CAN")
        assert not rule.meaning.endswith(".")
    assert set(JUNK_RULES.values()) <= RULES.keys()


@pytest.mark.parametrize(("name", "text", "rules"), MESSAGES.values(), ids=MESSAGES)
def test_what_is_wrong_with_a_message_by_itself(name, text, rules):
    sink = serial(name, (0, text))
    message = sink.entries[0].message
    assert [issue.rule for issue in of_message(message, Context())] == rules


def test_a_request_in_another_dialect_than_the_drive_speaks():
    message = serial("mks-rs485", (0, sum8("FA 01 32"))).entries[0].message
    context = Context()
    context.speaks[1] = "mks-modbus"
    assert message.role is Role.REQUEST
    assert [issue.rule for issue in of_message(message, context)] == ["other_dialect"]


@pytest.mark.parametrize("reason", [reason for reason in JunkReason if reason is not JunkReason.LEFT_OUT])
def test_junk_shows_its_length_and_its_beginning(reason):
    assert of_junk(Junk("a", 0, 0, 0, b"\xfa", reason)) == Issue(f"junk_{reason}", "1 byte: FA")
    assert of_junk(Junk("a", 0, 0, 0, bytes(99), reason)).text == "99 bytes: " + "00 " * 16 + "..."


def test_the_severity_is_that_of_the_rule_unless_the_issue_has_its_own():
    place = {"port": "a", "address": 1, "first_ns": 1, "last_ns": 2, "section": "5", "offset": 3, "topic": "/a", "sequence": 4}
    assert finding(Issue("host_echo", "x"), **place).severity is Severity.INFO
    assert finding(Issue("host_echo", "x", Severity.ERROR), **place).severity is Severity.ERROR
    assert finding(Issue("host_echo", "x"), **place).offset == 3
