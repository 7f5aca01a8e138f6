"""Reads in every condition: what a drive answers at rest it answers while it moves, is off, is protected, or has been set.

What is not answered again and again in one condition is refuted there, so that no drive hides behind claims that cannot judge.
What is stored reads the same in every condition, and so do the flags that it does not change.

Rules kept here:
- Only reads that are answered at rest are asked for. One reply may be lost: a read is asked for twice.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Inconclusive, Theme
from conformance.claims import conditions
from conformance.claims.conditions import Condition
from conformance.claims.control_reads import is_answered, received_text
from conformance.claims.declare import Case, claim
from conformance.claims.known_reads import every_read, is_stored
from conformance.claims.motion.motion_claim import expect_speed
from conformance.motion import motion
from conformance.motion.declared import QUICK, SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Probe

_ROUNDS = 2
#: The run behind a condition, which is none of those in it, and how long it has until it is looked at.
_RPM, _GOING_NS = 90, 150 * MS
#: Reads of what little of a drive's doings changes.
_FLAGS = (Verb.READ_ENABLED, Verb.READ_ZERO_STATUS, Verb.READ_PROTECTION, Verb.BRAKE)


def _conditions(dialect: Dialect) -> Iterator[Case]:
    for each in conditions.every(dialect):
        reads = tuple(dict.fromkeys(c.name for c, _ in every_read(dialect)))
        yield Case(dialect, given={"state": each, "when": each.when}, facts={**each.facts(dialect), "commands": reads})


@claim(
    Theme.RESILIENCE,
    each=_conditions,
    name="reads/{state}",
    refuted_by="silence, another reply, or another value of what stays",
    section=lambda case: case.dialect.by_verb[Verb.RUN_SPEED].section,
    at_best=Certainty.LIKELY,
    parameters={},
)
def _reads(probe: Probe, state: Condition) -> None:
    """Every read is answered by its own reply {when}, what is stored reads as before, and the run behind it is as asked for."""
    # Some conditions set the subdivision of the suite: what is stored is looked at behind that.
    motion.ready_to_move(probe, state.mode, subdivision=SUBDIVISION)
    at_rest = [(c, values, probe.ask(c, values, quiet_ns=0)) for c, values in every_read(probe.dialect)]
    readable = [(c, values, e) for c, values, e in at_rest if _tells(probe, e) and c.verb not in state.without]
    if not readable:
        raise Inconclusive("no read is answered while the shaft stands")
    state.enter(probe)
    for number in range(_ROUNDS):
        for command, values, before in readable:
            # What is stored is asked for once: that is most of a dialect's reads.
            if not number or not is_stored(command):
                _expect_answer(probe, command, values, state, before)
    state.leave(probe)
    if state.name not in probe.dialect.by_name:
        # Of motions that is crossed.
        _expect_run(probe, state)


def _expect_run(probe: Probe, state: Condition) -> None:
    """Refute unless the next run turns the shaft as fast as it is told: that the drive was so leaves no trace."""
    motion.stand_still(probe)
    motion.ready_to_move(probe, state.mode, subdivision=SUBDIVISION)
    exchange = motion.run_at(probe, _RPM)
    probe.wait(_GOING_NS)
    seen = motion.turning(probe)
    motion.stand_still(probe)
    expect_speed(seen, _RPM, exchange, f"the first run {state.when} and after it turns at another speed", share=2 * CLOCK_SHARE)


def _tells(probe: Probe, exchange: Exchange) -> bool:
    """Say whether a read was answered by what it reads: no other layout, and no refusal."""
    return is_answered(exchange) and exchange.is_read and not probe.refused(exchange)


def _expect_answer(probe: Probe, command: Command, values: Mapping[str, Any], state: Condition, before: Exchange) -> None:
    exchange = probe.ask(command, values, quiet_ns=0)
    if not _tells(probe, exchange):
        exchange = probe.ask(command, values, quiet_ns=0)
    answered = _tells(probe, exchange)
    if not answered:
        # What cannot be read cannot be left in order either.
        motion.stop(probe, QUICK)
    probe.expect(
        received_text(exchange),
        holds=answered,
        expected=f"a reply to {command.name}",
        refutes=f"{command.name} is not answered {state.when}",
        exchange=exchange,
        key=f"reads are not answered {state.when}",
    )
    told = [v.rule for v in probe.reply(exchange).message.violations]
    if told and not probe.reply(before).message.violations:
        text = f"{command.name} is answered {state.when} by what its reply cannot be"
        key = f"{command.name} is answered by what its reply cannot be"
        probe.expect(received_text(exchange), holds=False, expected=f"no {told[0]}", refutes=text, exchange=exchange, key=key)
    if (state.stays and is_stored(command)) or (command.verb in _FLAGS and command.verb not in state.changes):
        stored = probe.reply(before).values
        text = f"{command.name} reads something else {state.when} than at rest"
        key = f"{command.name} reads something else than at rest"
        probe.expect(probe.reply(exchange).values, equal=stored, refutes=text, exchange=exchange, key=key)
