"""Replay: the requests of a recording, at their times, through the gate; replies are compared with the recorded ones.

    steps -> rehearsal (all judged, nothing sent) -> the gate, step by step -> comparison

Times. Each step has its own time from the start, so delays do not add up. The last part of a wait is spent without sleeping.
On a serial line, where frames can collide, a step waits for replies to the step before: for those that had come by then in the
recording. It waits at most `PATIENCE_NS` longer than they took there.

Permission. A file grants none: all requests are judged before the first byte leaves, and each again as it leaves. When the
replay is interrupted (Ctrl-C, a lost port), moving drives are stopped by a ramp and watched until they stand. At the end of
the recording, a drive that still runs is stopped too. Where the process that owns the port is lost, another stops them.
"""

from __future__ import annotations

import gc
from array import array
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple

from analyzer.catalogue import Command, Dialect, MotionKind, Risk
from analyzer.codec import codec
from analyzer.decoder import slots_of
from analyzer.dialects import drive_name
from analyzer.errors import ServotapError
from conformance.claim import Inconclusive
from conformance.gate.gate import Gate, Judge, Objection, Refused
from conformance.safety.signals import undisturbed
from conformance.safety.stopping import GuardLost, stop
from conformance.talk.dialogue import Dialogue
from conformance.talk.exchange import Answer, Exchange
from conformance.tools.replay_plan import Plan, Reply, Step, reply_of

MS = 1_000_000
#: From the last look at the line to the sending: waited out without sleeping.
SPIN_NS = 300_000
#: How long a step waits for the reply to the one before.
PATIENCE_NS = 100 * MS
#: From the beginning to the first step.
_LEAD_NS = 50 * MS
#: Steps whose replies may still come: a completion comes long after the request.
_OPEN = 256
#: So long after a request, a reply that answers no other is taken for its own.
_OVERTAKEN_NS = 1000 * MS
#: The replay listens this long after the last step, plus the recorded time of its replies.
_TAIL_NS = 300 * MS


# --- rehearsal ----------------------------------------------------------------------------------------------------


@dataclass
class Rehearsal:
    """What of a plan may be sent. `allowed`: the steps, in order; `refused`: an objection for each of the others."""

    allowed: list[Step] = field(default_factory=list)
    refused: list[tuple[Step, Objection]] = field(default_factory=list)

    def by_command(self) -> list[tuple[str, int, Objection]]:
        """Return what is refused by drive and command: name, how often, and the first objection."""
        counts: Counter[str] = Counter()
        first: dict[str, Objection] = {}
        for step, objection in self.refused:
            name = f"{drive_name(step.dialect, step.address)} {step.name}"
            counts[name] += 1
            first.setdefault(name, objection)
        return [(name, count, first[name]) for name, count in counts.most_common()]


def rehearse(judge: Judge, plan: Plan, speed: float) -> Rehearsal:
    """Judge all of a plan, in order and by its times, as if what is refused did not leave; nothing is sent or spent."""
    result = Rehearsal()
    first_ns = plan.steps[0].t_ns if plan.steps else 0
    for step in plan.steps:
        try:
            judge.admit(step.item, int((step.t_ns - first_ns) / speed))
        except Refused as error:
            result.refused.append((step, error.objections[0]))
        else:
            result.allowed.append(step)
    return result


# --- the result ----------------------------------------------------------------------------------------------------


class Match(StrEnum):
    """A request's replies beside those of the recording."""

    SAME = "same bytes"
    VALUES = "other values"
    DIFFERENT = "different"
    MISSING = "missing"
    MORE = "more"
    SILENT = "silent, as then"


#: What of these is a deviation.
DEVIATIONS = frozenset({Match.DIFFERENT, Match.MISSING, Match.MORE})


@dataclass(slots=True)
class SentStep:
    """A step as it was sent. `late_ns`: behind its time; `held`: it waited for a reply."""

    step: Step
    exchange: Exchange
    late_ns: int
    held: bool
    replies: list[Reply] = field(default_factory=list)

    @property
    def match(self) -> Match:
        """The replies beside those of the recording."""
        return compare(self.step.replies, self.replies)


@dataclass
class Result:
    """What a replay did.

    `matches`: by command and match, how often; `examples`: the first deviation of each kind of them; `late_ns`: of the steps
    that nothing held back. `stopped`: why it did not go to its end, or nothing; `left_moving`: drives that are not known to
    stand, and why. `junk`, `others`: pieces that were no frame, and frames that answered no step.
    """

    sent: int = 0
    held: int = 0
    matches: Counter[tuple[str, Match]] = field(default_factory=Counter)
    examples: dict[tuple[str, Match], SentStep] = field(default_factory=dict)
    late_ns: array[int] = field(default_factory=lambda: array("q"))
    stopped: str = ""
    left_moving: list[str] = field(default_factory=list)
    junk: int = 0
    others: int = 0

    @property
    def deviations(self) -> int:
        """Requests that were answered otherwise than then."""
        return sum(count for (_, match), count in self.matches.items() if match in DEVIATIONS)

    def lateness_ns(self, share: float) -> int:
        """Return how late the steps left that nothing held back: the value that this share of them does not exceed."""
        late = sorted(self.late_ns)
        return late[min(len(late) - 1, int(share * len(late)))] if late else 0

    def settle(self, sent: SentStep) -> None:
        """Count a step whose replies have come."""
        key = (sent.step.name, sent.match)
        self.matches[key] += 1
        if sent.match in DEVIATIONS:
            self.examples.setdefault(key, sent)


def compare(then: Sequence[Reply], now: Sequence[Reply]) -> Match:
    """Compare the replies to a request: commands, forms and statuses have to be the same; what is read may differ."""
    if not then and not now:
        return Match.SILENT
    if len(now) < len(then):
        return Match.MISSING
    if len(now) > len(then):
        return Match.MORE
    if [t.kind for t in then] != [t.kind for t in now]:
        return Match.DIFFERENT
    if all(a.data == b.data for a, b in zip(then, now, strict=True)):
        return Match.SAME
    return Match.VALUES if all(t.reads or t.status is None for t in now) else Match.SAME


# --- sending ------------------------------------------------------------------------------------------------------


class Replay:
    """Sends the steps of a plan on a gate.

    `speed`: 2 is twice as fast as it was recorded. `reopen`: makes another gate, where the process behind this one is lost.
    """

    def __init__(
        self, gate: Gate, dialects: Sequence[Dialect], *, speed: float = 1.0, reopen: Callable[[], Gate] | None = None
    ) -> None:
        self.gate = gate
        self._reopen = reopen
        self.result = Result()
        self._speed = speed
        self._serial = not gate.line.is_can
        self._spin_ns = 0 if gate.line.emulated else SPIN_NS
        self._dialogue = Dialogue(gate, dialects)
        self._exchange = self._dialogue.begin(Exchange(None, gate.now_ns()))
        #: The step before, when it was due and sent, and how many bytes have come since.
        self._before: Step | None = None
        self._before_due_ns = self._before_sent_ns = self._came = 0
        self._open: deque[SentStep] = deque()
        #: Drives that were set in motion and not stopped since.
        self.moving: dict[tuple[str, int], _Moving] = {}

    def run(
        self, steps: Sequence[Step], period_ns: int = 0, loops: int = 1, advance: Callable[[SentStep], None] | None = None
    ) -> Result:
        """Send the steps, `loops` times (0: until Ctrl-C), each time `period_ns` after the last; return the result.

        What it sets in motion is stopped if it ends early. Raises nothing for Ctrl-C, a lost port or a refusal: the result
        says so.
        """
        if not steps:
            return self.result
        gc.collect()
        gc.freeze()
        gc.disable()
        try:
            self._run(steps, period_ns, loops, advance)
            # What runs on without an end does so in the recording too, but there a person or a program watched it.
            self.stop(only_runs=True)
        except (KeyboardInterrupt, ServotapError, Inconclusive) as error:
            self.result.stopped = "Ctrl-C" if isinstance(error, KeyboardInterrupt) else str(error)
            with undisturbed():
                self.stop()
        finally:
            gc.enable()
            gc.unfreeze()
        while self._open:
            self.result.settle(self._open.popleft())
        return self.result

    def _run(self, steps: Sequence[Step], period_ns: int, loops: int, advance: Callable[[SentStep], None] | None) -> None:
        start_ns = self.gate.now_ns() + _LEAD_NS
        first_ns = steps[0].t_ns
        number = 0
        while not loops or number < loops:
            for step in steps:
                due_ns = start_ns + int((number * period_ns + step.t_ns - first_ns) / self._speed)
                sent = self._send(step, due_ns)
                if advance is not None:
                    advance(sent)
            number += 1
        # What tells the end of a motion may come long after the last request.
        left_ns = max(s.t_ns + s.reply_ns for s in steps) - steps[-1].t_ns
        self._listen(self.gate.now_ns() + max(0, left_ns) + _TAIL_NS)
        self._dialogue.finish()
        self._sort()

    def _send(self, step: Step, due_ns: int) -> SentStep:
        gate = self.gate
        self._listen(due_ns - self._spin_ns)
        held = self._hold(due_ns)
        while gate.now_ns() < due_ns:
            if not self._spin_ns:
                self._listen(due_ns)
        late_ns = gate.now_ns() - due_ns
        if late_ns > SPIN_NS:
            # What came before a request does not answer it.
            self._read_waiting()
        # What it sets in motion is known before it leaves: a signal can break in while it does, and the motor turns then.
        before = dict(self.moving)
        self._watch(step, moves=True)
        try:
            exchange = self._exchange = self._dialogue.send(step.item)
        except Refused:
            self.moving = before
            raise
        self._watch(step, moves=False)
        sent = SentStep(step, exchange, late_ns, held)
        result = self.result
        result.sent += 1
        result.held += held
        if not held:
            result.late_ns.append(late_ns)
        self._open.append(sent)
        if len(self._open) > _OPEN:
            result.settle(self._open.popleft())
        self._before, self._before_due_ns, self._before_sent_ns, self._came = step, due_ns, exchange.sent_ns, 0
        return sent

    def _hold(self, due_ns: int) -> bool:
        """Wait for the reply to the step before, where one is due; say whether that made this step late.

        Further replies are waited for, too, where they had come by then: a completion that this step runs into is lost.
        """
        before = self._before
        if not self._serial or before is None or not before.replies:
            return False
        last_ns = int(before.reply_ns / self._speed)
        every = last_ns <= due_ns - self._before_due_ns
        size = sum(len(reply.data) for reply in before.replies) if every else len(before.replies[0].data)
        until_ns = self._before_sent_ns + PATIENCE_NS + (last_ns if every else 0)
        while self._came < size and self.gate.now_ns() < until_ns:
            self._receive(until_ns)
        if self._came < size:
            self._read_waiting()
        self._before = None
        return self.gate.now_ns() > due_ns

    def _listen(self, until_ns: int) -> None:
        while self.gate.now_ns() < until_ns:
            self._receive(until_ns)

    def _read_waiting(self) -> None:
        self._dialogue.read_waiting()
        self._sort()

    def _receive(self, until_ns: int) -> None:
        got = self._dialogue.receive(until_ns)
        if got is not None:
            self._came += len(got.data)
        self._sort()

    def _sort(self) -> None:
        """Give replies to the steps that they answer, which may be earlier ones."""
        exchange = self._exchange
        for answer in exchange.answers:
            sequence = answer.entry.request_sequence
            sent = next((s for s in reversed(self._open) if any(r.sequence == sequence for r in s.exchange.requests)), None)
            sent = sent or self._overtaken(answer)
            if sent is None:
                self.result.others += 1
            else:
                sent.replies.append(reply_of(answer.message))
        self.result.junk += len(exchange.junk)
        exchange.answers, exchange.junk = [], []

    def _overtaken(self, answer: Answer) -> SentStep | None:
        """Return the oldest step that lacks such a reply: where the next request overtook it, it is late and not missing."""
        reply = reply_of(answer.message)
        for sent in self._open:
            lacks = len(sent.replies) < len(sent.step.replies) and sent.step.replies[len(sent.replies)].kind == reply.kind
            recent = answer.last_ns - sent.exchange.sent_ns <= _OVERTAKEN_NS
            if lacks and recent and sent.step.address == answer.message.address:
                return sent
        return None

    # --- what moves -----------------------------------------------------------------------------------------------

    def _watch(self, step: Step, *, moves: bool) -> None:
        """Remember what a step sets in motion (`moves`), or forget what it stops."""
        for address, command, values in meant(step):
            kind = None if command is None or command.motion is None else command.motion.kind
            if kind is MotionKind.STOP:
                if not moves:
                    self.moving.pop((step.dialect.name, address), None)
            elif moves and command is not None and command.moves and kind is not MotionKind.HOLD:
                self.moving[step.dialect.name, address] = _Moving(step.dialect, Risk.UNBOUNDED in command.risks(values))

    def stop(self, *, only_runs: bool = False) -> None:
        """Stop by a ramp what was set in motion, and look until it stands. `only_runs`: what would run on for ever."""
        for (name, address), moving in list(self.moving.items()):
            if only_runs and not moving.for_ever:
                continue
            said = self._stop(moving.dialect, address)
            if said:
                self.result.left_moving.append(f"{drive_name(moving.dialect, address)}: {said}")
            # Not before: where a signal breaks into a stop, it is stopped once more.
            del self.moving[name, address]

    def _stop(self, dialect: Dialect, address: int) -> str:
        try:
            try:
                return stop(self.gate, dialect, address).failure
            except GuardLost:
                if self._reopen is None:
                    raise
                self.gate = self._reopen()
                return stop(self.gate, dialect, address).failure
        except ServotapError as error:
            return str(error)


def meant(step: Step) -> list[tuple[int, Command | None, Mapping[str, Any]]]:
    """Return what a step tells whom: address, command and values as sent; of a package each slot."""
    command = step.message.command
    if command is None or command.slots is None:
        return [(step.address, command, step.message.values)]
    slots = slots_of(step.dialect, command, step.message.data)
    return [(s.address, s.command, codec(s.form.layout).wire(s.data) if s.form else {}) for s in slots]


class _Moving(NamedTuple):
    """A drive that was set in motion. `for_ever`: it goes on until it is stopped."""

    dialect: Dialect
    for_ever: bool
