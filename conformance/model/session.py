"""A session: one drive, the steps sent to it, and a model of its state after each step.

    session = MksSession(probe)          sets up a known state first
    session.do(Step("run_speed", {"direction": 0, "speed": 60, "acceleration": 200}))     raises Refuted where it differs

Each step is a request (or two), the answer that the model expects, and the next state of the model. Then the drive is
compared with the model. Steps are data, so that a sequence can be repeated, shortened, stored and read again (`steps_text`,
`parse_steps`). The methods marked `@step` are the kinds of steps that `machine` can draw.

Rules kept here:
- Where the manual leaves something open, the model asks the drive and goes on from there.
- A step with an unpredictable result is not drawn.
- A failure that another claim judges raises Inconclusive.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from analyzer.catalogue import Risk
from conformance.claim import Inconclusive
from conformance.gate.bounds import Leeway
from conformance.gate.gate import Refused as GateRefused
from conformance.motion import motion
from conformance.motion.motion import MS
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: Right after a move a real shaft may still settle.
SETTLING_NS = 150 * MS
#: Risks of kinds of steps.
MOVING, UNBOUNDED = frozenset({Risk.MOTION}), frozenset({Risk.MOTION, Risk.UNBOUNDED})
SETTING, TORQUE = frozenset({Risk.SETTING}), frozenset({Risk.TORQUE})


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


# --- kinds of steps ---------------------------------------------------------------------------------------------------

Values = SearchStrategy[dict[str, int]]
#: By the session: a strategy of each value, or of all together.
Draw = Callable[[Any], Values | Mapping[str, SearchStrategy[int]]]
_Act = TypeVar("_Act", bound=Callable[..., None])


@dataclass(frozen=True)
class StepKind:
    """A kind of step: what does it, how its values are drawn, and whether it can be judged now, by the session.

    `risks`: of what it sends, beside reads.
    """

    name: str
    act: Callable[..., None]
    draw: Draw
    possible: Callable[[Any], bool]
    risks: frozenset[Risk]

    def values(self, session: Session) -> Values:
        """Return the strategy of the values."""
        drawn = self.draw(session)
        return drawn if isinstance(drawn, SearchStrategy) else st.fixed_dictionaries(dict(drawn))


def step(
    draw: Draw = lambda session: st.just({}),
    *,
    possible: Callable[[Any], bool] = lambda session: True,
    risks: frozenset[Risk] = frozenset(),
    name: str = "",
) -> Callable[[_Act], _Act]:
    """Declare a method of a session as a kind of step, by its own name or another."""

    def declared(act: _Act) -> _Act:
        act.__dict__.setdefault("kinds", []).append(StepKind(name or act.__name__, act, draw, possible, risks))
        return act

    return declared


def up_to(units: int) -> SearchStrategy[int]:
    """Draw a distance in either direction, an eighth of the longest at least."""
    return st.one_of(st.integers(units // 8, units), st.integers(-units, -units // 8))


class Session(ABC):
    """One drive and the model of it. `steps`: what was done, `done`: how many. `leeway`: bounds of motion.

    `running`: rpm of the shaft, signed; `at`: where it stands, in the unit of the drive's reads, None while that is not known.
    `KINDS`: kinds of steps by name. `VARIANTS`: the names of those that each variant draws, twice as often where a name
    stands twice.
    """

    KINDS: ClassVar[Mapping[str, StepKind]] = {}
    VARIANTS: ClassVar[Mapping[str, str]] = {}
    running: float
    at: int | None

    def __init_subclass__(cls) -> None:
        """Collect the kinds of steps."""
        cls.KINDS = {kind.name: kind for member in vars(cls).values() for kind in getattr(member, "kinds", ())}

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.dialect = probe.dialect
        self.steps: list[Step] = []
        self.done = 0
        self.leeway = Leeway(probe.gate.allowance.bounds, probe.gate.allowance.subdivision, dialect=probe.dialect)
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
        try:
            self.KINDS[step.name].act(self, **step.values)
        except GateRefused:
            # Bytes of these values could be read as a frame that is not allowed: then this is no step.
            self.steps.pop()
            return
        self.done += 1
        self.compare()

    # --- what models share ----------------------------------------------------------------------------------------

    def expect(
        self, expected: Any, got: Any, what: str, *, holds: bool | None = None, exchange: Exchange | None = None
    ) -> None:
        """Refute the claim unless what was got is as the model says after the steps so far."""
        text = f"after {len(self.steps)} steps: {what}"
        self.probe.expect(
            f"{got}, after {steps_text(self.steps)}",
            holds=expected == got if holds is None else holds,
            expected=f"{expected}",
            refutes=text,
            exchange=exchange,
            key=f"state: {what}",
        )

    def standing(self) -> float:
        """Wait until the shaft stands and has settled; return where that is (deg)."""
        motion.wait_standing(self.probe)
        self.probe.wait(SETTLING_NS)
        return motion.position(self.probe).value

    def readable(self, exchange: Exchange) -> Exchange:
        """Return an exchange all of whose answers can be read. Raises Inconclusive where one cannot."""
        for answer in exchange.answers:
            if answer.command is None or answer.message.form is None or not answer.message.frame.checksum_ok:
                raise Inconclusive(f"an answer cannot be read: {answer.data.hex(' ').upper()}")
        if exchange.junk:
            raise Inconclusive(f"what came is no frame: {exchange.junk[0].data.hex(' ').upper()}")
        return exchange
