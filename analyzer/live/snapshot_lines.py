"""Lines of a snapshot: what a frame, junk, an event or a finding says, as data that a watcher can show.

Made of the few frames that are shown, never of every frame.
"""

from __future__ import annotations

from analyzer import events
from analyzer.decoder import physical, state_of, units_of
from analyzer.entries import Entry
from analyzer.findings import JUNK_RULES, RULES
from analyzer.live.snapshot import EVENT, JUNK, FindingLine, FrameLine
from analyzer.records import Event, Finding, Junk, Severity

#: Bytes of junk that are shown.
JUNK_SHOWN = 64


def frame_line(entry: Entry) -> FrameLine:
    """Return a decoded frame as a line."""
    message = entry.message
    frame, command = message.frame, message.command
    values = physical(message)
    worst = max((f.severity for f in entry.findings), key=lambda severity: severity.rank, default=None)
    return FrameLine(
        sequence=entry.sequence,
        t_ns=frame.last_ns,
        bus=frame.port,
        role=message.role.value,
        command=message.what,
        who=message.who,
        address=message.address,
        dialect=frame.dialect.name,
        section=command.section if command is not None else "",
        topic=entry.topic,
        values=values,
        units=units_of(message),
        state=state_of(message, values),
        raw=frame.data.hex(" ").upper(),
        offset=frame.offset,
        can_id=None if frame.can is None else frame.can.id,
        extended=frame.can is not None and frame.can.extended,
        latency_ns=entry.latency_ns,
        request_sequence=entry.request_sequence,
        checksum_ok=frame.checksum_ok,
        rules=tuple(f.rule for f in entry.findings),
        severity="" if worst is None else worst.value,
    )


def junk_line(junk: Junk, sequence: int, topic: str) -> FrameLine:
    """Return junk as a line; of a long piece the beginning, `values` says how long it is."""
    return FrameLine(
        sequence=sequence,
        t_ns=junk.last_ns,
        bus=junk.port,
        role=JUNK,
        command=junk.reason.value,
        topic=topic,
        values={"length": len(junk.data)},
        raw=junk.data[:JUNK_SHOWN].hex(" ").upper(),
        offset=junk.offset,
        rules=(JUNK_RULES[junk.reason],),
        severity=Severity.WARNING.value,
    )


def event_line(event: Event, sequence: int) -> FrameLine:
    """Return what happened to a recording as a line."""
    issue = events.issue_of(event)
    severity = None if issue is None else issue.severity or RULES[issue.rule].severity
    return FrameLine(
        sequence=sequence,
        t_ns=event.t_ns,
        bus=event.port,
        role=EVENT,
        command=event.name,
        topic=events.TOPIC,
        rules=() if issue is None else (issue.rule,),
        severity="" if severity is None else severity.value,
        text=events.text_of(event),
    )


def finding_line(found: Finding) -> FindingLine:
    """Return a finding as a line."""
    return FindingLine(
        t_ns=found.first_ns,
        bus=found.port,
        rule=found.rule,
        severity=found.severity.value,
        text=found.text,
        section=found.section,
        address=-1 if found.address is None else found.address,
        who=found.who,
        topic=found.topic,
        sequence=found.sequence,
        offset=found.offset,
    )
