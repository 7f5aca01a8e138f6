"""Worked examples: every request that the manual prints, sent to the drive under test, and its reply to the byte.

    printed   FA 01 30 2B    ->  FB 01 30 FF FF FF FF 22 69 B3
    sent      FA 07 30 31        to a drive whose address is 7
    expected  FB 07 30 .. .. .. .. .. .. sum       measured values aside

Rules kept here:
- A frame that does not hold is sent as its erratum corrects it, and the claim is as sure as the erratum.
- A frame without a printed reply must be answered by a reply that does not refuse it.
- Measured values in a reply may differ from print; statuses, and fields that repeat the request, may not.
- Of a command with only a reply in print, a plain request is sent.
- Examples to all drives or to a group are executed and not answered; a package stands among them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from analyzer import encoder
from analyzer.catalogue import Command, Dialect, Doubt, MotionKind, Risk, Role, Vector, Verb
from analyzer.codec import codec
from conformance.claim import Aspect, Inconclusive, Theme
from conformance.claims.control_reads import received_text
from conformance.claims.declare import Case, claim
from conformance.claims.frames.examples_many import is_to_many
from conformance.claims.known_quirks import LATE, NO_CHECKSUM, known
from conformance.claims.requests import demands, needs_motion, put_to_rest, values_for
from conformance.model.lk_parameters import OTHER_FIRMWARE
from conformance.motion import declared, motion, ramp
from conformance.talk import samples
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import Probe, Until
from conformance.talk.reply_match import MatchedReply, replies

#: How late a reply of a drive with slow replies can be.
_SLOWEST_NS = 1_000_000_000
#: A move that takes longer is not waited for.
_LONGEST_NS = 6_000_000_000


@dataclass
class Example:
    """A request as printed, and the replies that are printed with it. `request` None: only replies are."""

    command: Command
    request: Vector | None
    replies: list[Vector] = field(default_factory=list)

    @property
    def section(self) -> str:
        """Where it is printed."""
        shown = self.request or self.replies[0]
        return shown.section or self.command.section

    @property
    def values(self) -> dict[str, Any]:
        """The request's values as sent; of a command with only a reply in print there are none."""
        return {} if self.request is None else dict(self.request.values)


def examples(dialect: Dialect, command: Command) -> list[Example]:
    """Return the examples of a command that are addressed to one drive, in the manual's order."""
    found: list[Example] = []
    for vector in command.vectors:
        if vector.models and dialect.model and dialect.model not in vector.models:
            continue
        if vector.role is Role.REQUEST:
            if not is_to_many(dialect, command, vector):
                found.append(Example(command, vector))
        elif found and found[-1].section == (vector.section or command.section):
            found[-1].replies.append(vector)
        else:
            found.append(Example(command, None, [vector]))
    return found


def _distinct(dialect: Dialect, every: Sequence[Example]) -> list[Example]:
    """Return examples without those that are printed again with nothing more; of the same, one without an erratum."""
    found: list[Example] = []
    places: dict[bytes, int] = {}
    for example in every:
        frame = _frame(dialect, example)
        at = places.setdefault(frame, len(found))
        if example.replies or at == len(found):
            found.append(example)
        elif example.request is not None and not example.request.erratum and not found[at].replies:
            found[at] = example
    return found


def _frame(dialect: Dialect, example: Example) -> bytes:
    return encoder.build(dialect, example.command, 1, example.values) if example.request is not None else b""


# --- one example ------------------------------------------------------------------------------------------------------


def _cases(dialect: Dialect) -> Iterator[Case]:
    for command in dialect.commands:
        for number, example in enumerate(_distinct(dialect, examples(dialect, command)) if command.slots is None else (), 1):
            shown = example.request or example.replies[0]
            facts = {
                "name": f"{{command}}/{number}",
                "section": example.section,
                "errata": tuple(v.erratum for v in (shown, *example.replies) if v.erratum),
                "quirks": _quirks(dialect, example),
                "parameters": {"printed": shown.printed},
                **demands(dialect, command),
                "risks": _risks(dialect, example),
            }
            yield Case(dialect, command, {"example": example, "what": _what(example), "printed": _printed(shown)}, facts)


def _risks(dialect: Dialect, example: Example) -> frozenset[Risk]:
    command = example.command
    risks = demands(dialect, command)["risks"]
    if example.request is not None:
        sent = encoder.assemble(dialect, command, 1, example.values).risks
        risks = frozenset(sent) | (declared.risks(dialect) if needs_motion(command) else frozenset())
    run = _run_of(dialect, command)
    return frozenset(risks | run.risks(samples.sample(dialect, run)) if run is not None else risks)


def _quirks(dialect: Dialect, example: Example) -> tuple[str, ...]:
    """Return the quirks that an example can meet."""
    command = example.command
    concerned = {
        OTHER_FIRMWARE: command.verb in (Verb.READ_PARAMETER, Verb.WRITE_PARAMETER),
        NO_CHECKSUM: bool(example.replies),
        LATE: len(example.replies) > 1 and _run_of(dialect, command) is not None,
    }
    return known(dialect, *(name for name, is_so in concerned.items() if is_so))


@claim(Theme.EXAMPLES, each=_cases, refuted_by="another reply, or none", aspect=Aspect.EXAMPLE, rests_on=(Doubt.EXAMPLE,))
def _example(probe: Probe, command: Command, example: Example) -> None:
    """{what} ({printed})"""
    _prepare(probe, command, len(example.replies))
    values = example.values if example.request is not None else values_for(probe, command)
    if len(example.replies) > 1 and _lasts_ns(probe.dialect, command, values) > _LONGEST_NS:
        # Its end is told as that of any other move is.
        example = replace(example, replies=example.replies[:1])
    exchange = probe.ask(command, values, until=Until.DONE if len(example.replies) > 1 else Until.REPLY)
    try:
        if exchange.silent and OTHER_FIRMWARE in probe.claim.quirks:
            probe.meets(OTHER_FIRMWARE)
        else:
            _judge(probe, example, exchange)
    finally:
        # That the drive does not come to rest is for claims about motion, and for the rig.
        with contextlib.suppress(Inconclusive):
            put_to_rest(probe, command)


def _lasts_ns(dialect: Dialect, command: Command, values: Mapping[str, Any]) -> float:
    """Return how long a move takes by the law of ramps, at the subdivision of `_prepare`; 0 for all other commands."""
    of, law = command.motion, dialect.subdivision
    if of is None or law is None or not of.distance or not values[of.speed]:
        return 0.0
    turns = abs(values[of.distance]) / declared.units_per_turn(dialect, command, max(law.plain))
    return ramp.move_ns(turns, values[of.speed], values[of.acceleration])


def _what(example: Example) -> str:
    name = example.command.name
    if example.request is None:
        return f"{name} is answered by the printed frame"
    if example.replies:
        listed = " and ".join(reply.printed for reply in example.replies)
        return f"The printed request {name} is answered by {listed}, measured values aside"
    return f"The printed request {name} is answered, and not refused"


def _printed(vector: Vector) -> str:
    how = "computed from the manual's tables" if vector.computed else "printed"
    fixed = f", corrected to {vector.corrected}" if vector.corrected else ""
    return f"{how}: {vector.printed}{fixed}"


def _run_of(dialect: Dialect, command: Command) -> Command | None:
    """Return the run or move that a stop by a ramp stops, None for other commands."""
    if command.motion is None or command.motion.kind is not MotionKind.STOP or not command.motion.acceleration:
        return None
    return next((c for c in dialect.commands if c.motion is not None and c.motion.stops[:1] == (command.name,)), None)


def _prepare(probe: Probe, command: Command, replies: int) -> None:
    if not needs_motion(command):
        return
    law = probe.dialect.subdivision
    # The claim waits for the move's end: of the subdivisions that leave its speed as sent, the largest makes it shortest.
    short = law is not None and replies > 1 and command.motion is not None and bool(command.motion.distance)
    motion.ready_to_move(probe, subdivision=max(law.plain) if law is not None and short else None)
    run = _run_of(probe.dialect, command)
    if run is not None:
        probe.do(run, values_for(probe, run))


def _judge(probe: Probe, example: Example, exchange: Exchange) -> None:
    got = replies(exchange, probe.dialect).readings
    name = example.command.name
    if not got:
        _expect(probe, exchange, False, f"the example of {name} is not answered", "a reply", received_text(exchange))
    if not example.replies:
        refused = probe.refused(exchange)
        _expect(
            probe,
            exchange,
            not refused,
            f"the example of {name} is refused",
            "a reply that it is done",
            received_text(exchange),
        )
    for number, printed in enumerate(example.replies):
        what = f"reply {number + 1} to the example of {name}"
        _expect(probe, exchange, number < len(got), f"{what} does not come", printed.printed, received_text(exchange))
        expected = _expected(probe, example, got[number], printed)
        if got[number].lacks_check and NO_CHECKSUM in probe.claim.quirks:
            probe.meets(NO_CHECKSUM)
            continue
        if expected != got[number].data and _overtaken(probe, example, got):
            probe.meets(LATE)
            return
        came_now = got[number].data
        _expect(probe, exchange, expected == came_now, f"{what} is another", hex_of(expected), hex_of(came_now))


def _expect(probe: Probe, exchange: Exchange, holds: bool, refutes: str, expected: str, got: str) -> None:
    asked = hex_of(exchange.sent or b"")
    probe.expect(got, holds=holds, expected=f"{expected} to {asked}", refutes=refutes, exchange=exchange)


def _overtaken(probe: Probe, example: Example, got: Sequence[MatchedReply]) -> bool:
    """Say whether a slow first reply was overtaken by the last one, and comes after it."""
    if LATE not in probe.claim.quirks:
        return False
    first, last = (_expected(probe, example, got[0], printed) for printed in (example.replies[0], example.replies[-1]))
    later = [reading.data for reading in got[1:]] + [a.data for a in probe.listen(_SLOWEST_NS).answers]
    return got[0].data == last and first in later


def _expected(probe: Probe, example: Example, reading: MatchedReply, printed: Vector) -> bytes:
    """Return the printed reply with the address of this drive, and the measured values that it sent."""
    command, form = example.command, reading.template.form
    layout = form.layout
    if printed.values.keys() != layout.named.keys():
        # Another model's reply is printed; the drive's own has nothing but measured values to compare.
        return reading.data
    measured = codec(layout).wire(reading.own) if layout.fits(len(reading.own)) else {}
    # A field of the reply repeats one of the request where both are the same field, not only of one name.
    asked = [f for form in command.request_forms for n, f in form.layout.named.items() if n in example.values]
    told = {command.replies.status, *(n for n, f in layout.named.items() if f in asked)}
    values = {
        name: measured[name] if name in measured and name not in told and field.fixed is None else printed.values[name]
        for name, field in layout.named.items()
    }
    return probe.dialect.link.build(command, form, probe.address, codec(layout).encode(values), Role.REPLY)
