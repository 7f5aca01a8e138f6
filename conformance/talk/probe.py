"""A probe: how a claim talks to the drive under test.

    exchange = probe.ask("read_speed")
    exchange = probe.ask(Verb.RUN_SPEED, {"speed": 60, "acceleration": 200}, until=Until.DONE)
    exchange = probe.send(bytes.fromhex("FA 01 31 00"))          raw bytes, expecting silence or anything

A probe serves one claim. Its dialogue (`conformance.talk.dialogue`) knows nothing of what other claims asked.

Rules: an emulated drive's time costs nothing, so the waits are long there. On a real line a wait ends after the answer and a
short silence, in which a second reply would show. Writes of settings, as bytes too, keep a distance (`Rig.write_gap_ns`), for
real drives were seen to drop hasty ones. A request without an expected reply first waits until a late second reply to an
earlier setting would have come.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from analyzer import encoder
from analyzer.catalogue import Certainty, Command, Dialect, Form, Risk, Role, Verb
from analyzer.records import CanFrame, Chunk
from conformance.claim import Claim, Curve, Inconclusive, Refuted, Theme
from conformance.gate.gate import Gate
from conformance.talk.dialogue import MS, PAIRED, Dialogue, Ended, Until
from conformance.talk.exchange import Answer, Exchange
from conformance.talk.no_checksum import BareReplies
from conformance.talk.noise import QUIET, Noise
from conformance.talk.reply_match import templates

if TYPE_CHECKING:
    from conformance.drives.drive import Drive

__all__ = ["MS", "SECOND_NS", "Probe", "Rig", "Until", "plain_probe"]

SECOND_NS = 1000 * MS
#: What stands for every known quirk where quirks are accepted.
ALL_QUIRKS = "all"
#: A condition that was not given.
_ANYTHING = object()
#: A drive under test is given longer for a pause inside a frame than a host would give it.
_PAUSE_NS = 30 * MS
#: So long after a setting it may be answered once more, as real drives were seen to do.
_SECOND_REPLY_NS = 30 * MS
#: Risks of what does the same when it is sent once more, those that a setting may have beside, and what does so with others.
_SAME_AGAIN = frozenset({Risk.READ, Risk.SETTING, Risk.TORQUE})
_SET_AGAIN = _SAME_AGAIN | {Risk.POWER_ON, Risk.WEAR, Risk.UNKNOWN}
_ENABLING = (Verb.ENABLE, Verb.MOTOR_ON)
#: Latencies that are kept of one claim.
_KEPT_LATENCIES = 400


_Shown = TypeVar("_Shown")


class Recording(NamedTuple):
    """What one motion showed, and what went over the line for it."""

    shown: Any
    traffic: tuple[Exchange, ...]
    raw: tuple[Chunk | CanFrame, ...]
    latencies: tuple[tuple[str, int], ...]
    first_ns: int
    last_ns: int


class Rig:
    """One drive under test, as a probe needs it: how it is reached, and how long to wait for it.

    `dialect`: as its model speaks it. `allowed`: risks that the user opened. `late_ns`: a reply later than this counts as
    none. `quiet_ns`: how long to listen after an answer for a second one. `silence_ns`: how long nothing must come before it
    is called silence. `done_ns`: how long a command may take to its last reply. `write_gap_ns`: between settings. `accepted`:
    known quirks that the user accepts, by name, or `all`. `own_only`: a reply in the name of another address is none.
    """

    gate: Gate
    emulated: bool = False
    model: str = ""
    seed: int = 0
    allowed: frozenset[Risk] = frozenset(Risk)
    late_ns: int = SECOND_NS
    quiet_ns: int = 30 * MS
    silence_ns: int = 300 * MS
    done_ns: int = 20 * SECOND_NS
    write_gap_ns: int = 500 * MS
    accepted: frozenset[str] = frozenset()
    own_only: bool = False

    def __init__(self, dialect: Dialect, address: int) -> None:
        self.dialect = dialect
        self.address = address
        #: Motions that several claims judge, by what was done.
        self.recordings: dict[Hashable, Recording] = {}
        #: Whether a real drive was heard to answer a plain read once, and no more.
        self.answers_once = False
        #: Names of commands that the drive has answered.
        self.answered: set[str] = set()

    @property
    def byte_ns(self) -> int:
        """Time of a byte on the line."""
        return self.gate.line.byte_ns

    def accepts(self, quirks: Collection[str]) -> bool:
        """Say whether the user accepts all of these quirks."""
        return ALL_QUIRKS in self.accepted or self.accepted.issuperset(quirks)

    @property
    def noise(self) -> Noise:
        """What the run measured of the resting shaft and of the line before it judges."""
        return QUIET

    @property
    def group(self) -> int | None:
        """The group address at which the drive is known to listen, None where none is."""
        return None

    def timeout_ns(self, until: Until) -> int:
        """Return how long to listen by default."""
        return {Until.DONE: self.done_ns, Until.TIMEOUT: self.silence_ns}.get(until, self.late_ns)

    def probe(self, claim: Claim) -> Probe:
        """Return a probe for one claim; an emulated drive is new."""
        return Probe(self, claim)

    def recorder(self, probe: Probe) -> Probe:
        """Return the probe that records a motion for a claim: its own, or one of a new emulated drive."""
        return probe

    def before_send(self, item: bytes | CanFrame) -> None:
        """Take note of what is about to leave; a rig that puts things back looks here at what is changed."""

    def has_lost(self, exchange: Exchange) -> bool:
        """Say whether a command was not answered here that the drive answers at other times."""
        return exchange.unanswered and exchange.command is not None and exchange.command.name in self.answered

    def exchanged(self, exchange: Exchange) -> None:
        """Take note of what came back; a rig whose drive may fall silent looks here for when it did."""

    def stands_at(self, degrees: float) -> None:
        """Take note that a claim saw the shaft stand here, by its position and its speed."""

    def settle(self, probe: Probe) -> str:
        """End a claim: stop what moves, put back what it changed. Return what could not be done, or nothing."""
        return ""


class Probe:
    """The drive under test as one claim sees it."""

    def __init__(self, rig: Rig, claim: Claim, drive: Drive | None = None) -> None:
        self.rig = rig
        self.claim = claim
        self.dialect: Dialect = rig.dialect
        self.address: int = rig.address
        self.gate = rig.gate
        #: The emulated drive itself, for claims that act on it; None for a real one.
        self.drive = drive
        self.traffic: list[Exchange] = []
        #: What went over the line, as it was: sent (direction `request`) and received, in order.
        self.raw: list[Chunk | CanFrame] = []
        self.quirks: list[str] = []
        self.measured: dict[str, float] = {}
        #: Curves by name, as (x, y) points: `speed` in rpm over seconds.
        self.series: dict[str, Curve] = {}
        #: Command and ns from the end of its request to the beginning of its first reply.
        self.latencies: list[tuple[str, int]] = []
        self.first_ns = self.gate.now_ns()
        self._last_ns: int | None = None
        self.noise: Noise = rig.noise
        self._dialogue = Dialogue(
            self.gate,
            (self.dialect,),
            late_ns=rig.late_ns,
            pause_ns=_PAUSE_NS,
            # On CAN a frame may be another drive's or host's; on a serial line only the drive's bytes come back.
            direction=Role.UNKNOWN if self.dialect.bus == "can" else Role.REPLY,
            bare=None if self.noise.checked else BareReplies(self.dialect),
            log=self.raw.append,
            stray=self.noise.stray,
            repeats=self.noise.repeats,
        )

    # --- asking ---------------------------------------------------------------------------------------------------

    def command(self, what: Command | Verb | str) -> Command:
        """Return a command of the dialect by its name or by what it does. Raises KeyError where there is none."""
        if isinstance(what, Command):
            return what
        return self.dialect.by_verb[what] if isinstance(what, Verb) else self.dialect.by_name[what]

    def build(
        self,
        what: Command | Verb | str,
        values: Mapping[str, Any] | None = None,
        *,
        address: int | None = None,
        form: Form | str | None = None,
    ) -> encoder.Built:
        """Return the frame of a request to the drive (or to another address), whether or not the manual allows it."""
        to = self.address if address is None else address
        return encoder.assemble(self.dialect, self.command(what), to, values, form=form)

    def ask(
        self,
        what: Command | Verb | str,
        values: Mapping[str, Any] | None = None,
        *,
        address: int | None = None,
        form: Form | str | None = None,
        until: Until = Until.REPLY,
        timeout_ns: int | None = None,
        quiet_ns: int | None = None,
    ) -> Exchange:
        """Send a request and return what came back.

        `values`: integers as sent. `timeout_ns`: how long to wait for what `until` says; the rig's time by default
        (for DONE, the longest that a move of the suite takes). `quiet_ns`: how long to listen after that for more; the
        rig's time by default, 0 where the next request is to follow at once.
        """
        built = self.build(what, values, address=address, form=form)
        return self.ask_built(built, until=until, timeout_ns=timeout_ns, quiet_ns=quiet_ns)

    def ask_built(
        self, built: encoder.Built, *, until: Until = Until.REPLY, timeout_ns: int | None = None, quiet_ns: int | None = None
    ) -> Exchange:
        """Ask as `ask` does, by a frame that was built already: of values that `build` cannot send (reserved bits)."""
        item = built.item()
        if Risk.SETTING not in built.risks:
            if until is Until.TIMEOUT:
                self._keep_distance(_SECOND_REPLY_NS)
            return self._exchange(item, until, timeout_ns, built, quiet_ns)
        self._keep_distance(self.rig.write_gap_ns)
        exchange = self._exchange(item, until, timeout_ns, built, quiet_ns)
        self._remember_setting(bool(built.values) and not self.refused(exchange))
        return exchange

    def send(
        self,
        item: bytes | CanFrame,
        *,
        until: Until = Until.TIMEOUT,
        timeout_ns: int | None = None,
        quiet_ns: int | None = None,
        at_once: bool = False,
    ) -> Exchange:
        """Send bytes as they are (on CAN a frame) and return what came back; by default for the time of a silence.

        `at_once`: also behind a setting, and if it is one itself.
        """
        writes = any(each.fits and Risk.SETTING in each.risks for each in self.gate.interpret(item))
        if not at_once:
            # A setting may be answered once more, which would break a silence.
            self._keep_distance(max(_SECOND_REPLY_NS, self.rig.write_gap_ns if writes else 0))
        exchange = self._exchange(item, until, timeout_ns, None, quiet_ns)
        if writes:
            self._remember_setting(exchange.reply is not None and not self.refused(exchange))
        return exchange

    def listen(self, duration_ns: int, until: Until = Until.TIMEOUT) -> Exchange:
        """Send nothing and return what comes meanwhile; with `Until.REPLY` to the first frame that comes."""
        return self._exchange(None, until, duration_ns, None, 0)

    def wait(self, duration_ns: int) -> None:
        """Let time pass; what comes meanwhile is kept in the claim's traffic."""
        if duration_ns > 0:
            self.listen(duration_ns)

    def pass_over(self, duration_ns: int) -> None:
        """Let time pass and look at nothing that comes meanwhile, which takes a tenth of the time: where others send much."""
        self.raw += self.gate.wait(duration_ns)

    def _remember_setting(self, taken: bool) -> None:
        # A drive that has taken no value yet wrote nothing: one that refuses them all is not waited for.
        if taken or self.gate.line.setting_ns is not None:
            self.gate.line.setting_ns = self.gate.now_ns()

    def _keep_distance(self, gap_ns: int) -> None:
        """Wait until the last setting is so long past."""
        # By the line, not by the probe: what puts settings back, and the next claim, follow closely.
        before_ns = self.gate.line.setting_ns
        left_ns = 0 if before_ns is None else before_ns + gap_ns - self.gate.now_ns()
        if left_ns > 0:
            self.raw += self.gate.wait(left_ns)

    # --- one motion, judged by several claims ---------------------------------------------------------------------

    @property
    def last_ns(self) -> int:
        """When the claim ended: now, or with the recording that it judges."""
        return self.gate.now_ns() if self._last_ns is None else self._last_ns

    def recorded(self, record: Callable[..., _Shown], *given: Any) -> _Shown:
        """Return what `record(probe, *given)` shows: done for the first claim that asks, kept for those after it.

        A claim that judges a recording does nothing besides. What `record` raises is not kept.
        """
        key = (record.__module__, record.__qualname__, *(getattr(value, "name", value) for value in given))
        known = self.rig.recordings.get(key)
        if known is None:
            recorder = self.rig.recorder(self)
            try:
                shown = record(recorder, *given)
            finally:
                if recorder is not self:
                    self._take_over(recorder.recording())
            known = self.rig.recordings[key] = recorder.recording(shown)
        else:
            self._take_over(known)
        found: _Shown = known.shown
        return found

    def recording(self, shown: Any = None) -> Recording:
        """Return what was sent and received so far, and what it showed."""
        sent = (tuple(self.traffic), tuple(self.raw), tuple(self.latencies))
        return Recording(shown, *sent, self.first_ns, self.gate.now_ns())

    def _take_over(self, known: Recording) -> None:
        """Make what a recording sent and received the claim's own."""
        self.traffic += known.traffic
        self.raw += known.raw
        self.latencies += known.latencies
        self.first_ns, self._last_ns = known.first_ns, known.last_ns

    # --- one exchange ---------------------------------------------------------------------------------------------

    def _exchange(
        self,
        item: bytes | CanFrame | None,
        until: Until,
        timeout_ns: int | None,
        built: encoder.Built | None,
        quiet_ns: int | None = None,
    ) -> Exchange:
        timeout_ns = self.rig.timeout_ns(until) if timeout_ns is None else timeout_ns
        quiet_ns = self.rig.quiet_ns if quiet_ns is None else quiet_ns
        dialogue = self._dialogue
        self._last_ns = None
        if item is None:
            exchange = dialogue.begin(Exchange(None, self.gate.now_ns()))
        else:
            self.rig.before_send(item)
            # Raw bytes are no request that the analyzer could pair replies with.
            exchange = dialogue.send(item, built, shown=built is not None)
        exchange.own_only = self.rig.own_only
        self.traffic.append(exchange)
        awaited = until is not Until.TIMEOUT and built is not None
        exchange.awaited = awaited and exchange.address == self.address
        wrecked = partial(self._wrecked, until is Until.DONE) if awaited else None
        dialogue.collect(exchange, _ENDS[until], timeout_ns, quiet_ns=quiet_ns, wrecked=wrecked)
        if built is not None and exchange.answers and len(self.latencies) < _KEPT_LATENCIES:
            self.latencies.append((built.command.name, exchange.answers[0].latency_ns))
        if built is not None and exchange.answers:
            self.rig.answered.add(built.command.name)
        self.rig.exchanged(exchange)
        return exchange

    def _wrecked(self, to_the_end: bool, exchange: Exchange) -> int:
        """Return for how long nothing must come where what came is as long as the reply and cannot be read, else 0.

        `to_the_end`: the reply that ends a command is waited for, behind one that tells its begin.
        """
        command, address = exchange.command, exchange.address
        assert command is not None  # it was built
        assert address is not None
        shortest = min((len(t.frame) for t in templates(self.dialect, command, address, exchange.values)), default=0)
        wanted = 2 if to_the_end and command.replies.interim else 1
        came = exchange.unread + sum(len(a.data) for a in exchange.answers if exchange.asked_for(a) and a.is_whole)
        return self.noise.silence_ns if exchange.unread >= shortest > 0 and came >= wanted * shortest else 0

    # --- judging --------------------------------------------------------------------------------------------------

    def expect(
        self,
        got: Any,
        *,
        refutes: str,
        holds: bool | None = None,
        equal: Any = _ANYTHING,
        among: Collection[Any] = (),
        near: float | None = None,
        within: float | None = None,
        at_least: float = -math.inf,
        at_most: float = math.inf,
        unit: str = "",
        expected: str = "",
        exchange: Exchange | None = None,
        key: str = "",
    ) -> None:
        """Refute the claim unless what was got is as expected.

        `got`: a number, a measurement (its `value` counts), a list of numbers, or text beside `holds`. One or several
        conditions: `holds` itself, `equal`, `among` several, `near` a number `within` a distance, `at_least`, `at_most`.
        `refutes`: what a drive does that is otherwise, as a sentence without a stop. `expected` says it where the conditions do
        not. `unit`: of a number; the noise that the run measured of it widens `within` and the limits. Where `within` is not
        given, it is the resolution of the unit. `exchange` shows it; the last one where none is given. `key`: what makes two
        failures one; `refutes` by default.

        Raises Refuted.
        """
        value = getattr(got, "value", got)
        conditions = []
        if holds is not None:
            conditions.append((holds, ""))
        if equal is not _ANYTHING:
            conditions.append((value == equal, _text(equal, unit)))
        if among:
            conditions.append((value in among, " or ".join(_text(v, unit) for v in among)))
        if near is not None:
            within = (self.noise.step(unit) if within is None else within) + self.noise.of(unit, near)
            conditions.append((abs(value - near) <= within, f"{_text(near, unit)} +-{within:.3g}"))
        if at_least > -math.inf:
            at_least -= self.noise.of(unit, at_least)
            conditions.append((value >= at_least, f"at least {_text(at_least, unit)}"))
        if at_most < math.inf:
            at_most += self.noise.of(unit, at_most)
            conditions.append((value <= at_most, f"at most {_text(at_most, unit)}"))
        if not conditions:
            raise ValueError(f"{self.claim.id}: expect needs a condition")
        if not all(kept for kept, _ in conditions):
            shown = expected or " and ".join(text for _, text in conditions if text)
            shown_in = exchange or (self.traffic[-1] if self.traffic else None)
            raise Refuted(refutes, expected=shown, got=_text(value, unit), exchange=shown_in, key=key)

    def within(self, unit: str, value: float = 0.0) -> float:
        """Return by how much a value of a unit may differ from another one that it is: the resolution and the noise."""
        return self.noise.step(unit) + self.noise.of(unit, value)

    # --- what claims share ----------------------------------------------------------------------------------------

    def meets(self, quirk: str) -> None:
        """Say that the drive has a quirk that the claim names: it is a deviation, which the user may accept."""
        if quirk not in self.claim.quirks:
            raise ValueError(f"{self.claim.id} does not name the quirk {quirk!r}")
        if quirk not in self.quirks:
            self.quirks.append(quirk)

    def reply(self, exchange: Exchange, *, once_more: bool = True) -> Answer:
        """Return the reply of an exchange that another claim judges. `once_more`: ask again for one that is damaged or lost.

        Raises Inconclusive where there is none, or none that can be read.
        """
        answer = (self.sound(exchange) if once_more else exchange).reply
        asked = exchange.command.name if exchange.command is not None else "the request"
        if answer is None:
            raise Inconclusive(f"{asked} was not answered")
        if answer.command is None or answer.message.form is None or not answer.message.frame.checksum_ok:
            raise Inconclusive(f"the answer to {asked} cannot be read: {answer.data.hex(' ').upper() or 'it has no data'}")
        return answer

    def sound(self, exchange: Exchange) -> Exchange:
        """Return an exchange, or one sent once more whose reply the line damaged or lost: a read, a setting, or enabling.

        A line that damages or loses something is judged once, not by each claim.
        """
        if exchange.again is not None:
            return exchange.again
        answer, command = exchange.reply, exchange.command
        # What came may be no frame any more; a request that came damaged is not answered.
        is_damaged = exchange.damaged and not exchange.is_read and (answer is None or not answer.bare)
        if not (is_damaged or exchange.unanswered) or command is None:
            return exchange
        same = _SET_AGAIN if Risk.SETTING in command.all_risks else _SAME_AGAIN
        if not (command.all_risks <= same or command.verb in _ENABLING) or exchange.address is None:
            return exchange
        built = self.build(command, exchange.values, address=exchange.address)
        if built.item() != exchange.sent:
            return exchange
        what = "damaged replies" if is_damaged else "lost requests"
        self.measured[what] = self.measured.get(what, 0) + 1
        exchange.again = self.ask_built(built)
        return exchange.again

    def read(self, what: Command | Verb | str, name: str = "", values: Mapping[str, Any] | None = None) -> int:
        """Ask and return one field of the reply as sent (the only one, where no name is given).

        Raises Inconclusive where there is no readable reply.
        """
        got = self.reply(self.ask(what, values, quiet_ns=0)).values
        if not name and len(got) == 1:
            return int(next(iter(got.values())))
        if name not in got:
            raise Inconclusive(f"the answer to {self.command(what).name} has no {name or 'single field'}")
        return int(got[name])

    def refused(self, exchange: Exchange) -> bool:
        """Say whether the reply to a request says that it failed, by its status or its form."""
        answer = (exchange.again or exchange).reply
        command = exchange.command or (answer.command if answer is not None else None)
        if command is None or answer is None:
            return False
        failed_form = answer.message.form is not None and answer.message.form.name in command.replies.failed_forms
        return failed_form or answer.values.get(command.replies.status) in command.replies.failed

    def quiet_behind(self, command: Command) -> int | None:
        """Return how long to listen behind the reply of what is not judged itself, as `ask` takes it.

        A short move may be over by then, and the end of some motions is told unasked: the next request would collide with it.
        """
        motion = command.motion
        return None if motion is not None and (motion.tells_end or motion.distance) else 0

    def do(self, what: Command | Verb | str, values: Mapping[str, Any] | None = None) -> Exchange:
        """Ask for something that a claim needs done before it can judge.

        Raises Inconclusive where the drive does not do it.
        """
        exchange = self.ask(what, values, quiet_ns=self.quiet_behind(self.command(what)))
        answer = self.reply(exchange)
        if self.refused(exchange):
            name = self.command(what).name
            raise Inconclusive(f"{name} {dict(exchange.values)} was refused ({answer.data.hex(' ').upper()})")
        return exchange


def _text(value: Any, unit: str) -> str:
    """Return a number with its unit, several numbers with commas between them, or a text as it is."""
    if isinstance(value, float):
        value = f"{value:.6g}"
    elif isinstance(value, list | tuple):
        value = ", ".join(map(str, value)) or "none"
    return f"{value} {unit}".rstrip()


def plain_probe(dialect: Dialect, address: int, gate: Gate, *, alone: bool = False) -> Probe:
    """Return a probe that serves no claim, for what has to talk to a drive besides: stop it, put its settings back.

    `alone`: no other drive is on the line. Without that, a reply in the name of another address is none: another host may
    ask that one meanwhile, and that it stands says nothing of this one.
    """
    rig = Rig(dialect, address)
    rig.gate, rig.own_only = gate, not alone
    name = f"{dialect.name}/{Theme.STATE}/none"
    return Probe(rig, Claim(name, Theme.STATE, dialect.name, "none", "", "nothing", lambda probe: None, Certainty.OPEN))


def _answered(exchange: Exchange, new: Sequence[Answer]) -> bool:
    """Say whether a reply is there; what an earlier command says at its end is none."""
    own = [a for a in new if exchange.may_be_own(a)]
    return any(exchange.command is None or a.command is None or exchange.asked_for(a) for a in own)


def _ended(exchange: Exchange, new: Sequence[Answer]) -> bool:
    """Say whether the command is done or refused, by the meaning of its statuses."""
    command = exchange.command
    if command is None:
        return bool(new)
    replies = command.replies
    for answer in new:
        form = answer.message.form
        status = answer.values.get(replies.status)
        if form is not None and form.name in replies.failed_forms:
            return True
        if status in replies.failed or status in replies.final or not (replies.interim or replies.final):
            return True
    return False


#: Each wait and its end; a reply counts even if it pairs with no request.
_ENDS: Mapping[Until, Ended] = {
    Until.REPLY: _answered,
    Until.READ: PAIRED[Until.READ],
    Until.DONE: _ended,
    Until.TIMEOUT: PAIRED[Until.TIMEOUT],
}
