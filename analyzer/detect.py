"""Which dialects a capture is in: each is tried on a sample, and the evidence is kept to be shown.

A dialect's score is a share of the sample's bytes: those in its frames with a fitting check, a catalogued command and values
from the manual's list. The best dialect is chosen. Another one joins if both explain clearly more than the best alone (a
drive switched to Modbus, drives of several makers on one line).

CAN delimits frames itself, so for a dialect without checks only code and length count. Some of any traffic fits those by
chance. Such a dialect must therefore explain at least half of the frames that no check speaks for.

A dialect of no drive (`modbus`: slaves of any make) is chosen where drives explain little, and most bytes are its requests with
their replies. Refusals do not count: a drive that is asked for a wrong register refuses, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from analyzer.catalogue import Dialect, Role
from analyzer.entries import Entry
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk, Comment, Finding, Junk

#: A further dialect must explain this share of the sample, in this many frames at least.
_JOIN_SHARE = 0.01
_JOIN_FRAMES = 3
#: Items of a sample that is short, and the frames that are enough in one: a request that was tried again.
_SHORT, _JOIN_SHORT = 12, 2
#: Below this share no dialect is believed.
_LEAST = 0.02
#: Share of the bytes from which a dialect that was not chosen is told.
_WORTH_TELLING = 0.05
#: A dialect of no drive must explain this share of the bytes in so many exchanges, and those of drives less than that.
_LEAST_SLAVE, _SLAVE_EXCHANGES, _MOST_DRIVE = 0.5, 3, 0.25
#: Share of the frames without a fitting check that a dialect without checks must explain.
_LEAST_UNCHECKED = 0.5


@dataclass
class Evidence:
    """What a dialect explains of a sample. `share`: of its bytes, 0..1; `answers`: replies that are no refusal."""

    dialect: Dialect
    frames: int = 0
    good_bytes: int = 0
    total_bytes: int = 0
    findings: int = 0
    answers: int = 0

    @property
    def share(self) -> float:
        """Share of the bytes in good frames."""
        return self.good_bytes / self.total_bytes if self.total_bytes else 0.0

    def __str__(self) -> str:
        return f"{self.dialect.name}: {self.frames} good frames, {100 * self.share:.1f} % of the bytes"


@dataclass(frozen=True)
class Choice:
    """The dialects chosen, the evidence for each that was tried, best first, and the reason in words."""

    dialects: tuple[Dialect, ...]
    evidence: tuple[Evidence, ...]
    reason: str


class _FrameCount:
    """A sink that counts good frames by dialect."""

    def __init__(self) -> None:
        self.frames: dict[str, int] = {}
        self.good_bytes: dict[str, int] = {}
        #: Replies that are no refusal.
        self.answers: dict[str, int] = {}
        self.findings = 0

    def entry(self, entry: Entry) -> None:
        message = entry.message
        frame = message.frame
        good = frame.checksum_ok and message.form is not None and not message.violations
        fallback = message.command is not None and message.command in frame.dialect.fallbacks.values()
        if good and not fallback and (frame.can is None or message.role is not Role.UNKNOWN):
            name = frame.dialect.name
            self.frames[name] = self.frames.get(name, 0) + 1
            self.good_bytes[name] = self.good_bytes.get(name, 0) + len(frame.data)
            answers = entry.first_reply and message.form is not frame.dialect.exception
            self.answers[name] = self.answers.get(name, 0) + answers

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        pass

    def finding(self, found: Finding) -> None:
        self.findings += 1

    def comment(self, comment: Comment) -> None:
        pass


def _try(dialects: Sequence[Dialect], sample: Sequence[Chunk | CanFrame]) -> _FrameCount:
    """Return what some dialects explain of a sample together; where several could, the first does."""
    count = _FrameCount()
    Pipeline(dialects, [count], Options()).run(sample)
    return count


def weigh(dialect: Dialect, sample: Sequence[Chunk | CanFrame], given: Sequence[Dialect] = ()) -> Evidence:
    """Return what one dialect explains of a sample, of what those that are given leave."""
    count = _try([*given, dialect], sample)
    total = sum(len(item.data) for item in sample) - sum(count.good_bytes.get(d.name, 0) for d in given)
    return Evidence(
        dialect, count.frames.get(dialect.name, 0), count.good_bytes.get(dialect.name, 0), total, count.findings,
        count.answers.get(dialect.name, 0),
    )  # fmt: skip


def choose(candidates: Sequence[Dialect], items: Sequence[Chunk | CanFrame | Comment], given: Sequence[Dialect] = ()) -> Choice:
    """Return the dialects that a sample is in; without any evidence, all candidates of drives of its kind of bus.

    `given`: those of other devices that are on the bus, as the user says; they come first.
    """
    sample = [item for item in items if not isinstance(item, Comment)]
    kind = "can" if sample and isinstance(sample[0], CanFrame) else "serial"
    given = [d for d in given if d.bus == kind]
    found = _chosen([d for d in candidates if d.bus == kind], sample, kind, given)
    reason = "; ".join([*(f"{d.name}: as given" for d in given), found.reason])
    return Choice((*given, *found.dialects), found.evidence, reason)


def _chosen(candidates: list[Dialect], sample: list[Chunk | CanFrame], kind: str, given: Sequence[Dialect]) -> Choice:
    """Return which of the candidates a sample is in, besides those that are given."""
    fitting = [d for d in candidates if d.of_drives]
    if len(fitting) == 1:
        return Choice(tuple(fitting), (), f"the only dialect for {kind} buses")
    evidence = [weigh(dialect, sample, given) for dialect in fitting]
    if given and evidence and not evidence[0].total_bytes:
        return Choice((), (), "all bytes are theirs")
    # A stable sort: of dialects that explain the same, the one listed first wins.
    evidence.sort(key=lambda e: -e.good_bytes)
    believed = _believed(evidence, sample, given)
    most = believed[0].share if believed else 0.0
    for slave in (weigh(d, sample, given) for d in candidates if not d.of_drives and most < _MOST_DRIVE):
        if slave.share >= _LEAST_SLAVE and slave.answers >= _SLAVE_EXCHANGES:
            return Choice((slave.dialect,), (slave, *evidence), f"{slave}, and no drive's registers")
    if not believed or believed[0].share < _LEAST:
        shown = "; ".join(str(e) for e in evidence)
        return Choice(tuple(fitting), tuple(evidence), f"no dialect explains the bytes, all are tried ({shown})")
    chosen = [believed[0].dialect]
    least = _JOIN_FRAMES if len(sample) > _SHORT else _JOIN_SHORT
    for other in believed[1:]:
        if other.frames < least:
            continue
        together = _try([*given, *chosen, other.dialect], sample)
        before = _try([*given, *chosen], sample)
        gain = sum(together.good_bytes.values()) - sum(before.good_bytes.values())
        if together.frames.get(other.dialect.name, 0) >= least and gain >= _JOIN_SHARE * other.total_bytes:
            chosen.append(other.dialect)
    # Of dialects that explain next to nothing a person need not know.
    told = [e for e in evidence if e.dialect in chosen or e.share >= _WORTH_TELLING]
    reason = "; ".join(str(e) for e in told)
    return Choice(tuple(chosen), tuple(evidence), reason)


def _believed(evidence: Sequence[Evidence], sample: Sequence[Chunk | CanFrame], given: Sequence[Dialect]) -> list[Evidence]:
    """Return the evidence without that for dialects which have no check and explain too few frames."""
    checked = [e.dialect for e in evidence if e.dialect.link.checked]
    if len(checked) == len(evidence):
        return list(evidence)
    known = [*given, *checked]
    rest = len(sample) - (sum(_try(known, sample).frames.values()) if known else 0)
    return [e for e in evidence if e.dialect.link.checked or e.frames >= _LEAST_UNCHECKED * rest > 0]
