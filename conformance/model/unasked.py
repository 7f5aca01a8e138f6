"""What the drive of a walk (`model.walk`) and its twin say of the ends of motions, which is told unasked.

    unasked.expect(told)            the twin said it
    unasked.missing()               of how many the drive has not said yet
    unasked.taken(left)             what both said since the shaft stood last; from then on it begins anew

Rules kept here:
- A slow drive may tell the begin of a motion behind its end: the order says nothing.
- What the line damaged may have said what is missing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from conformance.claim import Inconclusive
from conformance.model.twin import Told
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: How late a reply to a motion may come.
_SLOW_REPLY_NS = 250_000_000
#: The code of a command, and the status that was told of it.
_Said = tuple[int, int]


class Unasked:
    """The statuses of motions that were said since the shaft stood last."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        #: The codes whose statuses are compared when the shaft has come to rest.
        self.codes = {c.code for c in probe.dialect.commands if c.motion is not None and c.motion.tells_end}
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._expected: list[_Said] = []
        self._since = len(self._probe.traffic)

    def expect(self, told: Iterable[Told]) -> None:
        """Take what the twin says: the drive has to say it too."""
        self._expected += self._of((each.command.code, each.values) for each in told)

    def missing(self) -> int:
        """Return how many statuses fewer than its twin the drive has said."""
        return len(self._expected) - len(self._said())

    def taken(self, left: int) -> tuple[str, str] | None:
        """Return what should have been said and what was, where they differ, and begin anew.

        `left`: the code of a motion that was left to itself, which may have ended just when the next command came. Raises
        Inconclusive where replies are too late to tell.
        """
        said, expected, traffic = sorted(self._said()), sorted(self._expected), self._traffic
        lost = (Counter(expected) - Counter(said)).total()
        if lost and lost <= sum(len(e.junk) + sum(not a.message.frame.checksum_ok for a in e.answers) for e in traffic):
            said = sorted((Counter(said) | Counter(expected)).elements())
        self.forget()
        if said != expected:
            said, expected = ([each for each in told if each[0] != left] for told in (said, expected))
        if said == expected:
            return None
        if any(a.latency_ns > _SLOW_REPLY_NS for e in traffic if e.sent for a in e.answers[:1]):
            raise Inconclusive("replies during motion are so late that their order says nothing")
        return _text(expected), _text(said)

    @property
    def _traffic(self) -> list[Exchange]:
        return self._probe.traffic[self._since :]

    def _said(self) -> list[_Said]:
        answers = (a for exchange in self._traffic for a in exchange.answers if a.message.frame.checksum_ok)
        return self._of((a.command.code, a.values) for a in answers if a.command is not None)

    def _of(self, told: Iterable[tuple[int, Mapping[str, Any]]]) -> list[_Said]:
        return [(code, values["status"]) for code, values in told if code in self.codes and "status" in values]


def _text(said: list[_Said]) -> str:
    return ", ".join(f"{code:02X} {status}" for code, status in said) or "nothing"
