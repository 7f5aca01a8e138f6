"""What switches a drive, sets its zero or writes its ports does so in every condition in which a drive stands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from analyzer.catalogue import Dialect, Risk, Verb
from conformance.claims import conditions
from conformance.claims.conditions import Condition
from conformance.claims.control_reads import received_text
from conformance.claims.declare import Case
from conformance.claims.resilience.settings import ALL, GROUP, OWN, asked, in_conditions, told_all, values_text
from conformance.motion import arriving, declared, motion
from conformance.talk.acceptance import can_refuse
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe


@dataclass(frozen=True)
class _Deed:
    """Something that a drive is told to do, and what is read then. `but_in`: conditions in which it does something else.

    `to`: whom it is sent to.
    """

    name: str
    values: Mapping[str, int]
    expect: Callable[[Probe, Exchange, str], None]
    but_in: tuple[str, ...] = ()
    to: str = OWN

    def is_for(self, dialect: Dialect, condition: Condition) -> bool:
        """Say whether a drive can be told it in a condition."""
        heard = {OWN: True, ALL: dialect.broadcast is not None, GROUP: condition.name == "grouped"}[self.to]
        known = dialect.by_name.get(self.name)
        wears = known is None or Risk.WEAR in known.all_risks
        return heard and not wears and condition.stands and condition.name not in self.but_in


def _is_zero(probe: Probe, exchange: Exchange, when: str) -> None:
    turn = probe.dialect.counts_per_turn
    parts = probe.reply(probe.ask(Verb.READ_ENCODER_CARRY)).values
    seen = {
        "the position": probe.read(Verb.READ_POSITION, "position"),
        "carry and value": parts["carry"] * turn + parts["encoder"],
    }
    for what, counts in seen.items():
        text = f"{what} is not zero after {exchange.command.name if exchange.command else ''} {when}"
        probe.expect(counts, near=0, unit="counts", refutes=text, exchange=exchange)


def _is(on: bool) -> Callable[[Probe, Exchange, str], None]:
    def expect(probe: Probe, exchange: Exchange, when: str) -> None:
        text = f"a motor that is switched {'on' if on else 'off'} {when} reads otherwise"
        # Of some dialects nothing tells it.
        if (seen := motion.is_on(probe)) is not None:
            probe.expect(seen, equal=on, refutes=text, exchange=exchange)

    return expect


def _stands(probe: Probe, exchange: Exchange, when: str) -> None:
    motion.wait_standing(probe)


def _reads_position(position: int) -> Callable[[Probe, Exchange, str], None]:
    def expect(probe: Probe, exchange: Exchange, when: str) -> None:
        text = f"the position is not what is set {when}"
        seen = motion.position(probe)
        probe.expect(seen.value, near=position / 100, within=motion.miss(probe), refutes=text, exchange=exchange)

    return expect


def _within_a_turn(probe: Probe, exchange: Exchange, when: str) -> None:
    text = f"93 does not drop the turns {when}"
    probe.expect(abs(motion.position(probe).value), at_most=360, unit="degrees", refutes=text, exchange=exchange)


def _reads_ports(alm: int, pend: int) -> Callable[[Probe, Exchange, str], None]:
    def expect(probe: Probe, exchange: Exchange, when: str) -> None:
        got = {port: probe.read(Verb.READ_IO, port) for port in ("alm", "pend")}
        text = f"ports that are written {when} read otherwise"
        probe.expect(got, equal={"alm": alm, "pend": pend}, refutes=text, exchange=exchange)

    return expect


def _ports(alm: int, pend: int) -> Mapping[str, int]:
    return {"alm_mask": 1, "pend_mask": 1, "alm": alm, "pend": pend}


_NO_SWITCH = ("pulse-mode", "protected", "error")
_DEEDS = (
    _Deed("set_zero", {}, _is_zero),
    _Deed("set_position", {"position": 12_345}, _reads_position(12_345)),
    _Deed("set_position", {"position": -123_456_789}, _reads_position(-123_456_789)),
    _Deed("clear_turns", {}, _within_a_turn),
    _Deed("enable", {"enabled": 0}, _is(False), _NO_SWITCH),
    _Deed("enable", {"enabled": 1}, _is(True), _NO_SWITCH),
    _Deed("enable", {"enabled": 0}, _is(False), _NO_SWITCH, ALL),
    _Deed("enable", {"enabled": 1}, _is(True), _NO_SWITCH, ALL),
    _Deed("enable", {"enabled": 0}, _is(False), _NO_SWITCH, GROUP),
    _Deed("enable", {"enabled": 1}, _is(True), _NO_SWITCH, GROUP),
    _Deed("motor_off", {}, _is(False), _NO_SWITCH),
    _Deed("motor_on", {}, _is(True), _NO_SWITCH),
    _Deed("emergency_stop", {}, _stands, ("pulse-mode",)),
    _Deed("stop", {}, _stands),
)
#: What is written to the ports cannot be read, and so not be put back: it runs where it is told what to put back.
_PORTS = (
    _Deed("write_io", _ports(0, 1), _reads_ports(0, 1)),
    # A mask of 2 keeps what the other field would change.
    _Deed("write_io", {"alm_mask": 1, "pend_mask": 2, "alm": 1, "pend": 0}, _reads_ports(1, 1)),
    _Deed("write_io", {"alm_mask": 2, "pend_mask": 1, "alm": 0, "pend": 0}, _reads_ports(1, 0)),
    _Deed("write_io", {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0}, lambda probe, exchange, when: None),
)


def _switches_cases(dialect: Dialect) -> Iterator[Case]:
    known = dialect.by_name
    for condition in conditions.passing(dialect):
        for kind, every in (("switches", _DEEDS), ("ports", _PORTS)):
            deeds = [deed for deed in every if deed.is_for(dialect, condition)]
            if not deeds:
                continue
            risks = frozenset[Risk]().union(*(known[d.name].risks(d.values) for d in deeds))
            facts = condition.facts(dialect, *risks) | {"commands": tuple(dict.fromkeys(d.name for d in deeds))}
            facts["alone"] |= any(deed.to != OWN for deed in deeds)
            given = {"condition": condition, "when": condition.when, "deeds": deeds, "kind": kind}
            yield Case(dialect, given=given, facts=facts)


@in_conditions(each=_switches_cases, name="{kind}/{condition}", refuted_by="a refusal, silence, or no effect of it")
def _switches(probe: Probe, condition: Condition, deeds: list[_Deed]) -> None:
    """What switches a drive, sets its zero or writes its ports does so {when}."""
    motion.ready_to_move(probe, condition.mode)
    arriving.follow(probe, declared.any_move(probe.dialect, at_speed=True), 100, rpm=120)
    condition.enter(probe)
    for deed in deeds:
        command = probe.command(deed.name)
        if deed.to != OWN:
            exchange = told_all(probe, command, deed.values, deed.to)
        else:
            exchange = asked(probe, command, deed.values, condition.when)
        if can_refuse(command) and deed.to == OWN:
            text = f"{deed.name} {values_text(deed.values)} is refused {condition.when}"
            holds = not probe.refused(exchange)
            probe.expect(received_text(exchange), holds=holds, expected="no refusal", refutes=text, exchange=exchange)
        deed.expect(probe, exchange, condition.when)
    condition.leave(probe)
