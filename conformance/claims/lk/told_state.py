"""The state of LK motors: several replies report it, and must agree.

    9A 9B            temperature, voltage, current, state and errors
    9C               temperature, torque current, speed, encoder
    9D               temperature, phase currents

A value that only one command gets wrong differs from the others. `crossed.goal_claims` judges the state of a turning shaft.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims import bench
from conformance.claims.declare import Case, commands
from conformance.claims.known_quirks import may_meet
from conformance.claims.lk.encoder_zero import named
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.claims.motion.reads import PLACES, turn_by
from conformance.model.lk_parameters import OTHER_FIRMWARE, parameter, set_parameter
from conformance.motion import declared, motion
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe
from conformance.talk.samples import sample

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
    for command in filter(_has_temperature, dialect.commands):
        # What moves the shaft tells it too, of each motion.
        facts = {"risks": declared.risks(dialect, *command.all_risks), "models": command.models} if command.motion else {}
        yield Case(dialect, command, facts=facts)


def _has_temperature(command: Command) -> bool:
    return any("temperature" in form.layout.named for form in command.reply_forms)


@_still(
    each=_tells_temperature, refuted_by="the temperature of another time", name="{command}/follows-temperature", emulated=True
)
def _follows_temperature(probe: Probe, command: Command) -> None:
    """{command} tells the temperature that the motor has then, below zero too."""
    for degrees in (41, -7, -40, 125, 30):
        bench.lk_drive(probe).hot(degrees)
        seen, exchange = _told(probe, command, sample(probe.dialect, command))
        text = f"{command.name} does not tell the temperature of the motor"
        probe.expect(seen["temperature"], equal=degrees, refutes=text, exchange=exchange)


@_still(each=commands(Verb.READ_STATE_1), refuted_by="a current that no resting motor takes", at_best=Certainty.LIKELY)
def _current_at_rest(probe: Probe, command: Command) -> None:
    """The supply current of a motor that stands is small."""
    seen, exchange = _told(probe, command)
    text = "a motor that stands takes a current that no resting motor takes"
    probe.expect(seen["current"], at_least=-_AT_REST, at_most=_AT_REST, unit="x 0.01 A", refutes=text, exchange=exchange)


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


#: A run that shows, in rpm, and how long until its speed is even; a torque that has a sign, and by how much it may differ.
_RPM, _EVEN_NS, _TELLING, _ALIKE = 60, 300 * MS, 20, 0.1


@of_motion(
    each=commands(Verb.READ_STATE_2),
    refuted_by="the same torque both ways",
    name="{command}/torque-sign",
    at_best=Certainty.LIKELY,
    risks=risks_by(Verb.RUN_SPEED),
)
def _torque_sign(probe: Probe, command: Command) -> None:
    """The torque, or the power, of a run has its sign: {command} tells another one of a run the other way."""
    motion.ready_to_move(probe)
    forces = []
    for way in (1, -1):
        motion.run_at(probe, way * _RPM)
        probe.wait(_EVEN_NS)
        seen, exchange = _told(probe, command)
        forces.append(next(seen[name] for name in _FORCES if name in seen))
        motion.stand_still(probe)
    one, other = forces
    if min(abs(one), abs(other)) < _TELLING:
        raise Inconclusive("a run takes too little torque to tell its sign")
    # A load that pulls one way adds to the friction one way, and takes from it the other way.
    alike = one * other > 0 and abs(one - other) <= _ALIKE * max(abs(one), abs(other))
    text = "the torque of a run is told without its sign"
    probe.expect(f"{one:+d} and {other:+d}", holds=not alike, expected="two signs", refutes=text, exchange=exchange)


#: What a motor gives, by the word of its model.
_FORCES = ("torque_current", "power")


#: A run faster than 16 bits of 0.1 deg/s hold (rpm), its speed limit and ramp as they are sent, and how long it rises at most.
_FAST_RPM, _FAST_LIMIT, _FAST_RAMP, _RISES_NS = 650, 400_000, 1_500_000, 600 * MS
#: What must be reached of it (deg/s), how long it is watched, and by what share a told speed may be off.
_FAST_LEAST, _FAST_NS, _FAST_SHARE = 3_400, 100 * MS, 0.1


@of_motion(
    each=commands(Verb.READ_STATE_2),
    refuted_by="another speed than the shaft's",
    name="{command}/fast",
    at_best=Certainty.LIKELY,
    risks=lambda case: {Risk.SETTING, *risks_by(Verb.RUN_SPEED)(case)},
    settings=("speed_limit", "speed_ramp"),
    quirks=may_meet(OTHER_FIRMWARE),
)
def _fast(probe: Probe, command: Command) -> None:
    """The speed of a fast shaft, either way, is told as positions have it: by {command}, and by the reply to a run."""
    kept = {name: parameter(probe, name) for name in ("speed_limit", "speed_ramp")}
    if None in kept.values():
        return
    motion.ready_to_move(probe)
    run, seen = probe.command(Verb.RUN_SPEED), []
    for name, value in (("speed_limit", _FAST_LIMIT), ("speed_ramp", _FAST_RAMP)):
        set_parameter(probe, name, value)
    for way in (1, -1):
        motion.run_at(probe, way * _FAST_RPM)
        probe.wait(_RISES_NS)
        rpm, uncertain = motion.mean_speed(probe, _FAST_NS)
        again = declared.values_of(probe.dialect, run, rpm=way * _FAST_RPM)
        seen += [(rpm * 6, uncertain * 6, each, _told(probe, each, values)) for each, values in ((command, None), (run, again))]
        motion.stand_still(probe)
    for name, before in kept.items():
        set_parameter(probe, name, before or 0)
    if min(abs(speed) for speed, *_ in seen) < _FAST_LEAST:
        raise Inconclusive(f"the motor does not get to {_FAST_LEAST} deg/s")
    for speed, uncertain, each, (told, exchange) in seen:
        text, within = f"{each.name} tells another speed of a fast shaft", uncertain + abs(speed) * _FAST_SHARE
        probe.expect(told["speed"], near=speed, within=within, unit="deg/s", refutes=text, exchange=exchange)
