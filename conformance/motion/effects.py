"""Observable effects: requests whose effect a read shows, so that a claim can tell whether a drive executed them.

    effect = observable(dialect)
    effect.prepare(probe)
    change = effect.change(probe)        what to send, to any address, in any frame
    ...
    effect.done(probe, change)           whether the drive has done it

A dialect has the one with the least risk:

    write_user_id     CAN: a number that the drive keeps, read back
    set_position      LK: the present position gets another name, read back
    move              a small, slow move by the encoder, seen in its count

Rules kept here:
- A change always changes what is read: what it asks for is not what is there.
- A claim that shows that something is not executed sends a change to the drive itself at last (`control`): a drive that
  does not execute it then either makes the claim inconclusive, not true.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Dialect, Verb
from conformance.claim import Inconclusive, Refuted
from conformance.motion import declared, motion

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

_ID_CHANGE = 0x5A5A_5A5A
_LK_STEP = 4_321
_INT32 = 1 << 31
#: How far the small move goes, in counts of 16384 a turn, and how fast (rpm, acceleration as sent).
STEP = 400
_SPEED, _ACCELERATION = 60, 248
#: How long a step takes at most, its ramps and reply with it: by the law 50 ms.
STEP_NS = 150_000_000


@dataclass(frozen=True)
class Change:
    """A command and values whose effect can be seen. `before`: what was read; `after`: what is read once it is done."""

    command: Command
    values: dict[str, Any]
    before: int
    after: int

    @property
    def undone(self) -> Change:
        """The change that leads to where nothing was done."""
        return Change(self.command, self.values, self.after, self.before)


class Observable(ABC):
    """A command whose effect a read shows.

    `risks`: what it and its preparation send beside reads; `settings`: what they change. `moves`: it turns the shaft.
    `settle_ns`: how long it takes until its effect can be seen.
    """

    moves = False
    settle_ns = 0
    settings: tuple[str, ...] = ()

    def __init__(self, dialect: Dialect, command: Command, reads: Verb, field: str) -> None:
        self.command = command
        self.risks = command.all_risks
        self._dialect, self._reads, self._field = dialect, reads, field

    def prepare(self, probe: Probe) -> None:
        """Make the drive ready. Raises Inconclusive where it refuses."""
        if self.moves:
            motion.ready_to_move(probe)

    @abstractmethod
    def change(self, probe: Probe, times: int = 1) -> Change:
        """Return a change; `times` makes changes that can be told from each other. Raises Inconclusive."""

    def is_done(self, got: int, change: Change) -> bool:
        """Say whether a reading is what a change leads to."""
        return got == change.after

    def read(self, probe: Probe) -> int:
        """Read what is changed. Raises Inconclusive."""
        return probe.read(self._reads, self._field)

    def settle(self, probe: Probe) -> None:
        """Wait until a change that was executed can be seen."""
        probe.wait(self.settle_ns)

    def done(self, probe: Probe, change: Change) -> bool:
        """Say whether the drive has done a change that was sent `settle_ns` ago.

        Raises Refuted where what is read is neither from before nor from after.
        """
        got = self.read(probe)
        if self.is_done(got, change):
            return True
        if self.is_done(got, change.undone):
            return False
        raise Refuted(
            f"{change.command.name} has another effect than was asked for",
            expected=f"{change.after} to be read where it is executed, {change.before} where it is not",
            got=str(got),
        )

    def control(self, probe: Probe) -> None:
        """Send a change to the drive itself. Raises Inconclusive where it is not executed."""
        change = self.change(probe)
        probe.do(change.command, change.values)
        self.settle(probe)
        if not self.is_done(self.read(probe), change):
            raise Inconclusive(f"{change.command.name} is not executed when it is sent to the drive itself either")


class _UserId(Observable):
    settings = ("user_id",)

    def change(self, probe: Probe, times: int = 1) -> Change:
        before = self.read(probe)
        after = before ^ (_ID_CHANGE + times)
        return Change(self.command, {"user_id": after}, before, after)


class _Position(Observable):
    def change(self, probe: Probe, times: int = 1) -> Change:
        before = self.read(probe)
        step = _LK_STEP * times
        after = before + step if before + step < _INT32 else before - step
        if not -_INT32 <= after < _INT32:
            after = step
        return Change(self.command, {"position": after}, before, after)

    def is_done(self, got: int, change: Change) -> bool:
        # The shaft may shiver by a hundredth of a degree or two.
        return abs(got - change.after) * 2 < abs(change.after - change.before)


class _Move(Observable):
    moves = True
    settle_ns = STEP_NS

    def __init__(self, dialect: Dialect, command: Command, reads: Verb, field: str) -> None:
        super().__init__(dialect, command, reads, field)
        self.risks = declared.risks(dialect, *self.risks)
        self.settings = declared.settings(dialect)

    def change(self, probe: Probe, times: int = 1) -> Change:
        before = self.read(probe)
        values = {"speed": _SPEED, "acceleration": _ACCELERATION, "position": STEP * times}
        command = self._dialect.by_verb[Verb.MOVE_RELATIVE_AXIS]
        return Change(command, values, before, before + STEP * times)

    def is_done(self, got: int, change: Change) -> bool:
        return abs(got - change.after) * 4 < STEP


def _can_step(dialect: Dialect) -> bool:
    verbs = dialect.by_verb
    return Verb.MOVE_RELATIVE_AXIS in verbs and Verb.READ_POSITION in verbs and declared.can_move(dialect)


def observable(dialect: Dialect) -> Observable | None:
    """Return the observable effect of a dialect that risks least, None where it has none."""
    verbs, named = dialect.by_verb, dialect.by_name
    if Verb.WRITE_USER_ID in verbs and Verb.READ_USER_ID in verbs:
        return _UserId(dialect, verbs[Verb.WRITE_USER_ID], Verb.READ_USER_ID, "user_id")
    if "set_position" in named and Verb.READ_POSITION in verbs:
        return _Position(dialect, named["set_position"], Verb.READ_POSITION, "position")
    if _can_step(dialect):
        return _Move(dialect, verbs[Verb.MOVE_RELATIVE_AXIS], Verb.READ_POSITION, "position")
    return None
