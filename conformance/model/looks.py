"""Looks at the drive and its twin (`model.pair`): reads whose replies are compared, between steps and while a motion goes on.

looks.some(first, count)     some of the reads, from one on
looks.on_the_way(frame)      some looks at a motion before its end: how it goes there no place at its end tells
looks.changing()             what tells how a speed changes
looks.meanwhile()            as many as fit into the time for which the next setting has to wait
"""

from __future__ import annotations

from typing import Any

from analyzer.catalogue import Command, Risk, Verb
from conformance.model.pair import Pair
from conformance.model.steps import selectors
from conformance.talk.probe import MS

#: What is left of a motion that is looked at on its way, at least.
WORTH_NS = 60 * MS
#: Reads that fit into the time which a setting has to wait, and the longest that one takes.
_MEANWHILE, _READ_NS = 8, 12 * MS
#: What tells how a speed changes.
_CHANGING = (Verb.READ_STATUS, Verb.READ_SPEED)


class Looks:
    """The reads of a dialect. `reads`: those that need no values."""

    def __init__(self, pair: Pair) -> None:
        self._pair, dialect = pair, pair.dialect
        self.reads = [c for c in dialect.commands if c.all_risks == {Risk.READ} and not c.request_forms[0].layout.named]
        #: All reads with their values, and which comes next while a setting has to wait.
        self._every: list[tuple[Command, dict[str, int]]] = [(c, {}) for c in self.reads]
        self._next = 0
        parameters = dialect.by_verb.get(Verb.READ_PARAMETER)
        if parameters is not None:
            self._every += [(parameters, {"parameter": number}) for number in selectors(dialect)]

    def some(self, first: int, count: int) -> None:
        """Look at some reads, from one on."""
        for number in range(count):
            self._pair.look(self.reads[(first + number) % len(self.reads)])

    def on_the_way(self, frame: int) -> None:
        """Look at a motion before its end is told: as it begins, half-way, and as it ends.

        `frame`: one that changes nothing, sent meanwhile; 0: none.
        """
        pair, probe = self._pair, self._pair.probe
        drive: Any = pair.twin.drive
        left_ns = int(drive.motor.settled) - pair.twin.now_ns - 2 * probe.noise.latency_ns
        if left_ns <= WORTH_NS:
            return
        half_ns = probe.gate.now_ns() + left_ns // 2
        probe.wait(left_ns // 4)
        self.changing()
        if frame:
            pair.send_aside(frame)
        if pair.course.from_rest:
            probe.wait(half_ns - probe.gate.now_ns())
            pair.look(pair.dialect.by_verb[Verb.READ_POSITION])
            probe.wait(half_ns + left_ns // 4 - probe.gate.now_ns())
            self.changing()

    def changing(self) -> None:
        """Look at what tells how the speed changes."""
        for verb in _CHANGING:
            if verb in self._pair.dialect.by_verb:
                self._pair.look(self._pair.dialect.by_verb[verb])

    def meanwhile(self) -> None:
        """Look at some of all reads in the time for which the next setting has to wait, and wait for the rest of it."""
        probe = self._pair.probe
        for _ in range(_MEANWHILE):
            before_ns = probe.gate.line.setting_ns
            if before_ns is None or before_ns + probe.rig.write_gap_ns - probe.gate.now_ns() < _READ_NS:
                break
            command, values = self._every[self._next % len(self._every)]
            self._next += 1
            if command.verb not in self._pair.missing:
                self._pair.look(command, values)
        before_ns = probe.gate.line.setting_ns
        if before_ns is not None:
            probe.wait(before_ns + probe.rig.write_gap_ns - probe.gate.now_ns())
