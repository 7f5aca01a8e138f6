"""What a drive shows of many settings at once that no read shows: by one move, one run and one homing."""

from __future__ import annotations

from collections.abc import Mapping

from analyzer.catalogue import Command, Verb
from conformance.claims.settings.known_settings import ReadableSetting, Setting
from conformance.claims.settings.setting_effects import BY_VERB, PULSES, STEEP, Homing, by_action, counts, homing
from conformance.motion import arriving, declared, motion
from conformance.motion.attempts import anew
from conformance.motion.declared import SUBDIVISION
from conformance.talk.acceptance import without_repeats
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe, Until

#: How long a setting that is not answered is given, and a move of `PULSES` at 16 subdivisions and more.
SILENT_NS, _MOVE_NS = 30 * MS, 300 * MS
#: Speeds that are one; a speed that a coarse subdivision reaches too, and when it is reached.
SPEED_SHARE, _RUN_RPM, _RUN_NS = 0.06, 60, 100 * MS
#: Below these the shaft has not turned.
_STANDS_RPM, _STANDS_COUNTS = 6, 16


def home_by_a_switch(probe: Probe) -> None:
    """Let homing go by the switch at its own port: a closed one turns it round, where nothing else leads it elsewhere."""
    for verb, name in ((Verb.SET_NO_LIMIT_HOME, "home_mode"), (Verb.SET_LIMIT_REMAP, "limit_remap")):
        if verb in probe.dialect.by_verb:
            probe.do(verb, {name: 0})


def expect_effects(
    probe: Probe, chosen: list[Setting], held: Mapping[str, Mapping[str, int]], when: str, before: Homing | None = None
) -> None:
    """Refute unless the drive does what it was set to. `before`: how it homed before a setting of that was refused."""
    unread = {each.command.verb: each for each in chosen if not isinstance(each, ReadableSetting) and each.name in held}
    shown = {verb: held[each.name] for verb, each in unread.items() if by_action(probe.dialect, each.command) is not None}
    if Verb.SET_WORK_MODE in shown:
        _expect_shown(probe, Verb.SET_WORK_MODE, BY_VERB[Verb.SET_WORK_MODE].see(probe), shown, "the work mode", when)
        motion.set_mode(probe, declared.bus_modes(probe.dialect)[-1])
    motion.ready_to_move(probe)
    if Verb.SET_SUBDIVISION in shown or Verb.SET_RESPOND in shown:
        _expect_move(probe, shown, when)
    # It turns the shaft where a read shows it, too.
    for name in dict.fromkeys(each.name for each in chosen if each.command.verb is Verb.SET_SUBDIVISION and each.name in held):
        _expect_run(probe, held[name]["subdivision"], when)
    if Verb.SET_HOME in shown:
        # Its speed goes by the subdivision too.
        motion.ready_to_move(probe, subdivision=SUBDIVISION)
        if before is not None:
            home_by_a_switch(probe)
        seen, wanted = homing(probe), shown[Verb.SET_HOME]["home_speed"]
        text = f"set_home set {when} is another homing"
        probe.expect(seen.rpm, near=wanted, within=max(2.0, wanted * SPEED_SHARE), unit="rpm", refutes=text)
        if before is not None:
            probe.expect(seen.way, equal=before.way, refutes=f"a refused set_home {when} turns homing round")


def _expect_run(probe: Probe, subdivision: int, when: str) -> None:
    """Refute a run whose shaft has another speed than the sent one at this subdivision."""
    law, run = probe.dialect.subdivision, probe.command(Verb.RUN_SPEED)
    assert law is not None  # there is a subdivision to set
    values = declared.values_of(probe.dialect, run, rpm=_RUN_RPM, acceleration=STEEP, subdivision=subdivision)
    exchange, seen = _ran(probe, run, values)
    if abs(seen.value) < _STANDS_RPM:
        # A line may lose a request, and `respond` the reply that would tell.
        exchange, seen = _ran(probe, run, values)
    sent = values[declared.of(run).speed]
    wanted = sent if subdivision in law.plain else sent * law.counted_at / subdivision
    text = f"a run has another speed than its subdivision says, which was set {when}"
    probe.expect(abs(seen.value), near=wanted, within=SPEED_SHARE * wanted + 2, unit="rpm", refutes=text, exchange=exchange)


@anew
def _ran(probe: Probe, run: Command, values: Mapping[str, int]) -> tuple[Exchange, motion.Sample]:
    """Run from rest to rest; return what was said, and how fast the shaft was."""
    # `respond` may silence it.
    exchange = probe.ask(run, values, until=Until.TIMEOUT, timeout_ns=_RUN_NS)
    seen = motion.speed(probe)
    probe.ask(Verb.STOP_SPEED, {"acceleration": STEEP}, until=Until.TIMEOUT, timeout_ns=SILENT_NS)
    motion.wait_standing(probe)
    return exchange, seen


def _expect_move(probe: Probe, shown: Mapping[Verb, Mapping[str, int]], when: str) -> None:
    """Refute unless a move goes as far as the subdivision says, and is answered as `respond` says."""
    command, pulses = probe.command(Verb.MOVE_RELATIVE_PULSES), PULSES
    values = {"direction": 0, "speed": 18, "acceleration": STEEP, "pulses": pulses}
    respond = shown.get(Verb.SET_RESPOND, {"respond": 1, "active": 1})
    # Where its end is told, no more is waited for.
    told = respond["respond"] and respond["active"] and declared.of(command).tells_end
    until = Until.DONE if told else Until.TIMEOUT
    exchange, went = _moved(probe, command, values, until)
    if went < _STANDS_COUNTS:
        exchange, went = _moved(probe, command, values, until)
    subdivision = shown.get(Verb.SET_SUBDIVISION, {"subdivision": SUBDIVISION})["subdivision"]
    wanted = declared.counts_of(probe.dialect, command, pulses, subdivision)
    text = f"{pulses} pulses go another way after settings {when}"
    probe.expect(went, near=wanted, within=max(3, wanted // 8), unit="counts", refutes=text, exchange=exchange)
    if Verb.SET_RESPOND in shown:
        seen = " then ".join(map(str, without_repeats(arriving.statuses((exchange,), command)))) or "silence"
        _expect_shown(probe, Verb.SET_RESPOND, seen, shown, "what a move is answered", when)


@anew
def _moved(probe: Probe, command: Command, values: Mapping[str, int], until: Until) -> tuple[Exchange, int]:
    """Move from rest to rest; return what was said, and how many counts the shaft went."""
    start = counts(probe)
    exchange = probe.ask(command, values, until=until, timeout_ns=_MOVE_NS)
    motion.wait_standing(probe)
    return exchange, abs(counts(probe) - start)


def _expect_shown(probe: Probe, verb: Verb, seen: str, shown: Mapping[Verb, Mapping[str, int]], what: str, when: str) -> None:
    effect = BY_VERB[verb]
    assert effect.expected is not None  # what a work mode and `respond` do is known
    probe.expect(seen, equal=effect.expected(probe.dialect, shown[verb]), refutes=f"{what} is not what was set {when}")
