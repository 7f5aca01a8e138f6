"""Restart, restore and power (MKS): what is stored stays, what is not is gone, and 3F puts the defaults back.

    restart/answered, back, standing      41 is answered, the drive comes back, and no motion goes on
    NAME/restart                          a setting that is not the default is there after a restart
    save_speed/restart, clean             a kept run begins again, a forgotten one does not
    set_zero_mode/return                  the shaft goes back to the kept zero when power comes on
    NAME/power                            and after an emulated drive's power was cut
    restore/settings, link                every setting that can be seen is the default, address and dialect too

Rules kept here:
- A setting that can be read is read, another one is seen by its effect (`effects`).
- How long a restart takes is not printed: it is only observed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.layout import Field
from conformance import journey, moving
from conformance.claim import Aspect, Claim, Inconclusive, Observed, Refuted, Theme
from conformance.claims import effects, ranges, ranges_link, read_back
from conformance.claims.answers import Taken, answers, judged, sound
from conformance.claims.declare import declare
from conformance.claims.effects import LINK_FIELDS, STEEP, Effect
from conformance.claims.known_quirks import known
from conformance.claims.restarts import power_cycle, restart, wait_for
from conformance.moving import MS
from conformance.probe import Probe

SLOW = "slow-restart"
#: Longer than this a restart is worth a word.
QUICK_NS = 1_000 * MS
_LOOK_NS = 100 * MS
#: How long a drive that cannot be asked meanwhile may take to come back.
RESTORED_NS = 4_000 * MS
_RPM = 60
_OTHER_ADDRESS = 0x5A


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about restart, restore and power."""
    if not journey.is_mks(dialect):
        return
    yield from _restart(dialect)
    for command in dialect.commands:
        effect = kept_effect(dialect, command)
        if effect is not None:
            yield _kept(dialect, command, effect, by_power=False)
            yield _kept(dialect, command, effect, by_power=True)
        if command.verb is Verb.WRITE_USER_ID:
            yield _user_id(dialect, command)
        if command.verb is Verb.SET_ADDRESS:
            yield _address(dialect, command)
        if command.verb is Verb.SAVE_SPEED:
            yield from _saved_run(dialect, command)
        if command.verb is Verb.SET_ZERO_MODE:
            yield from _return(dialect, command)
    yield _restore(dialect)
    yield _restored_link(dialect)


def kept_effect(dialect: Dialect, command: Command) -> Effect | None:
    """Return how a stored setting shows, None for those that do not show or that are judged otherwise."""
    named = set(command.request_forms[0].layout.named)
    if named & LINK_FIELDS or command.verb in (Verb.ENABLE,):
        return None
    return effects.of(dialect, command)


def needs(dialect: Dialect, command: Command, effect: Effect, *more: Risk) -> dict[str, Any]:
    """Return what a claim must declare that sets a setting and then does something with the risks `more`."""
    one, _ = effect.pair(command.request_forms[0])
    found = ranges.needs(dialect, command, [one])
    found["risks"] |= effect.risks(dialect) | set(more)
    found["settings"] = tuple(dict.fromkeys((*found["settings"], *effect.settings(dialect))))
    found["alone"] = found["alone"] or effect.alone
    return found


# --- the restart itself -----------------------------------------------------------------------------------------------


def _restart(dialect: Dialect) -> Iterator[Claim]:
    command = dialect.by_verb[Verb.RESTART]

    def answered(probe: Probe) -> None:
        taken, exchange = take_once(probe, command)
        wait_for(probe)
        if taken is not Taken.DONE:
            raise Refuted(
                f"{command.name} is {taken.value}", expected="success, before the drive restarts",
                got=taken.value, exchange=exchange, key="restart answer",
            )  # fmt: skip

    def back(probe: Probe) -> None:
        probe.do(command)
        took_ns = wait_for(probe, look_ns=_LOOK_NS)
        probe.measured["restart_s"] = took_ns / 1e9
        if took_ns > QUICK_NS:
            if SLOW not in probe.claim.quirks:
                raise Observed(f"the drive answers {took_ns / 1e9:.1f} s after a restart")
            probe.meets(SLOW)

    def standing(probe: Probe) -> None:
        moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
        moving.run_at(probe, _RPM)
        probe.wait(300 * MS)
        if abs(moving.speed(probe).value) < _RPM / 2:
            raise Inconclusive("the run before the restart turns nothing")
        exchange = restart(probe)
        rpm = moving.speed(probe).value
        if abs(rpm) > 1:
            moving.stand_still(probe)
            raise Refuted(f"after a restart the shaft turns at {rpm:.0f} rpm", expected="a shaft that stands",
                          got=f"{rpm:.0f} rpm", exchange=exchange, key="restart runs on")  # fmt: skip

    risks = command.all_risks
    yield declare(
        dialect, Theme.READ_BACK, "restart/answered", "A restart is answered with success before it happens.",
        "silence, or failure", answered, command=command, aspect=Aspect.STATE, risks=risks,
    )  # fmt: skip
    yield declare(
        dialect, Theme.READ_BACK, "restart/back", "A restarted drive answers again within a second.", "a longer silence", back,
        command=command, aspect=Aspect.STATE, risks=risks, at_best=Certainty.OPEN, quirks=known(dialect, SLOW),
    )  # fmt: skip
    yield declare(
        dialect, Theme.READ_BACK, "restart/standing", "A restart ends a run that was not kept for power-on.",
        "a shaft that turns on", standing, command=command, aspect=Aspect.STATE, at_best=Certainty.LIKELY,
        risks=risks | moving.risks(dialect, Risk.UNBOUNDED), settings=moving.settings(dialect),
    )  # fmt: skip


def take_once(probe: Probe, command: Command) -> tuple[Taken, Any]:
    """Return how a command was taken that cannot be sent twice: silence counts where reads were answered just before."""
    sound(probe)
    exchange = probe.ask(command)
    if exchange.junk:
        raise Inconclusive(f"the answer to {command.name} cannot be read: {exchange.junk[0].data.hex(' ').upper()}")
    if not exchange.answers:
        return Taken.SILENT, exchange
    return judged(probe, exchange), exchange


# --- settings ---------------------------------------------------------------------------------------------------------


def _kept(dialect: Dialect, command: Command, effect: Effect, *, by_power: bool) -> Claim:
    form = command.request_forms[0]

    def check(probe: Probe) -> None:
        values, _ = effect.pair(form)
        effect.ready(probe)
        ranges.prepare(probe, command)
        exchange = probe.do(command, ranges.plain(probe, command, form, **values))
        before = effect.see(probe)
        if by_power:
            power_cycle(probe)
        else:
            restart(probe)
        if effect.moves and command.verb is not Verb.SET_WORK_MODE:
            moving.ready_to_move(probe)
        after = effect.see(probe)
        if not effect.same(before, after):
            raise Refuted(
                f"{command.name} after {how}: {effect.words(after)}", expected=effect.words(before),
                got=effect.words(after), exchange=exchange, key=f"{command.name} lost",
            )  # fmt: skip

    how = "the power was cut" if by_power else "a restart"
    more = () if by_power else dialect.by_verb[Verb.RESTART].all_risks
    return declare(
        dialect, Theme.READ_BACK, f"{command.name}/{'power' if by_power else 'restart'}",
        f"What {command.name} set is there after {how}.", "another setting", check, command=command, aspect=Aspect.STATE,
        fields=tuple(form.layout.named), emulated=by_power, **needs(dialect, command, effect, *more),
    )  # fmt: skip


def _user_id(dialect: Dialect, command: Command) -> Claim:
    name = next(iter(command.request_forms[0].layout.named))
    value = 0x01020304

    def check(probe: Probe) -> None:
        probe.do(command, {name: value})
        exchange = restart(probe)
        got = probe.read(Verb.READ_USER_ID)
        read_back.compare(command, {name: value}, {name: got}, exchange, "after a restart")

    return declare(
        dialect, Theme.READ_BACK, f"{command.name}/restart", "A restart keeps the user's number.", "another number", check,
        command=command, aspect=Aspect.STATE, fields=(name,), settings=(name,),
        risks=command.all_risks | dialect.by_verb[Verb.RESTART].all_risks,
    )  # fmt: skip


def _address(dialect: Dialect, command: Command) -> Claim:
    def check(probe: Probe) -> None:
        before = probe.address
        sound(probe)
        ranges_link.readdress(probe, command, _OTHER_ADDRESS)
        if not answers(probe, _OTHER_ADDRESS):
            raise Inconclusive(f"the drive does not answer at {_OTHER_ADDRESS}, which it was given")
        exchange = probe.ask(Verb.RESTART, address=_OTHER_ADDRESS)
        probe.wait(RESTORED_NS)
        here, there = answers(probe, before), answers(probe, _OTHER_ADDRESS)
        if there:
            ranges_link.readdress(probe, command, before, at=_OTHER_ADDRESS)
        if not there:
            raise Refuted(
                "set_address: a restart loses the address", expected=f"an answer at {_OTHER_ADDRESS}",
                got=f"an answer at {before}" if here else "silence at both", exchange=exchange, key="set_address lost",
            )  # fmt: skip

    return declare(
        dialect, Theme.READ_BACK, f"{command.name}/restart", "A restart keeps the address.", "an answer at another address",
        check, command=command, aspect=Aspect.STATE, fields=("new_address",), settings=("new_address",), alone=True,
        risks=command.all_risks | dialect.by_verb[Verb.RESTART].all_risks,
        quirks=known(dialect, ranges_link.NEW_ADDRESS_ANSWERS),
    )  # fmt: skip


# --- what happens at power-on -----------------------------------------------------------------------------------------


def _saved_run(dialect: Dialect, command: Command) -> Iterator[Claim]:
    def turning(probe: Probe, rpm: int) -> float:
        moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
        moving.run_at(probe, rpm)
        probe.wait(400 * MS)
        return moving.speed(probe).value

    def after_restart(probe: Probe) -> tuple[float, Any]:
        exchange = restart(probe)
        probe.wait(600 * MS)
        return moving.speed(probe).value, exchange

    def forget(probe: Probe) -> None:
        probe.ask(command, {"save_state": 0xCA})
        moving.stand_still(probe)

    def again(rpm: int) -> Callable[[Probe], None]:
        def check(probe: Probe) -> None:
            before = turning(probe, rpm)
            probe.do(command, {"save_state": 0xC8})
            moving.stand_still(probe)
            after, exchange = after_restart(probe)
            forget(probe)
            if abs(after - before) > max(2.0, abs(before) * _SHARE):
                raise Refuted(
                    f"a kept run at {before:.0f} rpm is one at {after:.0f} rpm after a restart", expected=f"{before:.0f} rpm",
                    got=f"{after:.0f} rpm", exchange=exchange, key="saved run",
                )  # fmt: skip

        return check

    def clean(probe: Probe) -> None:
        turning(probe, _RPM)
        probe.do(command, {"save_state": 0xC8})
        probe.do(command, {"save_state": 0xCA})
        moving.stand_still(probe)
        after, exchange = after_restart(probe)
        if abs(after) > 1:
            forget(probe)
            raise Refuted(f"a forgotten run turns the shaft at {after:.0f} rpm after a restart", expected="a shaft that stands",
                          got=f"{after:.0f} rpm", exchange=exchange, key="clean run")  # fmt: skip

    risks = command.risks({"save_state": 0xC8}) | command.risks({"save_state": 0xCA})
    risks |= moving.risks(dialect, Risk.UNBOUNDED) | dialect.by_verb[Verb.RESTART].all_risks
    errata = ("mks-can-67",)
    for name, statement, refuted_by, check in (
        ("restart", "A run that was kept begins again when power comes on.", "another speed, or none", again(_RPM)),
        ("direction", "A kept run the other way turns that way when power comes on.", "the other way", again(-_RPM)),
        ("clean", "A run that was forgotten does not begin when power comes on.", "a shaft that turns", clean),
    ):
        yield declare(
            dialect, Theme.READ_BACK, f"{command.name}/{name}", statement, refuted_by, check, command=command,
            aspect=Aspect.STATE, errata=errata, risks=risks, settings=moving.settings(dialect), fields=("save_state",),
        )  # fmt: skip


_SHARE = 0.1


def _return(dialect: Dialect, command: Command) -> Iterator[Claim]:
    """Make the claims about the way back to zero at power-on: a shaft a quarter of a turn away goes back to it."""

    def gone(probe: Probe, quarter: int, **values: int) -> tuple[int, Any]:
        """Keep zero here, move away by `quarter` counts, restart, and return how far the shaft went by itself."""
        moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
        plain = {"zero_mode": 2, "set_zero": 1, "zero_speed": 2, "zero_direction": 0}
        probe.do(command, plain | values)
        effects.shift(probe, Verb.MOVE_RELATIVE_AXIS, {"speed": 60, "acceleration": STEEP, "position": quarter})
        before = within_turn(probe)
        exchange = restart(probe)
        moving.wait_standing(probe)
        probe.wait(1_500 * MS)
        moving.wait_standing(probe)
        # The way back makes its end the zero, so that the turn is what it counts from.
        return before, exchange

    def near(probe: Probe) -> None:
        before, exchange = gone(probe, 4096)
        status = probe.read(Verb.READ_ZERO_STATUS)
        now = within_turn(probe)
        probe.do(command, {"zero_mode": 0, "set_zero": 0, "zero_speed": 0, "zero_direction": 0})
        if status != 1 or min(now, 16384 - now) > 100:
            raise Refuted(
                f"the shaft is at {now} counts within the turn after power-on, and 3B says {status}",
                expected="zero, and 3B 1", got=f"{now} (before: {before}), 3B {status}", exchange=exchange, key="zero mode",
            )  # fmt: skip

    def way(probe: Probe, direction: int) -> tuple[bool, Any]:
        """Let the shaft go back by a direction; return whether it began by raising the encoder."""
        moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
        probe.do(command, {"zero_mode": 1, "set_zero": 1, "zero_speed": 0, "zero_direction": direction})
        effects.shift(probe, Verb.MOVE_RELATIVE_AXIS, {"speed": 60, "acceleration": STEEP, "position": 8000})
        exchange = restart(probe)
        rpm = moving.speed(probe).value
        moving.wait_standing(probe)
        if abs(rpm) < 1:
            raise Inconclusive("the shaft does not turn after power-on")
        return rpm > 0, exchange

    def directed(probe: Probe) -> None:
        (one, _), (other, exchange) = way(probe, 0), way(probe, 1)
        probe.do(command, {"zero_mode": 0, "set_zero": 0, "zero_speed": 0, "zero_direction": 0})
        if one == other:
            raise Refuted(
                "zero_direction 0 and 1 go back the same way", expected="opposite ways",
                got="the encoder rises both times" if one else "the encoder falls both times", exchange=exchange,
                key="zero direction",
            )  # fmt: skip

    def off(probe: Probe) -> None:
        before, exchange = gone(probe, 4096, zero_mode=0)
        now = within_turn(probe)
        if min((now - before) % 16384, (before - now) % 16384) > 100:
            raise Refuted("with zero_mode 0 the shaft moves at power-on", expected=f"{before}", got=f"{now}", exchange=exchange)

    risks = command.risks({"zero_mode": 2}) | command.risks({"zero_mode": 0})
    risks |= moving.risks(dialect) | dialect.by_verb[Verb.RESTART].all_risks
    fields = tuple(command.request_forms[0].layout.named)
    for name, statement, refuted_by, check in (
        ("return", "With a zero kept, the shaft goes back to it when power comes on.", "another place", near),
        ("direction", "By zero_mode 1 the shaft goes back the way that was set.", "the same way for both", directed),
        ("off", "With zero_mode 0 the shaft stays where it is when power comes on.", "a shaft that moves", off),
    ):
        yield declare(
            dialect, Theme.READ_BACK, f"{command.name}/{name}", statement, refuted_by, check, command=command,
            aspect=Aspect.STATE, at_best=Certainty.LIKELY, risks=risks, settings=moving.settings(dialect, *fields),
            fields=fields,
        )  # fmt: skip


def within_turn(probe: Probe) -> int:
    """Return where the shaft is within the turn, in counts."""
    return probe.read(Verb.READ_ENCODER_CARRY, "encoder")


# --- restore ----------------------------------------------------------------------------------------------------------


def defaults(field: Field) -> set[int]:
    """Return the values that a field may have by default: of its model, or of all where that is not known."""
    if field.default is not None:
        return {int(field.default)}
    return {limit.default for limit in (field.models or {}).values() if limit.default is not None}


def _settings(dialect: Dialect) -> list[tuple[Command, Effect]]:
    found = [(c, kept_effect(dialect, c)) for c in dialect.commands if c.verb is not Verb.SET_GROUP_ADDRESS]
    return [(c, e) for c, e in found if e is not None]


def _restore(dialect: Dialect) -> Claim:
    command = dialect.by_verb[Verb.RESTORE]
    settings = _settings(dialect)
    risks = set(command.all_risks) | {Risk.SETTING}
    for each, effect in settings:
        one, _ = effect.pair(each.request_forms[0])
        seen = each.readable or effect.expected is not None
        risks |= ranges.needs(dialect, each, [one])["risks"] | (effect.risks(dialect) if seen else moving.risks(dialect))

    def check(probe: Probe) -> None:
        for each, effect in settings:
            effect.ready(probe)
            ranges.prepare(probe, each)
        for each, effect in settings:
            form = each.request_forms[0]
            probe.do(each, ranges.plain(probe, each, form, **effect.pair(form)[0]))
        exchange = probe.do(command)
        lead_back(probe)
        if not answers(probe, probe.address):
            raise Inconclusive("the restored drive cannot be reached as it is said to be by default")
        for each, effect in settings:
            _is_default(probe, each, effect, exchange)

    return declare(
        dialect, Theme.READ_BACK, "restore/settings", "A restore puts every setting back to its default.",
        "a setting that is as it was", check, command=command, aspect=Aspect.STATE, risks=risks, by_name=True, alone=True,
    )  # fmt: skip


def lead_back(probe: Probe) -> None:
    """Wait for a restored drive and lead it from the default speed, dialect and address back to those of this probe.

    Raises NotRun where this end cannot change its speed.
    """
    dialect = probe.dialect
    before, usual = probe.gate.line.endpoint.bits_per_second, dialect.baud_rates[0]
    if before != usual:
        ranges_link.follow(probe, usual)
    probe.wait(RESTORED_NS)
    if Verb.SET_MODBUS in dialect.by_verb:
        spoken = int(dialect.name.endswith("modbus"))
        ranges_link.foreign(probe, registry.get("mks-rs485"), "set_modbus", {"modbus": spoken}, address=_DEFAULT_ADDRESS)
    if probe.address != _DEFAULT_ADDRESS:
        probe.ask(Verb.SET_ADDRESS, {"new_address": probe.address}, address=_DEFAULT_ADDRESS)
        probe.wait(ranges_link.SETTLE_NS)
    if before != usual:
        ranges_link.set_speed(probe, before)
        ranges_link.follow(probe, before)
        probe.wait(ranges_link.SETTLE_NS)


def _is_default(probe: Probe, command: Command, effect: Effect, exchange: Any) -> None:
    form = command.request_forms[0]
    if command.readable:
        got, _ = read_back.stored(probe, command)
        for name, value in got.items():
            wanted = defaults(form.layout.named[name])
            if wanted and value not in wanted:
                expected = " or ".join(map(str, sorted(wanted)))
                raise Refuted(
                    f"{command.name}: {name} is {value} after a restore", expected=expected, got=str(value), exchange=exchange,
                    key=f"{command.name} restore",
                )  # fmt: skip
        return
    wanted_values = {n: min(d) for n, f in form.layout.named.items() if (d := defaults(f))}
    if effect.expected is None or wanted_values.keys() != form.layout.named.keys():
        return
    if command.verb is not Verb.SET_WORK_MODE:
        effect.ready(probe)
    seen, should = effect.see(probe), effect.expected(probe.dialect, wanted_values)
    if not effect.same(should, seen):
        raise Refuted(
            f"{command.name} after a restore: {effect.words(seen)}", expected=effect.words(should), got=effect.words(seen),
            exchange=exchange, key=f"{command.name} restore",
        )  # fmt: skip


def _restored_link(dialect: Dialect) -> Claim:
    """Make the claim that a restore puts back the address, and the dialect that the drive speaks."""
    command = dialect.by_verb[Verb.RESTORE]
    setter = dialect.by_verb[Verb.SET_ADDRESS]
    native = registry.get("mks-rs485") if dialect.name.endswith("modbus") else dialect

    def check(probe: Probe) -> None:
        sound(probe)
        ranges_link.readdress(probe, setter, _OTHER_ADDRESS)
        if not answers(probe, _OTHER_ADDRESS):
            raise Inconclusive(f"the drive does not answer at {_OTHER_ADDRESS}, which it was given")
        exchange = probe.ask(command, address=_OTHER_ADDRESS)
        probe.wait(RESTORED_NS)
        if dialect is native:
            found = [a for a in (_DEFAULT_ADDRESS, _OTHER_ADDRESS) if answers(probe, a)]
        else:
            found = [a for a in (_DEFAULT_ADDRESS, _OTHER_ADDRESS) if _answers_in(probe, native, a)]
        lead_back(probe)
        if found != [_DEFAULT_ADDRESS]:
            places = " and ".join(map(str, found)) or "neither address"
            raise Refuted(
                f"a restored drive answers at {places} in {native.name}",
                expected=f"an answer at {_DEFAULT_ADDRESS} in {native.name}", got=places, exchange=exchange, key="restore link",
            )  # fmt: skip

    return declare(
        dialect, Theme.READ_BACK, "restore/link", f"A restored drive answers at {_DEFAULT_ADDRESS} in {native.name}.",
        "an answer at the old address or in another dialect", check, command=command, aspect=Aspect.STATE, by_name=True,
        alone=True, risks=command.all_risks | setter.all_risks, quirks=known(dialect, ranges_link.NEW_ADDRESS_ANSWERS),
    )  # fmt: skip


_DEFAULT_ADDRESS = 1


def _answers_in(probe: Probe, dialect: Dialect, address: int) -> bool:
    answer = ranges_link.foreign(probe, dialect, "read_speed", address=address)
    ranges_link.readable(dialect, address, answer)
    return ranges_link.whole(dialect, address, answer)
