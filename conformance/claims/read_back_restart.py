"""Restart and power (MKS): what is stored stays.

    NAME/restart                          a setting that is not the default is there after a restart
    save_speed/restart, clean             a kept run begins again, a forgotten one does not
    set_zero_mode/restart                 the shaft goes back to the kept zero
    NAME/power                            and after an emulated drive's power was cut

Rules kept here:
- A setting that can be read is read, another one is seen by its effect (`effects`).
- What a restart does to motion, and how long it takes, is for other themes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims import effects, ranges, ranges_link, read_back
from conformance.claims.declare import declare
from conformance.claims.effects import LINK_FIELDS, STEEP, Effect
from conformance.claims.known_quirks import known
from conformance.motion import motion
from conformance.motion import moves as journey
from conformance.motion.motion import MS
from conformance.talk.acceptance import answers, need_reliable_replies
from conformance.talk.probe import Probe
from conformance.talk.restarts import power_cycle, restart

#: How long a drive that cannot be asked meanwhile may take to come back.
RESTORED_NS = 4_000 * MS
_RPM = 60
OTHER_ADDRESS = 0x5A


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about restart, restore and power."""
    if not journey.is_mks(dialect):
        return
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
            yield _return(dialect, command)


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
            motion.ready_to_move(probe)
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
        need_reliable_replies(probe)
        ranges_link.readdress(probe, command, OTHER_ADDRESS)
        if not answers(probe, OTHER_ADDRESS):
            raise Inconclusive(f"the drive does not answer at {OTHER_ADDRESS}, which it was given")
        exchange = probe.ask(Verb.RESTART, address=OTHER_ADDRESS)
        probe.wait(RESTORED_NS)
        here, there = answers(probe, before), answers(probe, OTHER_ADDRESS)
        if there:
            ranges_link.readdress(probe, command, before, at=OTHER_ADDRESS)
        if not there:
            raise Refuted(
                "set_address: a restart loses the address", expected=f"an answer at {OTHER_ADDRESS}",
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
        motion.ready_to_move(probe, subdivision=journey.SUBDIVISION)
        motion.run_at(probe, rpm)
        probe.wait(400 * MS)
        return motion.speed(probe).value

    def after_restart(probe: Probe) -> tuple[float, Any]:
        exchange = restart(probe)
        probe.wait(600 * MS)
        return motion.speed(probe).value, exchange

    def forget(probe: Probe) -> None:
        probe.ask(command, {"save_state": 0xCA})
        motion.stand_still(probe)

    def again(rpm: int) -> Callable[[Probe], None]:
        def check(probe: Probe) -> None:
            before = turning(probe, rpm)
            probe.do(command, {"save_state": 0xC8})
            motion.stand_still(probe)
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
        motion.stand_still(probe)
        after, exchange = after_restart(probe)
        if abs(after) > 1:
            forget(probe)
            raise Refuted(f"a forgotten run turns the shaft at {after:.0f} rpm after a restart", expected="a shaft that stands",
                          got=f"{after:.0f} rpm", exchange=exchange, key="clean run")  # fmt: skip

    risks = command.risks({"save_state": 0xC8}) | command.risks({"save_state": 0xCA})
    risks |= motion.risks(dialect, Risk.UNBOUNDED) | dialect.by_verb[Verb.RESTART].all_risks
    for name, statement, refuted_by, check in (
        ("restart", "A run that was kept begins again after a restart, the same way.", "another speed, or none", again(-_RPM)),
        ("clean", "A run that was forgotten does not begin after a restart.", "a shaft that turns", clean),
    ):
        yield declare(
            dialect, Theme.READ_BACK, f"{command.name}/{name}", statement, refuted_by, check, command=command,
            aspect=Aspect.STATE, rests_on=(Doubt.VALUES,), risks=risks, settings=motion.settings(dialect),
            fields=("save_state",),
        )  # fmt: skip


#: Speeds that are one, as a share; counts within which a shaft is where it should be.
_SHARE, _PLAY = 0.1, 100


def _return(dialect: Dialect, command: Command) -> Claim:
    """Make the claim about the way back to zero at power-on: a shaft a quarter of a turn away goes back to it."""

    def check(probe: Probe) -> None:
        motion.ready_to_move(probe, subdivision=journey.SUBDIVISION)
        probe.do(command, {"zero_mode": 2, "set_zero": 1, "zero_speed": 2, "zero_direction": 0})
        effects.shift(probe, Verb.MOVE_RELATIVE_AXIS, {"speed": 60, "acceleration": STEEP, "position": COUNTS_PER_TURN // 4})
        before = within_turn(probe)
        exchange = restart(probe)
        probe.wait(1_500 * MS)
        motion.wait_standing(probe)
        status, now = probe.read(Verb.READ_ZERO_STATUS), within_turn(probe)
        probe.do(command, {"zero_mode": 0, "set_zero": 0, "zero_speed": 0, "zero_direction": 0})
        # The way back makes its end the zero, so that the turn is what it counts from.
        if status != 1 or min(now, COUNTS_PER_TURN - now) > _PLAY:
            raise Refuted(
                f"the shaft is at {now} counts within the turn after a restart, and 3B says {status}",
                expected="zero, and 3B 1", got=f"{now} (before: {before}), 3B {status}", exchange=exchange, key="zero mode",
            )  # fmt: skip

    risks = command.risks({"zero_mode": 2}) | command.risks({"zero_mode": 0})
    fields = tuple(command.request_forms[0].layout.named)
    return declare(
        dialect, Theme.READ_BACK, f"{command.name}/restart", "With a zero kept, the shaft goes back to it after a restart.",
        "another place", check, command=command, aspect=Aspect.STATE, at_best=Certainty.LIKELY, fields=fields,
        risks=risks | motion.risks(dialect) | dialect.by_verb[Verb.RESTART].all_risks,
        settings=motion.settings(dialect, *fields),
    )  # fmt: skip


def within_turn(probe: Probe) -> int:
    """Return where the shaft is within the turn, in counts."""
    return probe.read(Verb.READ_ENCODER_CARRY, "encoder")
