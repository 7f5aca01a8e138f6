"""Rules: what can be wrong on a bus, each with an id, a severity and what it means.

A rule is a row here, and a small condition in the module that has the fact:

    the bytes of one frame        analyzer.codec, analyzer.decoder
    the course of an exchange     analyzer.transactions
    the course of a recording     analyzer.events
    a CAN frame of another type   analyzer.pipeline
    one message by itself         `of_message` below

`Pipeline._plain` knows what these rules look at. A message that is in order there never reaches them.

All use the ids of this table, so that reports, filters and the conformance suite have one list.
"""

from __future__ import annotations

from typing import NamedTuple

from analyzer.context import Context
from analyzer.records import Finding, Frame, Junk, JunkReason, Message, Severity
from analyzer.values import counted


class Rule(NamedTuple):
    """One rule: its id, how bad a breach is, and what it means in a sentence."""

    id: str
    severity: Severity
    meaning: str


class Issue(NamedTuple):
    """A breach of a rule, before it is tied to a place in the log. `severity` None: the rule's own."""

    rule: str
    text: str
    severity: Severity | None = None


_E, _W, _I = Severity.ERROR, Severity.WARNING, Severity.INFO

RULES: dict[str, Rule] = {
    rule.id: rule
    for rule in (
        Rule("junk_noise", _W, "bytes that belong to no frame"),
        Rule("junk_truncated", _W, "the beginning of a truncated frame"),
        Rule("junk_collision", _W, "overlapping frames (collision): two senders at once"),
        Rule("bad_checksum", _E, "a known frame with a wrong checksum; a drive does not answer it"),
        Rule("unknown_command", _W, "a code that the manual does not list"),
        Rule("out_of_range", _E, "a value outside the range that the manual gives"),
        Rule("unknown_choice", _E, "a value that the manual does not list"),
        Rule("reserved_bits", _W, "reserved bits that are not 0"),
        Rule("wrong_length", _E, "a known command whose length differs from the manual"),
        Rule("short_package", _E, "a package shorter than 52 bytes: its padding zeros were lost"),
        Rule("unanswered", _E, "a request without the reply that the manual promises"),
        Rule("silent_address", _I, "an address that does not answer motion commands: respond = 0, or a group (see --group)"),
        Rule("late_reply", _W, "a reply that came after the limit (see --late), or behind a further request, time after time"),
        Rule("unsolicited_reply", _W, "a reply without a request"),
        Rule("duplicate_reply", _W, "a repeated reply"),
        Rule("answered_broadcast", _E, "a reply to a broadcast or a group, which the manual forbids"),
        Rule("failed_status", _E, "the drive reports that it failed or refused"),
        Rule("modbus_exception", _E, "a Modbus exception reply"),
        Rule("refused_write", _E, "a Modbus write that the drive's echo refuses"),
        Rule("other_dialect", _E, "a frame to a drive that speaks another dialect"),
        Rule("host_echo", _I, "an echo of the host's own bytes, by the adapter or the wiring"),
        Rule("can_error_frame", _E, "a CAN error frame"),
        Rule("foreign_can_frame", _W, "a CAN frame of a drive's identifier, of a type or length that the dialect does not use"),
        Rule("port_lost", _W, "a port was lost during recording: traffic from here on is missing"),
        Rule("port_back", _W, "a port reconnected after a gap"),
        Rule("overrun", _W, "lost or damaged bytes, as the serial driver or the levels of the line tell"),
        Rule("dropped", _E, "received bytes or frames are missing: no space in the kernel, in memory or on disk"),
        Rule("bus_error", _W, "an error state of the CAN bus; bus off counts as an error"),
        Rule("clock_step", _I, "the system clock was set, or the machine slept; timestamps do not follow"),
        Rule("restarted", _W, "a recording process died and was restarted"),
        Rule("log_stalled", _W, "the log could not be written for some time (full disk?); no data was lost"),
        Rule("spool_damaged", _E, "data buffered next to the log is damaged"),
        Rule("decoder_fault", _E, "decoding failed on some bytes (a bug in servotap, or in an added dialect); they are kept"),
    )
}

JUNK_RULES = {reason: f"junk_{reason.value}" for reason in JunkReason} | {JunkReason.LEFT_OUT: "decoder_fault"}


def of_message(message: Message, context: Context) -> list[Issue]:
    """Return what is wrong with a message by itself."""
    frame, form, spoken = message.frame, message.form, context.speaks.get(message.address)
    issues = [] if frame.checksum_ok else _checksum(frame)
    issues += [Issue(violation.rule, violation.text) for violation in message.violations]
    if form is not None and form is frame.dialect.exception:
        code = message.values.get("exception", 0)
        known = form.layout.named["exception"].choice_names.get(code, "not a standard code")
        issues.append(Issue("modbus_exception", f"exception 0x{code:02X}, {known}"))
    if spoken is not None and spoken != frame.dialect.name and message.role == "request":
        issues.append(Issue("other_dialect", f"address {message.who} speaks {spoken}, got a {frame.dialect.name} request"))
    return issues


def _checksum(frame: Frame) -> list[Issue]:
    checks = frame.dialect.link.checks(frame.data, None if frame.can is None else frame.can.id)
    return [
        Issue(
            "bad_checksum",
            f"{check.name}: expected {check.expected.hex(' ').upper()}, got {check.got.hex(' ').upper() or 'none'}",
        )
        for check in checks
        if not check.ok
    ]


def of_junk(junk: Junk) -> Issue:
    """Return the issue of a piece of junk."""
    shown = junk.data[:16].hex(" ").upper() + (" ..." if len(junk.data) > 16 else "")
    why = "a dialect that failed is left out; " if junk.reason is JunkReason.LEFT_OUT else ""
    return Issue(JUNK_RULES[junk.reason], f"{why}{counted(len(junk.data), 'byte')}: {shown}")


def finding(
    issue: Issue,
    *,
    port: str,
    first_ns: int,
    last_ns: int,
    offset: int,
    topic: str,
    sequence: int,
    address: int | None = None,
    section: str = "",
    who: str = "",
) -> Finding:
    """Tie an issue to a place."""
    severity = issue.severity or RULES[issue.rule].severity
    return Finding(issue.rule, severity, port, address, first_ns, last_ns, issue.text, section, offset, topic, sequence, who)
