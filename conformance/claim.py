"""Claims and verdicts: each claim is one statement of the manual, with a small function that can refute it.

    Claim -> check(probe) -> Verdict

A check returns when the drive did as the claim says, and raises otherwise:

    Refuted         the drive did something else: the expected value, the value got, and the exchange
    Inconclusive    a precondition failed; the claim of that precondition judges it
    Observed        the manual leaves it open: the behaviour of the drive

A claim of open certainty never refutes: its refutation becomes an observation. A claim may name quirks: known behaviour of
real drives that differs from the manual. If a drive shows one, the claim says so (`Probe.meets`): it is refuted and the quirk
named, or observed where the user accepts that quirk.

Rules:
- A claim sends only requests within its `risks`, and depends on no earlier claim.
- The probe knows of every change that a claim leaves behind.
- A check that cannot refute is no claim.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol

from analyzer.catalogue import Certainty, Command, Risk
from analyzer.errors import ServotapError
from analyzer.records import CanFrame, Chunk


class RigFault(ServotapError):
    """The rig is at fault, not the drive: no drive answers, a port does not work."""

    exit_status = 10


class NotStopped(ServotapError):
    """The drive could not be brought to a verified stop."""

    exit_status = 20


#: Exit statuses of a run, what counts most first: a motor that turns, a drive that is refuted, a rig at fault.
_WORST_FIRST = (NotStopped.exit_status, 1, RigFault.exit_status)


def worst(*statuses: int) -> int:
    """Return which of several exit statuses counts."""
    return min(statuses, key=lambda s: (_WORST_FIRST.index(s) if s in _WORST_FIRST else len(_WORST_FIRST), -s), default=0)


class Evidence(Protocol):
    """What shows a refutation: an exchange (`conformance.talk.exchange`). `command`: what was asked, if it was one."""

    @property
    def command(self) -> Command | None: ...

    def lines(self) -> list[str]:
        """Return it for people, a line a frame."""

    def records(self) -> list[Chunk | CanFrame]:
        """Return what went over the line, in order; what was sent has the direction of a request."""


class Theme(StrEnum):
    """What a claim is about."""

    EXAMPLES = "examples"
    SHAPE = "shape"
    RANGES = "ranges"
    FRAMING = "framing"
    ADDRESSING = "addressing"
    READ_BACK = "read-back"
    STATE = "state"
    MOTION = "motion"
    TIMING = "timing"
    MODBUS = "modbus"
    RESILIENCE = "resilience"
    TRAFFIC = "traffic"


class Outcome(StrEnum):
    """The result of a claim."""

    CONFIRMED = "confirmed"
    REFUTED = "refuted"
    INCONCLUSIVE = "inconclusive"
    OBSERVED = "observed"
    NOT_RUN = "not run"

    @property
    def word(self) -> str:
        """The outcome as summaries name it, in the words of pytest."""
        return {Outcome.CONFIRMED: "passed", Outcome.REFUTED: "failed"}.get(self, self.value)


class Aspect(StrEnum):
    """What of a command a claim covers: a column of the coverage matrix."""

    EXAMPLE = "example"
    SHAPE = "shape"
    RANGE = "range"
    BOUNDARY = "boundary"
    STATE = "state"
    MOTION = "motion"


class Refuted(AssertionError):
    """The drive did not do what the claim says.

    `expected` and `got` in words or hex; `exchange` shows it. `key`: a few words by which two failures of one kind are
    known as one.
    """

    def __init__(
        self, text: str, *, expected: str = "", got: str = "", exchange: Evidence | None = None, key: str = ""
    ) -> None:
        super().__init__(text)
        self.text = text
        self.expected = expected
        self.got = got
        self.exchange = exchange
        self.key = key or text
        #: What led there, where the claim was a sequence of steps (`conformance.model.steps`).
        self.steps: tuple[Any, ...] = ()


class Inconclusive(Exception):
    """Nothing can be said, and why."""


class Observed(Exception):
    """The manual leaves it open: what the drive did."""


class NotRun(Exception):
    """The claim cannot run here, and why."""


@dataclass(frozen=True)
class Claim:
    """One thing that the manual says of a drive.

    `id`: dialect, theme and name with slashes, e.g. `mks-rs485/ranges/set_current/above`. `statement`: what holds, as a
    sentence. `check`: takes a probe (`conformance.talk.probe`).
    `section`: of the manual. `certainty`: how sure the reading of the manual is (an erratum's, where one is
    concerned). `refuted_by`: what would refute it. `risks`: what it may send, beside reads. `models`: those that have it;
    empty: all. `alone`: it sends to other addresses than the target's, or changes the link. `by_name`: it wears or wipes
    the drive and runs only when its id is named. `emulated`: it needs to act on the drive itself (block the shaft, close a
    switch, cut power), so it needs an emulated drive. `settings`: fields of settings that it changes (they are put back).
    `covers`: command and aspect pairs. `quirks`: those that it knows, by name. `parameters`: what tells it from its
    siblings. `commands`: those that it is about. `hasty`: if it holds, the drive takes settings without a gap between them.
    `of_line`: it judges the line too, which damages what it carries.
    """

    id: str
    theme: Theme
    dialect: str
    statement: str
    section: str
    refuted_by: str
    check: Callable[[Any], None]
    certainty: Certainty = Certainty.CERTAIN
    risks: frozenset[Risk] = frozenset()
    models: tuple[str, ...] = ()
    alone: bool = False
    by_name: bool = False
    emulated: bool = False
    settings: tuple[str, ...] = ()
    covers: tuple[tuple[str, Aspect], ...] = ()
    fields: tuple[str, ...] = ()
    quirks: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    commands: tuple[str, ...] = ()
    hasty: bool = False
    of_line: bool = False

    def __post_init__(self) -> None:
        if self.id.split("/", 2)[:2] != [self.dialect, self.theme.value]:
            raise ValueError(f"claim id {self.id!r}, expected {self.dialect}/{self.theme.value}/...")
        if not (self.statement and self.refuted_by):
            raise ValueError(f"claim {self.id}: a claim says what holds and what would refute it")


@dataclass(frozen=True)
class Curve:
    """Points (s, value) of something that was followed, and where the manual has it."""

    unit: str
    points: tuple[tuple[float, float], ...]
    expected: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Verdict:
    """The result of a claim on a drive.

    `reason`: why it is inconclusive or did not run, what was observed, or what refuted it. `expected`, `got`: of a
    refutation. `exchange`: the evidence. `traffic`: all bytes on the line. `first_ns`, `last_ns`: on the line's clock.
    `quirks`: names of the quirks shown. `measured`: figures by name (latencies, ramp times);
    `series`: curves by name; `latencies`: command and ns, of its exchanges. `steps`: that led to a refutation.
    `damaged`: something came meanwhile that cannot be read.
    """

    claim: Claim
    outcome: Outcome
    reason: str = ""
    expected: str = ""
    got: str = ""
    key: str = ""
    exchange: Evidence | None = None
    traffic: tuple[Chunk | CanFrame, ...] = ()
    quirks: tuple[str, ...] = ()
    first_ns: int = 0
    last_ns: int = 0
    measured: Mapping[str, float] = field(default_factory=dict)
    series: Mapping[str, Curve] = field(default_factory=dict)
    latencies: tuple[tuple[str, int], ...] = ()
    steps: tuple[Any, ...] = ()
    damaged: bool = False
