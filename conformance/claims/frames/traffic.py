"""Traffic: the analyzer finds nothing wrong with what a drive answers.

The claims are those of `claims.frames.traffic_rules` that are about the drive, one for each rule. In a run of the suite a short
session of reads is judged by them; `servotap check` judges any recording by them, and by those about hosts and wires.

Rules kept here:
- All claims judge one session where they run on one rig; one that is begun anew has a session of its own.
- The session goes through a pipeline of its own, to its end, so that what is never answered is found too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from msgspec.structs import replace

from analyzer.catalogue import Dialect, Role
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk
from conformance.claim import Claim, Inconclusive, NotRun, Outcome, Refuted, Theme, Verdict
from conformance.claims.control_reads import section
from conformance.claims.declare import declare
from conformance.claims.frames.traffic_rules import ROWS, Count, Judge, Party, Row, Seen
from conformance.claims.known_quirks import NO_CHECKSUM, known
from conformance.claims.known_reads import plain_reads

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

_PORT = "bus"
_ROUNDS = 2
#: What the session has: reads of one drive.
_IN_SESSION = frozenset({Seen.FRAMES, Seen.REQUESTS, Seen.REPLIES})
#: Rows that no drive can break in a session of reads.
_NOT_IN_SESSION = frozenset({"silent", "done"})
#: A drive with this quirk has no replies that the analyzer could read.


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for a dialect: those that a session of reads can refute."""
    for row in ROWS:
        can_break = dialect.link.checked or row.rule != "bad_checksum"
        if row.about is Party.DRIVE and row.needs in _IN_SESSION and row.name not in _NOT_IN_SESSION and can_break:
            yield claim_of(dialect, row, _in_session(row))


def claim_of(dialect: Dialect, row: Row, check: Callable[[Probe], None] | None = None) -> Claim:
    """Return a row as a claim about a dialect. Without a `check` it needs a recording, and does not run on a drive."""
    return declare(
        dialect,
        Theme.TRAFFIC,
        f"{row.about.value}/{row.name}" if row.about is not Party.DRIVE else row.name,
        row.statement,
        f"a finding {row.rule}",
        check or _needs_recording,
        section=section(dialect),
        at_best=row.certainty,
        parameters={"rule": row.rule, "about": row.about.value},
        quirks=known(dialect, NO_CHECKSUM) if check is not None else (),
        of_line=row.rule == "bad_checksum",
    )


def _needs_recording(probe: Probe) -> None:
    raise NotRun("it judges recordings: servotap check")


# --- a session --------------------------------------------------------------------------------------------------------


class _Session(NamedTuple):
    """What was found in a session. `bare`: replies came without a checksum."""

    judge: Judge
    bare: bool


def _session(probe: Probe) -> _Session:
    start = len(probe.raw)
    exchanges = [probe.ask(command) for _ in range(_ROUNDS) for command in plain_reads(probe.dialect)]
    bare = any(answer.bare for exchange in exchanges for answer in exchange.answers)
    return _Session(judged(probe.raw[start:], probe.dialect, probe.rig.byte_ns, probe.rig.late_ns), bare)


def judged(items: Iterable[Chunk | CanFrame], dialect: Dialect, byte_ns: int = 0, late_ns: int = 1_000_000_000) -> Judge:
    """Return what the analyzer finds in traffic of one line: what the host sent is marked so, all else came back."""
    judge = Judge((dialect,))
    pipeline = Pipeline((dialect,), (judge,), Options(byte_ns=byte_ns, late_ns=late_ns))
    for item in items:
        # What was sent and what came have the names of two ends of one line.
        sent = item.direction is Role.REQUEST
        if isinstance(item, Chunk):
            pipeline.feed(Chunk(item.t_ns, _PORT, item.data, Role.REQUEST if sent else Role.REPLY, item.burst))
        else:
            pipeline.feed(replace(item, port=_PORT, direction=Role.REQUEST if sent else Role.UNKNOWN))
    pipeline.close()
    return judge


def _in_session(row: Row) -> Callable[[Probe], None]:
    def check(probe: Probe) -> None:
        session = probe.recorded(_session)
        if session.bare and NO_CHECKSUM in probe.claim.quirks:
            probe.meets(NO_CHECKSUM)
            return
        judge = session.judge
        count = next(c for c in judge.counts() if c.row is row)
        if count.found:
            raise _refuted(count)
        if not judge.ran(count):
            raise Inconclusive(f"no {row.needs.value} were seen")

    return check


def _refuted(count: Count) -> Refuted:
    first = count.examples[0]
    got = f"{count.found} of {count.row.rule}, the first: {first.finding.text}"
    if first.data:
        got += f" in {first.data.hex(' ').upper()}"
    return Refuted(f"{count.row.rule}: {first.finding.text}", expected="no such finding", got=got, key=count.row.rule)


# --- recordings -------------------------------------------------------------------------------------------------------


def verdicts(judge: Judge, parties: Sequence[Party] = tuple(Party)) -> list[tuple[Verdict, Count]]:
    """Return what came of each claim about traffic that was judged, with what was found against it."""
    result = []
    for count in judge.counts():
        if count.row.about not in parties:
            continue
        claim = claim_of(judge.dialects[count.dialect], count.row)
        result.append((_verdict(claim, count, judge.ran(count)), count))
    return result


def _verdict(claim: Claim, count: Count, ran: bool) -> Verdict:
    measured = {"findings": float(count.found)}
    if not ran:
        return Verdict(claim, Outcome.NOT_RUN, f"no {count.row.needs.value} in the recording", measured=measured)
    if not count.found:
        return Verdict(claim, Outcome.CONFIRMED, measured=measured)
    error = _refuted(count)
    first, last = count.examples[0].finding, count.examples[-1].finding
    outcome = Outcome.OBSERVED if claim.certainty.value == "open" else Outcome.REFUTED
    return Verdict(
        claim, outcome, error.text, error.expected, error.got, error.key, first_ns=first.first_ns, last_ns=last.last_ns,
        measured=measured,
    )  # fmt: skip
