"""What the report says of the line: only what no claim makes by itself."""

from __future__ import annotations

import msgspec
import pytest

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from conformance.report.bus import line_causes
from conformance.report.html import html
from conformance.suite.record import Traffic
from tests.conformance.report.test_page import RUN, silent
from tests.diagnosis.spoiled_line import levels, received

MS = 1_000_000
NATIVE = dialects.get("mks-rs485")
READS = ("read_speed", "read_position", "read_status", "read_enabled")


def refuted(spoil, sent=lambda data: data):
    """Return a refuted claim for each read, with its request and what came back."""
    found = []
    for number, name in enumerate(READS):
        reply = spoil(build(NATIVE, name, 1, {}, Role.REPLY))
        rows = (Traffic(number * 50 * MS, True, sent(build(NATIVE, name, 1))), Traffic(number * 50 * MS + 5 * MS, False, reply))
        found.append(silent(name, traffic=rows))
    return found


@pytest.mark.parametrize(
    ("spoil", "cause"),
    [(lambda data: received(levels(data), inverted=True), "inverted_lines"), (lambda data: b"\0" + data, "leading_glitch")],
)
def test_a_bad_line_is_told_once(spoil, cause):
    told = list(line_causes(refuted(spoil)))
    assert told[0] == "the line of mks-rs485@1, as the failed claims show it:"
    assert sum(f"({cause}," in line for line in told) == 1


def test_the_page_has_the_lines_too():
    nobody = "mks-rs485@1 does not answer; nothing came\n  1. The host asks another address. (wrong_address, likely)"
    page = html(refuted(lambda data: b"\0" + data), msgspec.structs.replace(RUN, notes=(nobody,)))
    assert "(leading_glitch," in page
    assert "(wrong_address, likely)" in page
    assert "pre-line" in page


def test_what_claims_send_on_purpose_is_no_cause():
    assert list(line_causes(refuted(lambda data: data, lambda data: data[:-1] + bytes((data[-1] ^ 0x55,))))) == []
    assert list(line_causes(refuted(lambda data: data, lambda data: b"\0" + data))) == []
