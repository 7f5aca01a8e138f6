"""A session: one drive, what it was told in steps, and what it should be after each of them.

    session = MksSession(probe)          begins from a known state, whatever the drive was in
    session.do(Step("run_speed", {"direction": 0, "speed": 60, "acceleration": 200}))     raises Refuted where it differs

A session holds a model of the drive: mode, settings, enabled, moving, position. Each step is a request (or two), what the
model says of its answer, and what the model is then; after each step the drive is compared with it. Steps are data, so that
a sequence can be repeated, shortened, stored and read again (`steps_text`, `parse_steps`).

    conformance.model.mks, session_lk    the models     steps_mks, steps_lk    what is drawn     machine    draws it

Rules kept here:
- What the manual leaves open is not modelled: the model asks the drive and goes on from there.
- A step that the model cannot judge (the drive is in a state where nothing is said of it) is not drawn.
- What does not work in a way that another claim judges raises Inconclusive.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Risk
from conformance.claim import Inconclusive, Refuted
from conformance.claims.answers import plain_read
from conformance.gate.drawing import Room
from conformance.gate.gate import Refused as GateRefused
from conformance.motion import motion
from conformance.motion.motion import MS
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy

    from conformance.talk.probe import Probe

#: Right after a move a real shaft may still settle.
SETTLING_NS = 150 * MS
#: How often a line is asked, to tell a drive that says nothing from a line that loses replies.
_SOUND = 6


@dataclass(frozen=True)
class Step:
    """One thing that is done to a drive. `values`: integers as sent, or the amounts of a motion."""

    name: str
    values: Mapping[str, int] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return it as `parse_steps` reads it."""
        return " ".join([self.name, *(f"{n}={v}" for n, v in self.values.items())])


def steps_text(steps: Iterable[Step]) -> str:
    """Return steps as text."""
    return "; ".join(map(str, steps))


def parse_steps(text: str) -> list[Step]:
    """Return the steps of a text that `steps_text` wrote. Raises ValueError for another."""
    steps = []
    for part in filter(None, (p.strip() for p in text.split(";"))):
        name, *pairs = part.split()
        steps.append(Step(name, {n: int(v) for n, _, v in (p.partition("=") for p in pairs)}))
    return steps


@dataclass(frozen=True)
class Kind:
    """A kind of step. `draw`: its values, by what the drive is and what is allowed; `possible`: whether it can be judged now.

    `risks`: what it sends beside reads. Both are given the session of the dialect.
    """

    name: str
    draw: Callable[[Any], SearchStrategy[dict[str, int]]]
    possible: Callable[[Any], bool] = lambda session: True
    risks: frozenset[Risk] = frozenset()


class Session(ABC):
    """One drive and the model of it. `steps`: what was done, `done`: how many. `room`: bounds of motion."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.dialect = probe.dialect
        self.steps: list[Step] = []
        self.done = 0
        self.room = Room(probe.gate.allowance.bounds, probe.gate.allowance.subdivision)
        self.begin()

    @abstractmethod
    def begin(self) -> None:
        """Bring the drive into a known state. Raises Inconclusive where that does not work."""

    @abstractmethod
    def compare(self) -> None:
        """Compare the drive with the model, after each step. Raises Refuted."""

    @abstractmethod
    def end(self) -> None:
        """Leave the motor standing, and the drive as `begin` left it as far as the next session needs it."""

    def do(self, step: Step) -> None:
        """Do a step and compare. Raises Refuted where the drive is not what the model says."""
        self.steps.append(step)
        act: Callable[..., None] = getattr(self, f"_{step.name}")
        try:
            act(**step.values)
        except GateRefused:
            # Bytes of these values could be read as a frame that is not allowed: then this is no step.
            self.steps.pop()
            return
        self.done += 1
        self.compare()

    # --- what models share ----------------------------------------------------------------------------------------

    def differs(self, what: str, expected: Any, got: Any, exchange: Exchange | None = None) -> Refuted:
        """Return what is to be raised where the drive differs from the model after the steps so far."""
        return Refuted(
            f"after {len(self.steps)} steps: {what}", expected=f"{expected}",
            got=f"{got}, after {steps_text(self.steps)}", exchange=exchange, key=f"state: {what}",
        )  # fmt: skip

    def sound(self) -> None:
        """Raise Inconclusive where the line loses replies: then a reply that is missing says nothing of the state."""
        read = plain_read(self.dialect)
        for _ in range(_SOUND):
            self.probe.reply(self.probe.ask(read, quiet_ns=0))

    def standing(self) -> float:
        """Wait until the shaft stands and has settled; return where that is (deg)."""
        motion.wait_standing(self.probe)
        self.probe.wait(SETTLING_NS)
        return motion.position(self.probe).value

    def clean(self, exchange: Exchange) -> Exchange:
        """Return an exchange all of whose answers can be read. Raises Inconclusive where one cannot."""
        for answer in exchange.answers:
            if answer.command is None or answer.message.form is None or not answer.message.frame.checksum_ok:
                raise Inconclusive(f"an answer cannot be read: {answer.data.hex(' ').upper()}")
        if exchange.junk:
            raise Inconclusive(f"what came is no frame: {exchange.junk[0].data.hex(' ').upper()}")
        return exchange
