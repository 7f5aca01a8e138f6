"""States of LK motors: on and off, the stop, the brake, torque and open loop, error flags, and what only some models have.

Rules kept here:
- Off: commands are answered and nothing turns, neither then nor when the motor is on again.
- Torques are small (60 LSB; an MF's half ampere) and last for half a second.
- A brake may not be there on a real motor, error flags need a cause: those claims are of emulated drives.
- A model that the manual does not give a command does not obey it; whether it answers is open.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer import dialects, encoder
from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.protocols.lk_rs485 import CURRENT_MODELS, ERROR_BITS, POWER_MODELS
from conformance import moving
from conformance.claim import Claim, Inconclusive, NotRun, Theme
from conformance.claims.declare import declare
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.claims.motion_lk import measured, run, values_of
from conformance.drives.lk_rs485 import LkDrive
from conformance.exchange import Exchange
from conformance.moving import MS, SECOND_NS
from conformance.probe import Probe

_ON, _OFF = 0x00, 0x10
_TORQUE = 60
#: Commands of motion, as far as a model has them.
MOTIONS = (
    "run_torque", "run_open_loop", "run_speed", "move_multi_turn", "move_multi_turn_limited", "move_single_turn",
    "move_single_turn_limited", "move_increment", "move_increment_limited",
)  # fmt: skip
_FORCES = {"run_torque": "torque_current", "run_open_loop": "power"}
_POWER_OFF, _RELEASE, _READ_BRAKE = 0x00, 0x01, 0x10


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about the states of an LK motor."""
    named = dialect.by_name
    risks = named["run_speed"].all_risks | named["motor_off"].all_risks
    for name in MOTIONS:
        if name in named:
            yield motion_claim(
                dialect, named[name], "while-off",
                f"{name} is answered while the motor is off, and turns nothing, then or later.", "silence, or motion",
                _while_off, risks=risks, models=named[name].models,
            )  # fmt: skip
    off, on, stop = named["motor_off"], named["motor_on"], named["stop"]
    made = partial(motion_claim, dialect, risks=risks)
    yield made(off, "is-read", "A motor that is off reads state 10h, one that is on 00h.", "the other", _state_is_read)
    yield made(
        off, "ends-motion", "Switching the motor off ends a motion.", "a shaft that is still driven", _off_ends,
        at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield made(
        on, "does-not-resume", "Switching the motor on does not take up what was ended.", "motion", _does_not_resume,
        at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield made(on, "obeys", "A motor that was switched off and on obeys the next command.", "no motion", _obeys_again)
    yield made(
        off, "keeps-turns", "Switching the motor off and on leaves the counted turns.", "another position", _keeps_turns,
        at_best=Certainty.LIKELY, quirks=known(dialect, "lk-off-clears-turns"),
    )  # fmt: skip
    yield made(stop, "stops", "The stop brings a running shaft to rest.", "a shaft that goes on", _stops)
    yield made(stop, "ends-a-move", "The stop ends a move before its target.", "a shaft at its target", _stops_move)
    yield made(
        stop, "stays-on", "After the stop the motor is on, and the next command moves it.", "state 10h, or no motion",
        _stays_on, at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield made(
        stop, "keeps-turns", "The stop leaves the counted turns.", "another position", _stop_keeps_turns,
        at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield made(
        stop, "brakes", "The stop brakes the shaft as speed 0 does: it goes no farther.", "a shaft that runs out",
        _stop_brakes, at_best=Certainty.OPEN,
    )  # fmt: skip
    yield from _about_brake(dialect)
    for name, field in _FORCES.items():
        if name in named:
            yield from _about_force(dialect, named[name], field)
    for name, models in (("run_torque", POWER_MODELS), ("run_open_loop", CURRENT_MODELS)):
        yield declare(
            dialect, Theme.MOTION, f"{name}/other-models", f"{' and '.join(models)} do not have {name}, and do not obey it.",
            "motion", partial(_other_model, name), section=_section(name),
            risks=moving.risks(dialect, Risk.UNBOUNDED, Risk.TORQUE, Risk.UNKNOWN), models=models,
        )  # fmt: skip
    yield from _about_errors(dialect)


def _section(name: str) -> str:
    return _whole().by_name[name].section


def _whole() -> Dialect:
    """Return the dialect with the commands of all models."""
    return dialects.get("lk-rs485")


# --- on and off -------------------------------------------------------------------------------------------------------


def _ask_motion(probe: Probe, command: Command) -> Exchange:
    field = _FORCES.get(command.name)
    if field is not None:
        return probe.ask(command, {field: _TORQUE})
    if command.verb is Verb.RUN_SPEED:
        return probe.ask(command, {"speed": 18_000})
    return probe.ask(command, values_of(probe, command, 90.0, moving.position(probe)))


def _while_off(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    probe.do(Verb.MOTOR_OFF)
    before = moving.position(probe)
    exchange = _ask_motion(probe, command)
    if exchange.silent:
        # A reply can be lost; a motor that is off never answers.
        if not _ask_motion(probe, command).silent:
            raise Inconclusive(f"{command.name} was answered only when it was sent again")
        text = f"{command.name} is not answered while the motor is off"
        raise refute(exchange, text, expected="a reply", got="silence")
    probe.wait(SECOND_NS)
    expect_stays(before, moving.position(probe), exchange, f"{command.name} turns a motor that is off")
    probe.do(Verb.MOTOR_ON)
    probe.wait(SECOND_NS)
    after = moving.position(probe)
    moving.stop(probe)
    expect_stays(before, after, exchange, f"{command.name}, given while off, turns the motor when it is on again")


def _state(probe: Probe) -> int:
    return probe.read(Verb.READ_STATE_1, "state")


def _state_is_read(probe: Probe, command: Command) -> None:
    for verb, wanted in ((Verb.MOTOR_ON, _ON), (Verb.MOTOR_OFF, _OFF), (Verb.MOTOR_ON, _ON), (Verb.MOTOR_OFF, _OFF)):
        exchange = probe.do(verb)
        seen = _state(probe)
        if seen != wanted:
            text = f"the state after {verb.value} is another one"
            raise refute(exchange, text, expected=f"{wanted:02X}h", got=f"{seen:02X}h")
    probe.do(Verb.MOTOR_ON)


def _expect_slow(probe: Probe, exchange: Exchange, text: str) -> None:
    speed, _ = measured(probe, 500 * MS)
    if abs(speed) > 2:
        moving.stop(probe)
        raise refute(exchange, text, expected="a shaft that stands", got=f"{speed:.0f} deg/s")


def _off_ends(probe: Probe, command: Command) -> None:
    run(probe, 18_000)
    exchange = probe.do(command)
    probe.wait(5 * SECOND_NS)
    _expect_slow(probe, exchange, "the shaft still turns after the motor was switched off")


def _does_not_resume(probe: Probe, command: Command) -> None:
    run(probe, 18_000)
    probe.do(Verb.MOTOR_OFF)
    probe.wait(5 * SECOND_NS)
    exchange = probe.do(command)
    probe.wait(SECOND_NS)
    _expect_slow(probe, exchange, "switching the motor on takes up the motion again")


def _expect_moves(probe: Probe, text: str) -> None:
    before = moving.position(probe)
    exchange = probe.do("move_increment", {"position": 4_500})
    probe.wait(500 * MS)
    after = moving.wait_standing(probe)
    if abs(abs(after.value - before.value) - 45) > 1:
        raise refute(exchange, text, expected="45 degrees", got=f"{after.value - before.value:+.1f} degrees")


def _obeys_again(probe: Probe, command: Command) -> None:
    for _ in range(2):
        probe.do(Verb.MOTOR_OFF)
        probe.do(command)
        _expect_moves(probe, "the motor does not obey after it was switched on")


def _turn_away(probe: Probe) -> None:
    moving.ready_to_move(probe)
    for _ in range(2):
        probe.do("move_increment", {"position": 42_000})
        probe.wait(SECOND_NS)
        moving.wait_standing(probe)


def _keeps_turns(probe: Probe, command: Command) -> None:
    _turn_away(probe)
    before = moving.position(probe)
    exchange = probe.do(command)
    probe.do(Verb.MOTOR_ON)
    after = moving.position(probe)
    change = after.value - before.value
    if abs(change) <= 1:
        return
    if "lk-off-clears-turns" in probe.claim.quirks and abs(change - 360 * round(change / 360)) <= 1:
        probe.meets("lk-off-clears-turns")
        return
    text = "switching the motor off changes the position"
    raise refute(exchange, text, expected=f"{before.value:.1f} degrees", got=f"{after.value:.1f} degrees")


# --- the stop ---------------------------------------------------------------------------------------------------------


def _stops(probe: Probe, command: Command) -> None:
    run(probe, 18_000)
    exchange = probe.do(command)
    probe.wait(3 * SECOND_NS)
    _expect_slow(probe, exchange, "the stop does not bring the shaft to rest")


def _stops_move(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    before = moving.position(probe)
    probe.do("move_increment_limited", {"position": 36_000, "max_speed": 9_000})
    probe.wait(SECOND_NS)
    exchange = probe.do(command)
    probe.wait(5 * SECOND_NS)
    went = moving.wait_standing(probe).value - before.value
    if not 20 < abs(went) < 300:
        text = "the stop does not end a move on its way"
        raise refute(exchange, text, expected="about 90 degrees of 360", got=f"{went:+.1f} degrees")


def _stays_on(probe: Probe, command: Command) -> None:
    run(probe, 18_000)
    exchange = probe.do(command)
    moving.wait_standing(probe)
    state = _state(probe)
    if state != _ON:
        raise refute(exchange, "the motor is not on after the stop", expected="00h", got=f"{state:02X}h")
    _expect_moves(probe, "the motor does not obey after the stop")


def _stop_keeps_turns(probe: Probe, command: Command) -> None:
    _turn_away(probe)
    before = moving.position(probe)
    exchange = probe.do(command)
    probe.wait(500 * MS)
    after = moving.position(probe)
    if abs(after.value - before.value) > 1:
        text = "the stop changes the position of a shaft that stands"
        raise refute(exchange, text, expected=f"{before.value:.1f} degrees", got=f"{after.value:.1f} degrees")


def _stop_way(probe: Probe, name: str, values: dict[str, int]) -> tuple[float, Exchange]:
    """Run, stop by a command and return how far the shaft went after it (degrees)."""
    run(probe, 36_000)
    exchange = probe.ask(name, values, quiet_ns=0)
    begun = moving.position(probe)
    probe.wait(SECOND_NS)
    return abs(moving.wait_standing(probe).value - begun.value), exchange


def _stop_brakes(probe: Probe, command: Command) -> None:
    braked, _ = _stop_way(probe, "run_speed", {"speed": 0})
    stopped, exchange = _stop_way(probe, command.name, {})
    if stopped > braked + 5:
        text = "the shaft goes farther after the stop than after speed 0"
        raise refute(exchange, text, expected=f"about {braked:.0f} degrees", got=f"{stopped:.0f} degrees")


# --- the brake --------------------------------------------------------------------------------------------------------


def _about_brake(dialect: Dialect) -> Iterator[Claim]:
    brake = dialect.by_name["brake"]
    made = partial(motion_claim, dialect, brake, risks=dialect.by_name["run_speed"].all_risks)
    yield made(
        "holds", "The brake without power (00h) holds the shaft; with power (01h) it lets it turn.",
        "a shaft that turns against the brake, or does not turn without", _brake_holds, emulated=True,
    )  # fmt: skip
    yield made("is-read", "Reading the brake (10h) tells the state that was set last.", "another state", _brake_is_read)
    yield made(
        "read-only", "Reading the brake leaves it as it is.", "a brake that was switched by it", _brake_read_only,
        emulated=True,
    )  # fmt: skip
    yield made(
        "answers-new", "Switching the brake is answered with the state after it.", "the state before",
        _brake_answers_new, errata=("lk-rs485-25",),
    )  # fmt: skip


def _brake(probe: Probe, control: int) -> int:
    exchange = probe.ask("brake", {"brake_control": control})
    return int(probe.reply(exchange).values["brake_state"])


def _way(probe: Probe) -> float:
    """Return how far a short run turns the shaft, in degrees."""
    before = moving.position(probe)
    probe.do("run_speed", {"speed": 9_000})
    probe.wait(500 * MS)
    went = moving.position(probe).value - before.value
    moving.stop(probe)
    return went


def _brake_holds(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    _brake(probe, _POWER_OFF)
    held = _way(probe)
    if abs(held) > 1:
        raise refute(probe.traffic[-1], "the shaft turns against the brake", expected="no motion", got=f"{held:+.1f} degrees")
    _brake(probe, _RELEASE)
    probe.wait(500 * MS)
    free = _way(probe)
    moving.wait_standing(probe)
    if abs(free) < 10:
        text = "the shaft does not turn with the brake released"
        raise refute(probe.traffic[-1], text, expected="about 40 degrees", got=f"{free:+.1f} degrees")


def _brake_is_read(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    for control in (_POWER_OFF, _RELEASE, _POWER_OFF, _RELEASE):
        _brake(probe, control)
        seen = _brake(probe, _READ_BRAKE)
        if seen != control:
            text = "the brake reads another state than was set"
            raise refute(probe.traffic[-1], text, expected=f"{control:02X}h", got=f"{seen:02X}h")


def _brake_read_only(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    _brake(probe, _POWER_OFF)
    _brake(probe, _READ_BRAKE)
    held = _way(probe)
    _brake(probe, _RELEASE)
    if abs(held) > 1:
        text = "reading the brake releases it"
        raise refute(probe.traffic[-1], text, expected="no motion", got=f"{held:+.1f} degrees")


def _brake_answers_new(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    for control in (_POWER_OFF, _RELEASE):
        seen = _brake(probe, control)
        if seen != control:
            text = "switching the brake is answered with the state before"
            raise refute(probe.traffic[-1], text, expected=f"{control:02X}h", got=f"{seen:02X}h")


# --- torque and open loop ---------------------------------------------------------------------------------------------


def _about_force(dialect: Dialect, command: Command, field: str) -> Iterator[Claim]:
    made = partial(motion_claim, dialect, command, models=command.models)
    yield made(
        "two-ways", f"{command.name}: a positive value drives the shaft one way, a negative one the other.",
        "one way for both, or no motion", partial(_force_ways, field),
    )  # fmt: skip
    yield made(
        "sign", f"{command.name}: a positive value raises the position.", "the other way", partial(_force_sign, field),
        at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield made(
        "zero", f"{command.name} with 0 drives nothing.", "a shaft that goes on", partial(_force_zero, field),
        at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield made(
        "is-read", f"What {command.name} asks for is what the state then reads, with its sign.", "another value",
        partial(_force_is_read, field), at_best=Certainty.LIKELY,
    )  # fmt: skip


def _force(probe: Probe, command: Command, field: str, value: int) -> float:
    """Drive the shaft for half a second from rest; return how far it went (degrees)."""
    before = moving.position(probe)
    probe.do(command, {field: value})
    probe.wait(500 * MS)
    went = moving.position(probe).value - before.value
    moving.stand_still(probe)
    return went


def _force_ways(field: str, probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    up, down = (_force(probe, command, field, value) for value in (_TORQUE, -_TORQUE))
    if up * down >= 0 or min(abs(up), abs(down)) < 1:
        text = f"{command.name} does not drive the shaft both ways"
        raise refute(probe.traffic[-1], text, expected="two ways", got=f"{up:+.1f} and {down:+.1f} degrees")


def _force_sign(field: str, probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    went = _force(probe, command, field, _TORQUE)
    if went <= 0:
        text = f"a positive {field} does not raise the position"
        raise refute(probe.traffic[-1], text, expected="a greater position", got=f"{went:+.1f} degrees")


def _force_zero(field: str, probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    _force(probe, command, field, _TORQUE)
    exchange = probe.do(command, {field: 0})
    before = moving.position(probe)
    probe.wait(SECOND_NS)
    expect_stays(before, moving.position(probe), exchange, f"{command.name} with 0 drives the shaft")


def _force_is_read(field: str, probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    for value in (_TORQUE, -_TORQUE):
        exchange = probe.do(command, {field: value})
        probe.wait(300 * MS)
        seen = probe.read(Verb.READ_STATE_2, field)
        moving.stand_still(probe)
        if abs(seen - value) > _TORQUE / 4:
            text = f"the state does not read the {field} that was asked for"
            raise refute(exchange, text, expected=f"about {value}", got=str(seen))


def _other_model(name: str, probe: Probe) -> None:
    """Send a command that the model does not have, and look at the shaft."""
    if not probe.dialect.model:
        raise NotRun("which model it is was not said")
    moving.ready_to_move(probe)
    whole = _whole()
    frame = encoder.build(whole, name, probe.address, {_FORCES[name]: _TORQUE})
    before = moving.position(probe)
    exchange = probe.send(frame, timeout_ns=500 * MS)
    after = moving.position(probe)
    moving.stand_still(probe)
    model = probe.dialect.model
    expect_stays(before, after, exchange, f"an {model} obeys {name}, which is not a command of its")


# --- error flags ------------------------------------------------------------------------------------------------------


def _about_errors(dialect: Dialect) -> Iterator[Claim]:
    state, clear = dialect.by_name["read_state_1"], dialect.by_name["clear_errors"]
    for field in ERROR_BITS:
        yield motion_claim(
            dialect, state, f"flag-{field.name}", f"Where {field.name} is the matter, its flag is set, and no other.",
            "another flag, or none", partial(_flag, field.name), emulated=True,
        )  # fmt: skip
    yield motion_claim(
        dialect, clear, "clears", "9B clears a flag whose cause is gone.", "a flag that stays", _clears, emulated=True
    )
    yield motion_claim(
        dialect, clear, "keeps", "9B leaves a flag whose cause lasts.", "a flag that is cleared", _keeps, emulated=True
    )


def lk_drive(probe: Probe) -> LkDrive:
    """Return the emulated drive. Raises NotRun for a real one."""
    if not isinstance(probe.drive, LkDrive):
        raise NotRun("it needs to act on an emulated LK drive")
    return probe.drive


def _flags(probe: Probe, what: str = "read_state_1") -> tuple[set[str], Exchange]:
    exchange = probe.ask(what)
    values = probe.reply(exchange).values
    return {f.name for f in ERROR_BITS if values.get(f.name)}, exchange


def _expect_flags(probe: Probe, wanted: set[str], when: str) -> None:
    seen, exchange = _flags(probe)
    if seen != wanted:
        names = [", ".join(sorted(each)) or "none" for each in (wanted, seen)]
        raise refute(exchange, f"the error flags {when} are others", expected=names[0], got=names[1])


def _flag(name: str, probe: Probe, command: Command) -> None:
    drive = lk_drive(probe)
    _expect_flags(probe, set(), "at first")
    drive.trip(name)
    _expect_flags(probe, {name}, f"with {name}")
    drive.trip(name, False)
    probe.do("clear_errors")
    _expect_flags(probe, set(), f"after {name} was cleared")


def _clears(probe: Probe, command: Command) -> None:
    drive = lk_drive(probe)
    drive.trip("overcurrent")
    drive.trip("overcurrent", False)
    _expect_flags(probe, {"overcurrent"}, "before 9B")
    probe.do(command)
    _expect_flags(probe, set(), "after 9B, the cause being gone,")


def _keeps(probe: Probe, command: Command) -> None:
    drive = lk_drive(probe)
    drive.trip("motor_hot")
    probe.do(command)
    _expect_flags(probe, {"motor_hot"}, "after 9B, the cause lasting,")
