"""What drives and holds the shaft of an LK motor: torque, open loop, the brake, and commands that only some models have.

Rules kept here:
- Torques are small (60 LSB; an MF's half ampere) and last for half a second.
- A brake may not be there on a real motor: what it holds is a claim about emulated drives.
- A model that the manual does not give a command does not obey it; whether it answers is open.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer import dialects, encoder
from analyzer.catalogue import Certainty, Command, Dialect, Doubt, MotionKind, Risk, Verb
from conformance.claim import NotRun, Theme
from conformance.claims.bench import lk_drive
from conformance.claims.declare import Case, claim, commands, motions
from conformance.claims.motion.motion_claim import expect_stays, of_motion, risks_by
from conformance.motion import declared, motion
from conformance.motion.declared import CALM, FORCE, MOVES
from conformance.talk.probe import MS, SECOND_NS, Probe

_POWER_OFF, _RELEASE, _READ_BRAKE = 0x00, 0x01, 0x10
_of_brake = partial(of_motion, each=commands(Verb.BRAKE))
_of_force = partial(of_motion, each=motions(MotionKind.TORQUE))


# --- torque and open loop ---------------------------------------------------------------------------------------------


def _field(probe: Probe, command: Command) -> str:
    """Return the field that says how strongly the shaft is driven."""
    return next(iter(declared.values_of(probe.dialect, command)))


def _force(probe: Probe, command: Command, value: int) -> float:
    """Drive the shaft for half a second from rest; return how far it went (degrees)."""
    before = motion.position(probe)
    probe.do(command, {_field(probe, command): value})
    probe.wait(500 * MS)
    went = motion.position(probe).value - before.value
    motion.stand_still(probe)
    return went


@_of_force(refuted_by="a shaft that goes on", at_best=Certainty.LIKELY)
def _zero(probe: Probe, command: Command) -> None:
    """{command} with 0 drives nothing."""
    motion.ready_to_move(probe)
    _force(probe, command, FORCE)
    exchange = probe.do(command, {_field(probe, command): 0})
    before = motion.position(probe)
    probe.wait(SECOND_NS)
    expect_stays(before, motion.position(probe), exchange, f"{command.name} with 0 drives the shaft")


@_of_force(refuted_by="the force of before", at_best=Certainty.LIKELY)
def _newer(probe: Probe, command: Command) -> None:
    """{command} that comes while one drives the shaft takes its place: weaker, the other way, none and again."""
    motion.ready_to_move(probe)
    name = _field(probe, command)
    for force in (FORCE, FORCE // 2, -FORCE, 0, FORCE, 0):
        exchange = probe.do(command, {name: force})
        probe.wait(_FORCE_NS)
        seen = probe.read(Verb.READ_STATE_2, name)
        if abs(seen - force) > FORCE / 4:
            motion.stand_still(probe)
        text = f"{command.name} does not take the place of the one before"
        probe.expect(seen, near=force, within=FORCE / 4, unit="LSB", refutes=text, exchange=exchange)
    motion.stand_still(probe)


#: How long a force has until it is there.
_FORCE_NS = 250 * MS


@_of_force(refuted_by="another value", emulated=True, at_best=Certainty.LIKELY)
def _to_its_end(probe: Probe, command: Command) -> None:
    """{command} drives the shaft as strongly as asked for to the end of its range, both ways."""
    motion.ready_to_move(probe)
    name = _field(probe, command)
    field = declared.field_of(command, name)
    lk_drive(probe).block()
    for part in (1, 0.75, 0.5, 0.25):
        for end in (field.high, field.low):
            value = round(end * part)
            exchange = probe.do(command, {name: value})
            probe.wait(SECOND_NS)
            seen = probe.read(Verb.READ_STATE_2, name)
            text = f"{command.name} drives a held shaft by another {name} than was asked for"
            probe.expect(seen, near=value, within=abs(value) / 20, refutes=text, exchange=exchange)
    probe.do(Verb.STOP)
    lk_drive(probe).block(False)


def _whole(dialect: Dialect) -> Dialect:
    """Return a dialect with the commands of all its models."""
    return dialects.get(dialect.name) if dialect.model else dialect


def _of_other_models(dialect: Dialect) -> Iterator[Case]:
    """Yield the commands that some models do not have,."""
    whole = _whole(dialect)
    for command in whole.motions(MotionKind.TORQUE):
        others = tuple(model for model in whole.models if command.models and model not in command.models)
        if not others:
            continue
        facts = {"models": others, "section": command.section, "parameters": {}}
        yield Case(dialect, None, {"foreign": command.name, "others": " and ".join(others)}, facts)


@claim(
    Theme.MOTION,
    each=_of_other_models,
    name="{foreign}/other-models",
    refuted_by="motion",
    risks=lambda case: declared.risks(case.dialect, Risk.UNBOUNDED, Risk.TORQUE, Risk.UNKNOWN),
)
def _other_models(probe: Probe, foreign: str) -> None:
    """{others} do not have {foreign}, and do not obey it."""
    model = probe.dialect.model
    if not model:
        raise NotRun("which model it is was not said")
    motion.ready_to_move(probe)
    whole = _whole(probe.dialect)
    frame = encoder.build(whole, foreign, probe.address, declared.values_of(whole, whole.by_name[foreign]))
    before = motion.position(probe)
    exchange = probe.send(frame, timeout_ns=500 * MS)
    after = motion.position(probe)
    motion.stand_still(probe)
    expect_stays(before, after, exchange, f"an {model} obeys {foreign}, which is not a command of its")


# --- the brake --------------------------------------------------------------------------------------------------------


def _by_all_motions(case: Case) -> frozenset[Risk]:
    every = case.dialect.motions(MotionKind.RUN, *MOVES, MotionKind.TORQUE)
    return frozenset[Risk]().union(*(command.all_risks for command in every))


def _brake(probe: Probe, control: int) -> int:
    """Switch or read the brake; return the state that is answered."""
    exchange = probe.ask(Verb.BRAKE, {"brake_control": control})
    return int(probe.reply(exchange).values["brake_state"])


def _way(probe: Probe) -> float:
    """Return how far a short run turns the shaft, in degrees."""
    before = motion.position(probe)
    motion.run_at(probe, 15)
    probe.wait(500 * MS)
    went = motion.position(probe).value - before.value
    motion.stop(probe)
    return abs(went)


@_of_brake(
    refuted_by="a shaft that turns against the brake, or does not turn without", emulated=True, risks=risks_by(Verb.RUN_SPEED)
)
def _holds(probe: Probe) -> None:
    """The brake without power (00h) holds the shaft; with power (01h) it lets it turn."""
    motion.ready_to_move(probe)
    _brake(probe, _POWER_OFF)
    probe.expect(_way(probe), at_most=1, unit="degrees", refutes="the shaft turns against the brake")
    _brake(probe, _RELEASE)
    probe.wait(500 * MS)
    free = _way(probe)
    motion.wait_standing(probe)
    probe.expect(free, at_least=10, unit="degrees", refutes="the shaft does not turn with the brake released")


def _ways(probe: Probe) -> Iterator[tuple[Command, int]]:
    """Yield every motion of the drive one way, and the run both ways."""
    every = probe.dialect.motions(MotionKind.RUN, *MOVES, MotionKind.TORQUE)
    known = [command for command in every if probe.dialect.model or not command.models]
    yield from ((command, (-1) ** n) for n, command in enumerate(known))
    yield probe.command(Verb.RUN_SPEED), -1


def _begin(probe: Probe, command: Command, way: int) -> None:
    """Begin a long motion of a direction."""
    kind = declared.of(command).kind
    force = {_field(probe, command): way * FORCE} if kind is MotionKind.TORQUE else {}
    degrees = 300 if kind is MotionKind.MOVE_IN_TURN else 720
    motion.begin(probe, command, way * degrees, rpm=way * CALM if kind is MotionKind.RUN else CALM, more=force)


@_of_brake(refuted_by="a shaft that turns against the brake", risks=_by_all_motions)
def _holds_turning(probe: Probe) -> None:
    """A brake that holds the shaft at rest (00h) also stops a turning shaft, in every motion, and holds it until 01h."""
    motion.ready_to_move(probe)
    _brake(probe, _POWER_OFF)
    held = _way(probe)
    _brake(probe, _RELEASE)
    motion.wait_standing(probe)
    if held > 1 + motion.same(probe):
        raise NotRun("the motor has no brake that holds its shaft")
    for command, way in _ways(probe):
        _begin(probe, command, way)
        probe.wait(200 * MS)
        _brake(probe, _POWER_OFF)
        exchange = probe.traffic[-1]
        probe.wait(80 * MS)
        before = motion.position(probe)
        probe.wait(60 * MS)
        moved = motion.position(probe).value - before.value
        # What is not braked is stopped before it is judged.
        motion.stop(probe)
        _brake(probe, _RELEASE)
        motion.wait_standing(probe)
        text = f"a shaft that {command.name} turns is not held by the brake"
        within = 1 + motion.same(probe)
        probe.expect(moved, near=0, within=within, unit="degrees", refutes=text, exchange=exchange, key="not held")


@_of_brake(name="{command}/is-read", refuted_by="another state", risks=risks_by(Verb.MOTOR_OFF, Verb.STOP))
def _brake_is_read(probe: Probe) -> None:
    """Reading the brake (10h), once or twice, tells the state that was set last, also of a motor that is stopped or off."""
    motion.ready_to_move(probe)
    for verb in (Verb.MOTOR_OFF, Verb.STOP, Verb.MOTOR_ON):
        probe.do(verb)
        for control in (_POWER_OFF, _RELEASE, _POWER_OFF, _RELEASE):
            _brake(probe, control)
            seen = [_brake(probe, _READ_BRAKE) for _ in range(2)]
            probe.expect(seen, equal=[control] * 2, refutes="the brake reads another state than was set")


@_of_brake(refuted_by="a brake that was switched by it", emulated=True, risks=risks_by(Verb.RUN_SPEED))
def _read_only(probe: Probe) -> None:
    """Reading the brake leaves it as it is."""
    motion.ready_to_move(probe)
    _brake(probe, _POWER_OFF)
    _brake(probe, _READ_BRAKE)
    held = _way(probe)
    _brake(probe, _RELEASE)
    probe.expect(held, at_most=1, unit="degrees", refutes="reading the brake releases it")


@_of_brake(
    name="{command}/stays",
    refuted_by="another state",
    at_best=Certainty.OPEN,
    risks=lambda case: _by_all_motions(case) | risks_by(Verb.MOTOR_OFF, Verb.STOP)(case),
)
def _brake_stays(probe: Probe) -> None:
    """Switching the motor off and on, a stop, and every motion leave the brake as it is."""
    motion.ready_to_move(probe)
    for control in (_POWER_OFF, _RELEASE):
        _brake(probe, control)
        for verb in (Verb.MOTOR_OFF, Verb.MOTOR_ON, Verb.STOP):
            exchange = probe.do(verb)
            text = f"{probe.command(verb).name} switches the brake"
            probe.expect(_brake(probe, _READ_BRAKE), equal=control, refutes=text, exchange=exchange)
    for command, way in _ways(probe):
        _begin(probe, command, way)
        text, exchange = f"{command.name} switches the brake", probe.traffic[-1]
        seen = _brake(probe, _READ_BRAKE)
        if command.verb is Verb.RUN_SPEED:
            # What is released is released: that changes nothing of a shaft that turns.
            probe.wait(150 * MS)
            released = _brake(probe, _RELEASE)
            probe.wait(150 * MS)
            left = abs(motion.turning(probe).value)
            motion.stand_still(probe)
            what = "releasing a released brake stops the shaft"
            probe.expect(left, at_least=CALM / 2, unit="rpm", refutes=what, exchange=exchange)
            probe.expect(released, equal=_RELEASE, refutes=text, exchange=exchange)
        motion.stand_still(probe)
        probe.expect([seen, _brake(probe, _READ_BRAKE)], equal=[control] * 2, refutes=text, exchange=exchange)


@_of_brake(refuted_by="a brake that is released, or a shaft that turns", risks=_by_all_motions, at_best=Certainty.LIKELY)
def _stays_applied(probe: Probe) -> None:
    """A brake that holds (00h) is released by no motion: it reads 00h during each, and a shaft that it holds stays."""
    motion.ready_to_move(probe)
    went = []
    for command, way in _ways(probe):
        _brake(probe, _POWER_OFF)
        before = motion.position(probe)
        _begin(probe, command, way)
        exchange = probe.traffic[-1]
        probe.wait(150 * MS)
        seen, now = _brake(probe, _READ_BRAKE), motion.position(probe)
        motion.stop(probe)
        left = _brake(probe, _READ_BRAKE)
        _brake(probe, _RELEASE)
        motion.wait_standing(probe)
        went.append((command, exchange, before, now))
        text = f"{command.name} releases the brake"
        probe.expect([seen, left], equal=[_POWER_OFF] * 2, refutes=text, exchange=exchange, key="released")
    # A motor may have none: then each motion with a speed turns its shaft.
    held = [abs(now.value - before.value) <= 1 + motion.same(probe) for c, _, before, now in went if declared.of(c).speed]
    for command, exchange, before, now in went if any(held) else ():
        expect_stays(before, now, exchange, f"{command.name} turns the shaft against the brake", 1 + motion.same(probe))


@_of_brake(refuted_by="the state before", rests_on=(Doubt.REPLY_VALUES,))
def _answers_new(probe: Probe) -> None:
    """Switching the brake is answered with the state after it."""
    motion.ready_to_move(probe)
    for control in (_POWER_OFF, _RELEASE):
        text = "switching the brake is answered with the state before"
        probe.expect(_brake(probe, control), equal=control, refutes=text)
