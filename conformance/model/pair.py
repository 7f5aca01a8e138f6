"""The two drives of a walk (`model.walk`), the one under test and its twin: the same is sent to both, and replies are compared.

    pair = Pair(probe)
    pair.look(command)                        a read of both; raises Refuted where the replies differ
    answer, told = pair.ask(command)          a read of both, not compared
    pair.send_aside(number)                   a frame to both that changes nothing
    pair.anchor()                             from now on the clock of the twin is that of the line

Rules kept here:
- Whether there is a reply must be the same, beside what `model.comparing` compares in it.
- A read that the line lost or damaged is asked again. A number that differs is read again when the shaft surely rests.
- A twin that has a known quirk may explain a reply. It is the twin from then on: other claims name the quirk.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analyzer.catalogue import Command, Risk, Verb
from conformance.claim import Inconclusive, NotRun, Refuted
from conformance.gate.gate import Item
from conformance.gate.gate import Refused as GateRefused
from conformance.model.asides import Aside, aside
from conformance.model.comparing import Comparing, Course
from conformance.model.steps import LOOK, Step, steps_text
from conformance.model.twin import Told, Twin
from conformance.model.unasked import Unasked
from conformance.talk.exchange import Answer, Exchange
from conformance.talk.probe import MS, Probe, Until

#: When a number or a flag that differs is asked again: some drives tell late that they stand.
_AGAIN_NS, _AT_ONCE_NS = (200 * MS, 1_200 * MS), (0, 20 * MS)
#: How often a read is asked for at most.
_ASKED = 4
#: How long nothing is sent behind a frame without a reply.
_APART_NS = 6 * MS


class Pair:
    """A drive under test and its twin. `steps`: what was done to them."""

    def __init__(self, probe: Probe) -> None:
        self.probe, self.dialect = probe, probe.dialect
        self.steps: list[Step] = []
        self.course = Course()
        self.comparing = Comparing(probe, self.course)
        self.unasked = Unasked(probe)
        #: Whether the line lost or damaged something.
        self.lossy = False
        #: What the drive does not answer, which other claims judge: it is not sent.
        self.missing: set[Verb] = set()
        self.twin = Twin(self.dialect, probe.address, probe.rig.model or self.dialect.model)
        self._shift_ns = self.twin.now_ns - probe.gate.now_ns()
        #: Steps that do nothing.
        self._looks = {LOOK, *(command.name for command in self.dialect.commands if command.all_risks == {Risk.READ})}

    # --- their clocks -------------------------------------------------------------------------------------------------

    def twin_ns(self, t_ns: int) -> int:
        """Return a time of the line on the clock of the twin."""
        return t_ns + self._shift_ns

    def anchor(self) -> None:
        """Take it that both drives are now at the same time."""
        self._shift_ns = max(self._shift_ns, self.twin.now_ns - self.probe.gate.now_ns())

    def catch_up(self) -> None:
        """Let the twin be where time is."""
        self.unasked.expect(self.twin.wait(self.twin_ns(self.probe.gate.now_ns())))

    # --- asking -------------------------------------------------------------------------------------------------------

    def ask(self, command: Command, values: Mapping[str, int] | None = None) -> tuple[Answer | None, Told | None]:
        """Ask both for a read; return the replies, None for one that did not come or cannot be read."""
        for asked in range(1, _ASKED + 1):
            exchange = self.probe.ask(command, values, quiet_ns=0)
            # One reply may be lost; what the line damages tells nothing.
            if exchange.is_read or (asked > 1 and not exchange.damaged):
                break
            self.lossy = True
        assert exchange.sent is not None
        told = self.twin.hear(exchange.sent, self.twin_ns(exchange.sent_ns))
        return exchange.reply if exchange.is_read else None, self._reply_of_twin(command, told)

    def _reply_of_twin(self, command: Command, told: list[Told]) -> Told | None:
        self.unasked.expect(told)
        return next((t for t in told if t.command.name == command.name), None)

    @property
    def group(self) -> int | None:
        """The group that both drives are in."""
        return self.twin.drive.settings.get(self.twin.drive.group_setting)

    def send_aside(self, number: int) -> None:
        """Send a frame that changes nothing; what the drive makes of it shows in what is read next."""
        try:
            item = aside(self.probe, number, self.group)
            if number == Aside.UNKNOWN_CODE:
                self.send_beside(item, until=Until.REPLY, timeout_ns=self.probe.noise.silence_ns)
            else:
                self.send_beside(item)
        except (GateRefused, NotRun):
            return

    def send_beside(self, item: Item, **how: Any) -> None:
        """Send a frame of which nothing comes. Raises Refused."""
        exchange = self.probe.send(item, **{"timeout_ns": _APART_NS, **how})
        self.unasked.expect(self.twin.hear(item, self.twin_ns(exchange.sent_ns)))

    # --- comparing ----------------------------------------------------------------------------------------------------

    def look(self, command: Command, values: Mapping[str, int] | None = None) -> None:
        """Ask a read and compare. Raises Refuted."""
        answer, told = self.ask(command, values)
        if answer is None or told is None:
            if (answer is None) != (told is None):
                self._refute_silence(command, answer)
            return
        different = self.different(command, answer, told)
        if not different:
            return
        # A shaft that turns is elsewhere later on, where its place may be the right one again.
        at_once = self._changing and self.comparing.only_passing(command, different)
        for wait_ns in _AT_ONCE_NS if at_once else _AGAIN_NS:
            self.probe.wait(wait_ns)
            answer, told = self.ask(command, values)
            different = self.different(command, answer, told) if answer is not None and told is not None else []
            if answer is None or told is None or not different:
                return
        # A flag that was still another one at the end of a motion is no quirk: only what stays is.
        if not self.explained(command, answer, different):
            self.refute_read(command, answer, told, different)

    @property
    def _changing(self) -> bool:
        """Whether the shaft turns, at a speed that changes, or to a place."""
        course = self.course
        return self.dialect.ramp is not None and self.twin.turning and (not course.running or course.rising)

    def compare_reply(self, command: Command, exchange: Exchange, told: list[Told]) -> None:
        """Compare what came back to a command that is no read. Raises Refuted, Inconclusive."""
        first = exchange.reply
        # A stop has the code of its motion: whose status it is the analyzer may leave open.
        alike = first is not None and first.is_whole and first.command is not None and first.command.code == command.code
        reply, wanted = first if exchange.is_read or alike else None, self._reply_of_twin(command, told)
        if (reply is None) != (wanted is None):
            if exchange.damaged:
                # What the drive did shows in what is read next.
                return
            if exchange.reply is not None and reply is None:
                raise Inconclusive(f"the reply to {command.name} cannot be read")
            if reply is None:
                more = self.probe.listen(self.probe.rig.late_ns, Until.REPLY)
                if more.answers or more.junk:
                    raise Inconclusive(f"the reply to {command.name} is late")
            self._refute_silence(command, reply, exchange)
        elif reply is not None and wanted is not None and command.code not in self.unasked.codes:
            away = self.different(command, reply, wanted)
            if away and not self.explained(command, reply, away):
                self.refute_read(command, reply, wanted, away, exchange)

    def different(self, command: Command, answer: Answer, told: Told, spare: float = 0.0) -> list[str]:
        """Return the fields in which a reply differs from that of the twin. `spare`: degrees that a place may be off beside."""
        return self.comparing.different(command, answer, told, self.twin, spare)

    def explained(self, command: Command, answer: Answer, different: list[str]) -> bool:
        """Say whether a known quirk, which other claims name, explains a reply; the twin has it from now on."""
        exchange = self.probe.traffic[-1]
        assert exchange.sent is not None
        for other in self.twin.with_quirks():
            told = next((t for t in other.hear(exchange.sent, self.twin.now_ns) if t.command.name == command.name), None)
            if told is not None and not set(self.comparing.different(command, answer, told, other)) & set(different):
                self.twin = other
                return True
        return False

    # --- refuting -----------------------------------------------------------------------------------------------------

    def _refute_silence(self, command: Command, answer: Answer | None, exchange: Exchange | None = None) -> None:
        expected, got = ("silence", "a reply") if answer is not None else ("a reply", "silence")
        self.refute(f"{command.name} is {'' if answer is not None else 'not '}answered", expected, got, exchange)

    def refute_read(
        self, command: Command, answer: Answer, told: Told, different: list[str], exchange: Exchange | None = None
    ) -> None:
        """Raise Refuted for fields of a reply that differ."""

        def text(values: Mapping[str, Any], data: bytes) -> str:
            shown = ", ".join(f"{n} {values[n]}" for n in different if n in values)
            return f"{shown or 'another reply'} ({data.hex(' ').upper()})"

        what = f"{command.name}: {' and '.join(different)}"
        self.refute(what, text(told.values, told.data), text(answer.values, answer.data), exchange, command)

    def refute(
        self, what: str, expected: str, got: str, exchange: Exchange | None = None, command: Command | None = None
    ) -> None:
        """Raise Refuted, with the steps that led there."""
        raise Refuted(
            f"after {len(self.steps)} steps: {what}",
            expected=f"{expected}{f', by {command.section}' if command else ''}",
            got=f"{got}, after {steps_text(self.steps)}",
            exchange=exchange or (self.probe.traffic[-1] if self.probe.traffic else None),
            key=f"state: {what} after {next((s.name for s in reversed(self.steps) if s.name not in self._looks), 'nothing')}",
        )
