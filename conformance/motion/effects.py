"""Witnesses: requests whose effect can be seen by a read, so that a claim can tell whether a drive executed them.

    witness = chosen(dialect)
    witness.prepare(probe)
    order = witness.order(probe)         what to send, to whatever address, in whatever frame
    ...
    witness.done(probe, order)           whether the drive has done it

Which one a dialect has: the one that risks least.

    write_user_id     CAN: a number that the drive keeps, read back
    set_position      LK: the present position gets another name, read back
    move              a small, slow move by the encoder, seen in its count
    set_zero          the present position becomes zero: beside the move, for what is no motion

Rules kept here:
- An order always changes what is read: what it asks for is not what is there.
- A claim that shows that something is not executed sends the order to the drive itself at last (`control`): a drive that
  does not execute it then either makes the claim inconclusive, not true.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Dialect, Risk, Verb
from conformance.claim import Inconclusive, Refuted
from conformance.motion import motion

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

_ID_CHANGE = 0x5A5A_5A5A
_LK_STEP = 4_321
_INT32 = 1 << 31
#: How far the witness moves, in counts of 16384 a turn, and how fast (rpm, acceleration as sent).
STEP = 400
_SPEED, _ACCELERATION = 60, 200
#: How long a step takes at most, its ramps and reply with it.
STEP_NS = 2_000_000_000


@dataclass(frozen=True)
class Order:
    """A command and values whose effect can be seen. `before`: what was read; `after`: what is read once it is done."""

    command: Command
    values: dict[str, Any]
    before: int
    after: int


class Witness(ABC):
    """One way to see whether a drive executes. `risks`: what the order and its preparation risk; `settings`: it changes.

    `moves`: the order turns the shaft. `settle_ns`: how long it takes until its effect can be seen.
    """

    moves = False
    settle_ns = 0

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect

    @property
    @abstractmethod
    def risks(self) -> frozenset[Risk]:
        """What is sent beside reads."""

    @property
    @abstractmethod
    def settings(self) -> tuple[str, ...]:
        """Settings that are changed."""

    def prepare(self, probe: Probe) -> None:
        """Make the drive ready. Raises Inconclusive where it refuses."""
        if self.moves:
            motion.ready_to_move(probe)

    @abstractmethod
    def order(self, probe: Probe, times: int = 1) -> Order:
        """Return an order; `times` makes orders that can be told from each other. Raises Inconclusive."""

    @abstractmethod
    def read(self, probe: Probe) -> int:
        """Read what an order changes. Raises Inconclusive."""

    def settle(self, probe: Probe) -> None:
        """Wait until an order that was executed can be seen."""
        probe.wait(self.settle_ns)

    def is_done(self, got: int, order: Order) -> bool:
        """Say whether a reading is what an order leads to."""
        return got == order.after

    def done(self, probe: Probe, order: Order) -> bool:
        """Wait and say whether the drive has done an order.

        Raises Refuted where what is read is neither from before nor from after.
        """
        self.settle(probe)
        got = self.read(probe)
        if self.is_done(got, order):
            return True
        if self.is_done(got, Order(order.command, order.values, order.after, order.before)):
            return False
        raise Refuted(
            f"{order.command.name} has another effect than the one that was asked for",
            expected=f"{order.after} to be read where it is executed, {order.before} where it is not",
            got=str(got),
        )

    def control(self, probe: Probe) -> None:
        """Send an order to the drive itself. Raises Inconclusive where it is not executed."""
        order = self.order(probe)
        probe.do(order.command, order.values)
        self.settle(probe)
        if not self.is_done(self.read(probe), order):
            raise Inconclusive(f"{order.command.name} is not executed when it is sent to the drive itself either")


class _UserId(Witness):
    @property
    def risks(self) -> frozenset[Risk]:
        return self.dialect.by_verb[Verb.WRITE_USER_ID].all_risks

    @property
    def settings(self) -> tuple[str, ...]:
        return ("user_id",)

    def order(self, probe: Probe, times: int = 1) -> Order:
        before = self.read(probe)
        after = before ^ (_ID_CHANGE + times)
        return Order(probe.command(Verb.WRITE_USER_ID), {"user_id": after}, before, after)

    def read(self, probe: Probe) -> int:
        return probe.read(Verb.READ_USER_ID, "user_id")


class _Position(Witness):
    @property
    def _command(self) -> Command:
        return self.dialect.by_name["set_position"]

    @property
    def risks(self) -> frozenset[Risk]:
        return self._command.all_risks

    @property
    def settings(self) -> tuple[str, ...]:
        return ()

    def order(self, probe: Probe, times: int = 1) -> Order:
        before = self.read(probe)
        step = _LK_STEP * times
        after = before + step if before + step < _INT32 else before - step
        if not -_INT32 <= after < _INT32:
            after = step
        return Order(self._command, {"position": after}, before, after)

    def read(self, probe: Probe) -> int:
        return probe.read(Verb.READ_POSITION, "position")

    def is_done(self, got: int, order: Order) -> bool:
        # The shaft may shiver by a hundredth of a degree or two.
        return abs(got - order.after) * 2 < abs(order.after - order.before)


class _Move(Witness):
    moves = True
    settle_ns = STEP_NS

    @property
    def risks(self) -> frozenset[Risk]:
        return motion.risks(self.dialect)

    @property
    def settings(self) -> tuple[str, ...]:
        return motion.settings(self.dialect)

    def order(self, probe: Probe, times: int = 1) -> Order:
        before = self.read(probe)
        values = {"speed": _SPEED, "acceleration": _ACCELERATION, "position": STEP * times}
        return Order(probe.command(Verb.MOVE_RELATIVE_AXIS), values, before, before + STEP * times)

    def read(self, probe: Probe) -> int:
        return probe.read(Verb.READ_POSITION, "position")

    def is_done(self, got: int, order: Order) -> bool:
        return abs(got - order.after) * 4 < STEP


class _Zero(Witness):
    """The position is made zero, from somewhere else."""

    moves = True

    @property
    def risks(self) -> frozenset[Risk]:
        return motion.risks(self.dialect, *self.dialect.by_verb[Verb.SET_ZERO].all_risks)

    @property
    def settings(self) -> tuple[str, ...]:
        return motion.settings(self.dialect)

    def order(self, probe: Probe, times: int = 1) -> Order:
        if abs(self.read(probe)) < STEP:
            away = _Move(self.dialect)
            order = away.order(probe, 2)
            probe.do(order.command, order.values)
            away.settle(probe)
        return Order(probe.command(Verb.SET_ZERO), {}, self.read(probe), 0)

    def read(self, probe: Probe) -> int:
        return probe.read(Verb.READ_POSITION, "position")

    def is_done(self, got: int, order: Order) -> bool:
        return abs(got - order.after) * 4 < STEP


def setting(dialect: Dialect) -> Witness | None:
    """Return a witness that is no motion itself, where the one that is chosen is one; None where there is none."""
    verbs = dialect.by_verb
    zero = verbs.get(Verb.SET_ZERO)
    has_move = Verb.MOVE_RELATIVE_AXIS in verbs and Verb.READ_POSITION in verbs and motion.can_move(dialect)
    if zero is None or Risk.WEAR in zero.all_risks or not has_move or not isinstance(chosen(dialect), _Move):
        return None
    return _Zero(dialect)


def chosen(dialect: Dialect) -> Witness | None:
    """Return the witness of a dialect, None where it has none."""
    verbs = dialect.by_verb
    if Verb.WRITE_USER_ID in verbs and Verb.READ_USER_ID in verbs:
        return _UserId(dialect)
    if "set_position" in dialect.by_name and Verb.READ_POSITION in verbs:
        return _Position(dialect)
    if Verb.MOVE_RELATIVE_AXIS in verbs and Verb.READ_POSITION in verbs and motion.can_move(dialect):
        return _Move(dialect)
    return None
