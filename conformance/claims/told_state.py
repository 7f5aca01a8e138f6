"""What LK motors tell of their state in several replies: it is one state, whichever reply tells it.

    9A 9B            temperature, voltage, current, state and errors
    9C, motions      temperature, torque current, speed, encoder
    9D               temperature, phase currents

A value that one command alone gets wrong shows beside the others. All of it runs on any drive.

Rules kept here:
- What is compared is read within one moment, before and after, and may lie anywhere between.
- Encoders are compared by their low 14 bits, which every width has.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claims import bench
from conformance.claims.declare import Case, commands
from conformance.claims.encoder_zero import named
from conformance.claims.motion_claim import of_motion, risks_by
from conformance.claims.motion_reads import PLACES, turn_by
from conformance.claims.stops import endless
from conformance.motion import motion
from conformance.motion.motion import MOVES, MS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: A turn of the encoder that has the fewest bits, and the counts of the finest one in one of its counts.
_TURN, _FINEST = 1 << 14, 4
#: The supply current of a motor that stands and holds nothing, at most (0.01 A).
_AT_REST = 300
_still = partial(of_motion, still=True)


def _told(probe: Probe, command: Command | Verb, values: Mapping[str, int] | None = None) -> tuple[Mapping[str, int], Exchange]:
    exchange = probe.ask(command, values, quiet_ns=0)
    return probe.reply(exchange).values, exchange


def _expect_same_temperature(probe: Probe, seen: int, wanted: int, command: Command, exchange: Exchange) -> None:
    text = f"{command.name} tells another temperature than 9A"
    probe.expect(seen, near=wanted, unit="degC", refutes=text, exchange=exchange)


def _unit(command: Command, name: str) -> str:
    """Return the unit of a field of a reply as it is sent, empty where it is no measured quantity."""
    field = command.reply_forms[0].layout.named[name]
    return f"{float(field.scale):g} {field.unit}" if field.unit else ""


@_still(each=commands(Verb.READ_STATE_2, Verb.READ_STATE_3), refuted_by="another temperature", name="{command}/temperature")
def _temperature(probe: Probe, command: Command) -> None:
    """{command} tells the temperature that 9A tells."""
    wanted, _ = _told(probe, Verb.READ_STATE_1)
    seen, exchange = _told(probe, command)
    _expect_same_temperature(probe, seen["temperature"], wanted["temperature"], command, exchange)


def _tells_temperature(dialect: Dialect) -> Iterable[Case]:
    return (Case(dialect, c) for c in dialect.commands if c.motion is None and _has_temperature(c))


def _has_temperature(command: Command) -> bool:
    return any("temperature" in form.layout.named for form in command.reply_forms)


@_still(
    each=_tells_temperature, refuted_by="the temperature of another time", name="{command}/follows-temperature", emulated=True
)
def _follows_temperature(probe: Probe, command: Command) -> None:
    """{command} tells the temperature that the motor has then, below zero too."""
    for degrees in (41, -7, -40, 125, 30):
        bench.lk_drive(probe).hot(degrees)
        seen, exchange = _told(probe, command)
        text = f"{command.name} does not tell the temperature of the motor"
        probe.expect(seen["temperature"], equal=degrees, refutes=text, exchange=exchange)


@_still(each=commands(Verb.READ_STATE_1), refuted_by="a current that no resting motor takes", at_best=Certainty.LIKELY)
def _current_at_rest(probe: Probe, command: Command) -> None:
    """The supply current of a motor that stands is small."""
    seen, exchange = _told(probe, command)
    text = "a motor that stands takes a current that no resting motor takes"
    probe.expect(seen["current"], at_least=-_AT_REST, at_most=_AT_REST, unit="x 0.01 A", refutes=text, exchange=exchange)


@of_motion(
    each=commands(Verb.READ_STATE_1),
    refuted_by="state 10h, or an error flag",
    risks=risks_by(Verb.RUN_SPEED),
    name="{command}/turning",
)
def _on_while_turning(probe: Probe, command: Command) -> None:
    """A motor that turns reads state 00h, with the error flags and the temperature that it had at rest."""
    motion.ready_to_move(probe)
    at_rest, _ = _told(probe, command)
    endless(probe, probe.command(Verb.RUN_SPEED))
    seen, exchange = _told(probe, command)
    motion.stand_still(probe)
    _expect_same_temperature(probe, seen["temperature"], at_rest["temperature"], command, exchange)
    for name in sorted(seen.keys() - {"temperature", "voltage", "current"}):
        text = f"a motor that turns reads another {name} than at rest"
        probe.expect(seen[name], equal=at_rest[name], refutes=text, exchange=exchange)


@of_motion(each=commands(Verb.CLEAR_ERRORS), refuted_by="another state", at_best=Certainty.LIKELY, risks={Risk.TORQUE})
def _tells_state(probe: Probe, command: Command) -> None:
    """{command} is answered with what 9A then tells, of a motor that is on and of one that is off, and switches nothing."""
    for on in (True, False):
        motion.switch(probe, on)
        seen, exchange = _told(probe, command)
        wanted, _ = _told(probe, Verb.READ_STATE_1)
        for name, value in wanted.items():
            text, unit = f"{command.name} is answered with another {name} than 9A tells", _unit(command, name)
            within = probe.within(unit) if unit else 0
            probe.expect(seen[name], near=value, within=within, refutes=text, exchange=exchange)
        text = f"{command.name} switches the motor on or off"
        probe.expect(motion.is_on(probe), equal=on, refutes=text, exchange=exchange)
    motion.switch(probe, True)


def _of_motions(dialect: Dialect) -> Iterable[Case]:
    for command in dialect.motions(*MOVES, MotionKind.RUN, MotionKind.TORQUE) if Verb.READ_STATE_2 in dialect.by_verb else ():
        yield Case(dialect, command)


@of_motion(each=_of_motions, refuted_by="another temperature, speed or encoder", name="{command}/tells-state")
def _motion_tells_state(probe: Probe, command: Command) -> None:
    """{command} is answered with the temperature, speed and encoder that 9C tells, at rest and while the shaft turns."""
    motion.ready_to_move(probe)
    motion.wait_standing(probe)
    before, _ = _told(probe, Verb.READ_STATE_2)
    exchange = endless(probe, command)
    at_rest = probe.reply(exchange).values
    _expect_between(probe, command, exchange, (before, before), at_rest)
    first, _ = _told(probe, Verb.READ_STATE_2)
    exchange = probe.ask(command, exchange.values, quiet_ns=0)
    told = probe.reply(exchange).values
    last, _ = _told(probe, Verb.READ_STATE_2)
    motion.stand_still(probe)
    _expect_between(probe, command, exchange, (first, last), told)


def _expect_between(
    probe: Probe,
    command: Command,
    exchange: Exchange,
    between: tuple[Mapping[str, int], Mapping[str, int]],
    told: Mapping[str, int],
) -> None:
    """Refute unless a reply tells what 9C told before and after it, or something between."""
    first, last = between
    _expect_same_temperature(probe, told["temperature"], first["temperature"], command, exchange)
    low, high = sorted((first["speed"], last["speed"]))
    # What 9C told is off by the noise too.
    slack = probe.within("deg/s", high)
    text = f"{command.name} is answered with another speed than 9C tells"
    probe.expect(told["speed"], at_least=low - slack, at_most=high + slack, unit="deg/s", refutes=text, exchange=exchange)
    gone, way = ((values["encoder"] - first["encoder"]) % _TURN for values in (told, last))
    slack = _FINEST * probe.within("counts")
    probe.expect(
        str(told["encoder"]),
        holds=(gone + slack) % _TURN <= way + 2 * slack,
        expected=f"{first['encoder']} to {last['encoder']}, as 9C tells",
        refutes=f"{command.name} is answered with another encoder value than 9C tells",
        exchange=exchange,
    )


@of_motion(each=named("read_single_turn"), refuted_by="another angle", at_best=Certainty.LIKELY, name="{command}/is-encoder")
def _angle_is_encoder(probe: Probe, command: Command) -> None:
    """The angle within the turn is what the encoder tells, as a share of its range."""
    motion.ready_to_move(probe)
    widths = {14, 15, 16}
    for degrees in PLACES:
        turn_by(probe, degrees)
        encoder, _ = _told(probe, Verb.READ_ENCODER)
        angle, exchange = _told(probe, command)
        off = {w: abs(encoder["encoder"] * 36_000 / (1 << w) - angle["angle"]) for w in widths}
        widths = {w for w, by in off.items() if min(by, 36_000 - by) <= 50}
        probe.expect(
            f"{angle['angle'] / 100:.2f} degrees beside encoder {encoder['encoder']}",
            holds=bool(widths),
            expected="the share that the encoder is of 14, 15 or 16 bits",
            refutes="the angle within the turn is not that of the encoder",
            exchange=exchange,
        )


# --- where the shaft is, while it turns -------------------------------------------------------------------------------

#: Slow and fast, either way (rpm); how often a read is looked at, and how long after the one before.
_SPEEDS, _ROUNDS, _BETWEEN_NS = (15, -15, 60, -60), 3, 37 * MS
#: Degrees by which a reading may be off beside the way of the shaft, and how old it may be.
_OFF, _OLD_S = 2.0, 0.02
#: What is read of the place within the turn, and how many units a turn may have.
_WITHIN_TURN = {
    Verb.READ_ENCODER: ("encoder", (1 << 14, 1 << 15, 1 << 16)),
    Verb.READ_STATE_2: ("encoder", (1 << 14, 1 << 15, 1 << 16)),
    Verb.READ_SINGLE_TURN: ("angle", (36_000,)),
}
#: A speed, where the shaft was before a reading (degrees), what was read, and where the shaft was behind it.
_Seen = tuple[float, float, int, float]


def _look(probe: Probe, verb: Verb, rpm: float) -> _Seen:
    before = motion.position(probe).value
    told = probe.read(verb, _WITHIN_TURN[verb][0])
    return rpm, before, told, motion.position(probe).value


def _turned_both_ways(probe: Probe) -> dict[Verb, list[_Seen]]:
    """Turn the shaft and return what each read told of its place, at rest first."""
    motion.ready_to_move(probe)
    motion.wait_standing(probe)
    seen = {verb: [_look(probe, verb, 0)] for verb in _WITHIN_TURN}
    for rpm in _SPEEDS:
        motion.run_at(probe, rpm)
        probe.wait(300 * MS)
        for _ in range(_ROUNDS):
            for verb, looks in seen.items():
                looks.append(_look(probe, verb, rpm))
            probe.wait(_BETWEEN_NS)
        motion.stand_still(probe)
    return seen


def _off(look: _Seen, rest: _Seen, turn: int, noise: float) -> float:
    """Return by how many degrees a reading is beside the way of the shaft, if a turn has so many units."""
    rpm, before, told, after = look
    low, high = sorted((before - rest[1], after - rest[1]))
    beside = _OFF + noise + abs(rpm) * 6 * _OLD_S
    past = ((told - rest[2]) * 360 / turn - (low - beside)) % 360
    return max(0.0, past - (high - low + 2 * beside))


@of_motion(
    each=commands(*_WITHIN_TURN),
    name="{command}/turning",
    refuted_by="a place that is not kept up",
    at_best=Certainty.LIKELY,
    risks=risks_by(Verb.RUN_SPEED),
)
def _kept_up(probe: Probe, command: Command) -> None:
    """The place within the turn that {command} tells goes on as the position does while the shaft turns, either way."""
    rest, *looks = probe.recorded(_turned_both_ways)[command.verb]
    widths = _WITHIN_TURN[command.verb][1]
    turn = min(widths, key=lambda units: max(_off(look, rest, units, probe.noise.place) for look in looks))
    for look in looks:
        off = _off(look, rest, turn, probe.noise.place)
        text = f"{command.name} does not keep up with a shaft that turns at {look[0]:g} rpm"
        probe.expect(off, at_most=0, unit="degrees beside the position", refutes=text, key=f"{command.name} turning")
