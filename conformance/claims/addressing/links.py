"""Settings of the link that are sent to several drives: the drive that hears them has another address or speed then.

    FA 00 8B 5A ..    every drive has the address 5A
    FA 50 8A 05 ..    every drive of the group 50h speaks at 57600 baud

And all drives' and its group's address are heard by a drive that has been given other addresses, before and after a restart;
at an address, and in a group, that it has no more nothing of it is heard.

Rules kept here:
- The drive is led back by itself, at its new address or speed.
- Nothing else may hear these: every drive of the wire would have one address.
- That an address is heard shows by disabling and enabling, three times at most: a line may lose one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Verb
from analyzer.layout import Effect, Field
from conformance.claim import Aspect, Inconclusive, Theme
from conformance.claims.addressing.ways import Many, addressing, group_of, ways
from conformance.claims.control_reads import expect_silence
from conformance.claims.declare import Case, Cases, commands
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.claims.settings.link_changes import (
    NEW_ADDRESS_ANSWERS,
    another_rate,
    at_rate,
    change_address,
    other_address,
    settle,
)
from conformance.claims.settings.setting_effects import hears
from conformance.motion import arriving, declared, effects, motion
from conformance.talk.acceptance import answers, need_reliable_replies
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe, Until
from conformance.talk.restarts import wait_for_answer

#: How long such a setting is listened to; how often something is told that a line may lose.
_SILENT_NS, _TRIES = 20 * MS, 3


def _by_ways(effect: Effect) -> Cases:
    """Return cases of a setting of the link, one for each way to several drives."""

    def cases(dialect: Dialect) -> Iterator[Case]:
        for many in ways(dialect) if declared.can_move(dialect) else ():
            for command, field in dialect.effects(effect):
                risks = {*command.all_risks, *many.risks(dialect)}
                facts = {"risks": risks, "settings": (field.name, *many.settings)}
                yield Case(dialect, command, {"many": many, "what": many.what, "field": field}, facts)

    return cases


def _send(many: Many, probe: Probe, command: Command, values: Mapping[str, int]) -> Exchange:
    to = many.join(probe)
    return probe.send(many.frame(probe, command, values, to), timeout_ns=_SILENT_NS)


@addressing("an answer at the old address, or to what was sent", _by_ways(Effect.ADDRESS), name="{many}/{command}")
def _address(probe: Probe, many: Many, command: Command, field: Field) -> None:
    """An address that {command} gives by {what} is the drive's, and that is not answered."""
    need_reliable_replies(probe)
    before, away = probe.address, other_address(probe.dialect)
    sent = _send(many, probe, command, {field.name: away})
    settle(probe, away)
    there, here = answers(probe, away), answers(probe, before)
    if there:
        change_address(probe, command, before, at=away)
    places = [str(address) for address, answered in ((away, there), (before, here)) if answered]
    text = f"{command.name} by {many.what} does not give the drive that address alone"
    shown = f"an answer at {' and '.join(places) or 'neither'}"
    probe.expect(shown, holds=there and not here, expected=f"an answer at {away} alone", refutes=text, exchange=sent)
    expect_silence(probe, sent, f"{command.name} by {many.what} is answered")


@addressing("silence at the new speed, or an answer to what was sent", _by_ways(Effect.BAUD_RATE), name="{many}/{command}")
def _rate(probe: Probe, many: Many, command: Command) -> None:
    """A speed that {command} sets by {what} is the drive's, and that is not answered."""
    need_reliable_replies(probe)
    other = another_rate(probe)
    with at_rate(probe, other, partial(_send, many)) as sent:
        there = answers(probe, probe.address)
    text = f"{command.name} by {many.what} does not set the speed of the drive"
    probe.expect("silence", holds=there, expected=f"an answer at {other} bits per second", refutes=text, exchange=sent)
    expect_silence(probe, sent, f"{command.name} by {many.what} is answered")


# --- what is heard behind them ----------------------------------------------------------------------------------------


#: What is sent to an address that the drive has no more, and how long a step takes that would show.
_TO_GONE: Mapping[Verb, Mapping[str, int]] = {
    Verb.SET_ZERO: {},
    Verb.MOVE_RELATIVE_AXIS: {"speed": declared.CALM, "acceleration": declared.QUICK, "position": effects.STEP},
    Verb.ENABLE: {"enabled": 0},
}
#: How far from its zero the shaft is then, in degrees.
_AWAY = 45


def _obeyed(probe: Probe, gone: int, at: int) -> str:
    """Return what a drive that answers `at` an address does of a setting, a move and a switch that are sent to one it had."""

    def read(verb: Verb, name: str) -> int:
        return int(probe.reply(probe.ask(verb, address=at, quiet_ns=0)).values[name])

    before = read(Verb.READ_POSITION, "position")
    for verb, values in _TO_GONE.items():
        probe.ask(verb, values, address=gone, until=Until.TIMEOUT, timeout_ns=probe.rig.quiet_ns)
        probe.wait(effects.STEP_NS if verb is Verb.MOVE_RELATIVE_AXIS else 0)
    went = abs(read(Verb.READ_POSITION, "position") - before) > probe.within("counts")
    off = not read(Verb.READ_ENABLED, "enabled")
    return " and ".join(word for word, done in (("another position", went), ("a motor that is off", off)) if done)


def _expect_nothing(probe: Probe, gone: str, done: str, exchange: Exchange) -> None:
    text = f"a drive obeys at {gone}, which it has no more: {done}"
    probe.expect(done or "nothing", equal="nothing", refutes=text, exchange=exchange, key="an address of before is heard")


_at_another = partial(
    of_motion,
    theme=Theme.ADDRESSING,
    each=commands(Verb.SET_ADDRESS),
    at_best=Certainty.LIKELY,
    quirks=may_meet(NEW_ADDRESS_ANSWERS),
    aspect=Aspect.STATE,
    alone=True,
)


@_at_another(name="{command}/gone", refuted_by="another position, or a motor that is off", risks=risks_by(*_TO_GONE))
def _gone(probe: Probe, command: Command) -> None:
    """At the address that it had a drive obeys nothing: no setting, no move and no switch."""
    motion.ready_to_move(probe)
    arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), _AWAY)
    own, away = probe.address, other_address(probe.dialect)
    away -= own == away
    exchange = change_address(probe, command, away)
    try:
        done = _obeyed(probe, own, away)
    finally:
        change_address(probe, command, own, at=away)
    _expect_nothing(probe, f"the address {own:#x}", done, exchange)


@_at_another(
    name="{command}/shared-heard",
    refuted_by="a drive that all drives' address, or its group's, no longer reaches, or a group that it left does",
    rests_on=(Doubt.ADDRESSING,),
    risks=risks_by(Verb.SET_GROUP_ADDRESS, Verb.RESTART, *_TO_GONE),
    settings=lambda case: ("group_address",) if Verb.SET_GROUP_ADDRESS in case.dialect.by_verb else (),
)
def _shared_heard(probe: Probe, command: Command) -> None:
    """All drives' address and the group's, highest and lowest, are heard behind other addresses, and no group that was left."""
    motion.ready_to_move(probe)
    arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), _AWAY)
    need_reliable_replies(probe)
    own, away = probe.address, other_address(probe.dialect)
    away -= own == away
    joins = probe.dialect.by_verb.get(Verb.SET_GROUP_ADDRESS)
    last, shared = probe.dialect.addresses[1], [probe.dialect.broadcast or 0]
    seen: list[tuple[str, str]] = []

    def look(behind: str, at: int) -> None:
        unheard = [f"{to:#x}" for to in shared if not any(hears(probe, to, at) for _ in range(_TRIES))]
        seen.append((behind, ", ".join(unheard)))

    def join(group: int, at: int) -> None:
        if joins is not None:
            probe.reply(probe.ask(joins, {"group_address": group}, address=at))
            shared[1:] = [group]
            look(f"the group {group:#x}", at)

    look("nothing", own)
    if not hears(probe, own) or seen[0][1]:
        raise Inconclusive("what all drives are told does not show, which other claims judge")
    join(last - (own == last), own)
    exchange = change_address(probe, command, away)
    try:
        look(f"the address {away:#x}", away)
        left = shared[1:]
        join(1, away)
        obeyed = {f"the group {group:#x}": _obeyed(probe, group, away) for group in left}
        probe.ask(Verb.RESTART, address=away)
        wait_for_answer(probe, away)
        look(f"a restart at {away:#x}", away)
        join(group_of(probe.dialect, own), away)
    finally:
        change_address(probe, command, own, at=away)
    look(f"the address {own:#x} again", own)
    for behind, unheard in seen:
        text = f"a drive with another address does not hear all that it shares: {unheard} behind {behind}"
        probe.expect(unheard or "each", equal="each", refutes=text, exchange=exchange, key="a shared address is not heard")
    for gone, done in obeyed.items():
        _expect_nothing(probe, gone, done, exchange)
