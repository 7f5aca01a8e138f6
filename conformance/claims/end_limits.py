"""End limits: with the limit on, a shaft does not run beyond a closed end stop, and motion away from it goes on.

Tried on emulated drives, where end stops are where a claim mounts them: the left one is found by homing and is then zero,
the right one stands two turns from it.

Rules kept here:
- A changed limit holds only after homing, so every claim homes first.
- A move that a limit ends says 3. What a run says when it is to go on towards a closed limit is not printed.
- Drives were seen to ignore the command that follows a limit stop (quirk deaf-after-limit-stop): it is sent again.
- A right limit is there on a 57, and on the smaller drives once the ports are remapped.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Command, Dialect, Verb
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance.claim import Claim, Inconclusive, NotRun
from conformance.claims import homing, world
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.motion import motion
from conformance.motion import moves as journey
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe, Until

_JITTER = 3
#: Where the left end stop is found, and how far from it the right one stands.
_LEFT, _RIGHT = -3000, 2 * COUNTS_PER_TURN
_HALF = 8000
_DEAF = "deaf-after-limit-stop"


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about end limits."""
    setting, run = dialect.by_verb[Verb.SET_HOME], dialect.by_verb[Verb.RUN_SPEED]
    home, remap = dialect.by_verb[Verb.HOME], dialect.by_verb.get(Verb.SET_LIMIT_REMAP)
    risks = run.all_risks | home.all_risks | setting.all_risks
    made = partial(motion_claim, dialect, emulated=True, risks=risks, settings=(*_fields(setting), "limit_remap"))
    for command in (run, *journey.moves(dialect)):
        yield made(
            setting,
            f"end-limit-stops-{command.name}",
            f"With the end limit on, {command.name} towards the left stops at its end stop.",
            "a shaft that runs beyond it",
            partial(_stops_at, command.name),
        )
        yield made(
            setting,
            f"end-limit-holds-{command.name}",
            f"With the end limit on, {command.name} towards an end stop that is closed turns nothing.",
            "a shaft that runs beyond it",
            partial(_holds_at, command.name),
            quirks=known(dialect, _DEAF),
        )
    yield made(
        setting,
        "end-limit-lets-back",
        "With the end limit on, a move away from a closed end stop is carried out.",
        "a refusal, or no motion",
        _lets_back,
        quirks=known(dialect, _DEAF),
    )
    yield made(
        setting,
        "end-limit-off",
        "With the end limit off, the end stop does not stop the shaft.",
        "a shaft that stops at it",
        _off_passes,
    )
    if journey.tells(dialect):
        for command in journey.moves(dialect):
            yield made(
                setting,
                f"end-limit-told-{command.name}",
                f"{command.name} that an end limit stops is answered by 1 and then by 3.",
                "another status",
                partial(_told, command.name),
            )
    if remap is not None:
        for value in (0, 1):
            yield made(
                remap,
                f"right-{'on' if value else 'off'}",
                "With the ports remapped the right end stop holds." if value else
                "Without remapped ports the right end stop holds on a 57 and not on a smaller drive.",
                "a right limit that is there, or is not, against this",
                partial(_right, value),
                models=remap.models,
            )  # fmt: skip


def _fields(setting: Command) -> tuple[str, ...]:
    return tuple(setting.request_forms[0].layout.named)


def _homed(probe: Probe, end_limit: int = 1) -> None:
    """Find the left end stop and go back half a turn from it; the right one stands beyond."""
    motion.ready_to_move(probe, subdivision=journey.SUBDIVISION)
    homing.set_home(probe, end_limit=end_limit, home_speed=60)
    world.left_switch(probe, _LEFT)
    world.right_switch(probe, _LEFT + _RIGHT)
    homing.find_home(probe)
    probe.wait(500 * MS)
    # Homing may have let the shaft go.
    probe.do(Verb.ENABLE, {"enabled": 1})
    _go(probe, _HALF)


def _go(probe: Probe, counts: int) -> Exchange:
    """Move by counts of the encoder, positive to the right, and wait for the end."""
    trip = journey.travel(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), amount=counts)
    if abs(trip.degrees - counts * 360 / COUNTS_PER_TURN) > motion.SAME:
        raise Inconclusive(f"a move by {counts} counts between the end stops went {trip.degrees:+.2f} degrees")
    return trip.exchange


def _values(probe: Probe, command: Command, way: int) -> dict[str, int]:
    """Return the values of a long motion to the left (-1) or the right (1), whatever its bits turn."""
    if "direction" in command.request_forms[0].layout.named:
        sense = _sense(probe, command)
        direction = int(sense != way)
        values = {"direction": direction, "speed": 120, "acceleration": QUICK}
        return values if command.verb is Verb.RUN_SPEED else {**values, "pulses": 3200 * 4}
    amount = 4 * journey.units_per_turn(command) * way
    if command.verb is Verb.MOVE_ABSOLUTE_PULSES and _sense(probe, command) < 0:
        amount = -amount
    return journey.values_of(command, amount, 120, QUICK, journey.place(probe, command))


def _sense(probe: Probe, command: Command) -> int:
    """Return which way direction 0, or a greater position, turns the shaft: 1 where counts rise."""
    before = motion.position(probe)
    if command.verb is Verb.RUN_SPEED:
        motion.run_at(probe, 30, QUICK)
        probe.wait(200 * MS)
        after = motion.stand_still(probe)
    else:
        after = journey.travel(probe, command, 0.02, acceleration=QUICK).end
    return 1 if after.value > before.value else -1


def _send_left(probe: Probe, name: str, until: Until = Until.REPLY) -> Exchange:
    command = probe.command(name)
    exchange = probe.ask(command, _values(probe, command, -1), until=until, timeout_ns=10 * SECOND_NS)
    probe.reply(exchange)
    probe.wait(3 * SECOND_NS)
    return exchange


def _expect_at_left(probe: Probe, exchange: Exchange, text: str) -> None:
    seen = probe.read(Verb.READ_POSITION, "position")
    if abs(seen) > _JITTER:
        motion.stop(probe)
        raise refute(exchange, text, expected="0, where the end stop is", got=str(seen))


def _stops_at(name: str, probe: Probe, setting: Command) -> None:
    _homed(probe)
    exchange = _send_left(probe, name)
    _expect_at_left(probe, exchange, f"{name} does not stop at an end limit")


def _heard(probe: Probe, command: Command, values: dict[str, int], until: Until = Until.REPLY) -> Exchange:
    """Ask for a motion after a limit stop; where it is not heard, as was seen of real drives, ask again."""
    exchange = probe.ask(command, values, until=until, timeout_ns=10 * SECOND_NS)
    if exchange.silent and _DEAF in probe.claim.quirks:
        exchange = probe.ask(command, values, until=until, timeout_ns=10 * SECOND_NS)
        if not exchange.silent:
            probe.meets(_DEAF)
    probe.reply(exchange)
    return exchange


def _holds_at(name: str, probe: Probe, setting: Command) -> None:
    _homed(probe)
    command = probe.command(name)
    values = _values(probe, command, -1)
    _send_left(probe, probe.command(Verb.MOVE_RELATIVE_AXIS).name)
    before = motion.position(probe)
    exchange = _heard(probe, command, values)
    probe.wait(2 * SECOND_NS)
    after = motion.position(probe)
    motion.stop(probe)
    expect_stays(before, after, exchange, f"{name} towards a closed end limit turns the shaft")


def _lets_back(probe: Probe, setting: Command) -> None:
    _homed(probe)
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    _send_left(probe, move.name)
    before = motion.position(probe)
    exchange = _heard(probe, move, journey.values_of(move, 4000, 120, QUICK))
    probe.wait(2 * SECOND_NS)
    went = motion.wait_standing(probe).value - before.value
    if probe.refused(exchange) or abs(went - 4000 * 360 / COUNTS_PER_TURN) > 1:
        text = "a move away from an end limit is not carried out"
        raise refute(exchange, text, expected=f"{4000 * 360 / COUNTS_PER_TURN:+.1f} degrees", got=f"{went:+.1f} degrees")


def _off_passes(probe: Probe, setting: Command) -> None:
    _homed(probe, end_limit=0)
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    trip = journey.travel(probe, move, amount=-_HALF - 4000)
    expected = (-_HALF - 4000) * 360 / COUNTS_PER_TURN
    if abs(trip.degrees - expected) > motion.SAME:
        text = "an end stop stops the shaft although the end limit is off"
        raise refute(trip.exchange, text, expected=f"{expected:+.1f} degrees", got=f"{trip.degrees:+.1f} degrees")


def _told(name: str, probe: Probe, setting: Command) -> None:
    _homed(probe)
    command = probe.command(name)
    values = _values(probe, command, -1)
    since = len(probe.traffic)
    exchange = probe.ask(command, values, until=Until.DONE, timeout_ns=10 * SECOND_NS)
    probe.wait(2 * SECOND_NS)
    told = [a.values["status"] for a in journey.told(probe.traffic[since:], command)]
    if told != [1, 3]:
        got = ", ".join(map(str, told)) or "none"
        raise refute(exchange, f"{name} that an end limit stops is not answered 1 and 3", expected="1, 3", got=got)


def _right(remap: int, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    probe.do(command, {"limit_remap": remap})
    _homed(probe)
    large = world.drive_of(probe).model.startswith("57")
    wanted = bool(remap) or large
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    exchange = probe.ask(move, journey.values_of(move, 4 * COUNTS_PER_TURN, 120, QUICK))
    if journey.refused(probe, exchange):
        raise NotRun("the move was refused")
    probe.wait(5 * SECOND_NS)
    seen = probe.read(Verb.READ_POSITION, "position")
    stopped = abs(seen - _RIGHT) <= _JITTER
    if stopped is not wanted:
        expected = f"{_RIGHT}, where the right end stop is" if wanted else f"{_HALF + 4 * COUNTS_PER_TURN}"
        text = f"with limit_remap {remap} the right end stop {'does not hold' if wanted else 'holds'}"
        raise refute(exchange, text, expected=expected, got=str(seen))
