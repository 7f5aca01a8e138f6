"""What drives and holds the shaft of an LK motor: torque, open loop, the brake, and commands that only some models have.

Rules kept here:
- Torques are small (60 LSB; an MF's half ampere) and last for half a second.
- A brake may not be there on a real motor: what it holds is a claim about emulated drives.
- A model that the manual does not give a command does not obey it; whether it answers is open.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer import encoder
from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from analyzer.protocols.lk_rs485 import CURRENT_MODELS, POWER_MODELS
from conformance.claim import Claim, NotRun, Theme
from conformance.claims.declare import declare
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.motion import motion
from conformance.motion.motion import MS, SECOND_NS
from conformance.talk.probe import Probe

TORQUE = 60
#: Commands that drive the shaft with a force, and the field that says with which.
FORCES = {"run_torque": "torque_current", "run_open_loop": "power"}
_POWER_OFF, _RELEASE, _READ_BRAKE = 0x00, 0x01, 0x10


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about torque, open loop and brake."""
    named = dialect.by_name
    yield from _about_brake(dialect)
    for name, field in FORCES.items():
        if name in named:
            yield from _about_force(dialect, named[name], field)
    for name, models in (("run_torque", POWER_MODELS), ("run_open_loop", CURRENT_MODELS)):
        yield declare(
            dialect, Theme.MOTION, f"{name}/other-models", f"{' and '.join(models)} do not have {name}, and do not obey it.",
            "motion", partial(_other_model, name), section=dialect.whole.by_name[name].section,
            risks=motion.risks(dialect, Risk.UNBOUNDED, Risk.TORQUE, Risk.UNKNOWN), models=models,
        )  # fmt: skip


# --- the brake --------------------------------------------------------------------------------------------------------


def _about_brake(dialect: Dialect) -> Iterator[Claim]:
    brake = dialect.by_name["brake"]
    spins = dialect.by_name["run_speed"].all_risks
    made = partial(motion_claim, dialect, brake)
    yield made(
        "holds", "The brake without power (00h) holds the shaft; with power (01h) it lets it turn.",
        "a shaft that turns against the brake, or does not turn without", _brake_holds, emulated=True,
        risks=spins,
    )  # fmt: skip
    yield made("is-read", "Reading the brake (10h) tells the state that was set last.", "another state", _brake_is_read)
    yield made(
        "read-only", "Reading the brake leaves it as it is.", "a brake that was switched by it", _brake_read_only,
        emulated=True, risks=spins,
    )  # fmt: skip
    yield made(
        "answers-new", "Switching the brake is answered with the state after it.", "the state before",
        _brake_answers_new, rests_on=(Doubt.REPLY_VALUES,),
    )  # fmt: skip


def _brake(probe: Probe, control: int) -> int:
    exchange = probe.ask("brake", {"brake_control": control})
    return int(probe.reply(exchange).values["brake_state"])


def _way(probe: Probe) -> float:
    """Return how far a short run turns the shaft, in degrees."""
    before = motion.position(probe)
    probe.do("run_speed", {"speed": 9_000})
    probe.wait(500 * MS)
    went = motion.position(probe).value - before.value
    motion.stop(probe)
    return went


def _brake_holds(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    _brake(probe, _POWER_OFF)
    held = _way(probe)
    if abs(held) > 1:
        raise refute(probe.traffic[-1], "the shaft turns against the brake", expected="no motion", got=f"{held:+.1f} degrees")
    _brake(probe, _RELEASE)
    probe.wait(500 * MS)
    free = _way(probe)
    motion.wait_standing(probe)
    if abs(free) < 10:
        text = "the shaft does not turn with the brake released"
        raise refute(probe.traffic[-1], text, expected="about 40 degrees", got=f"{free:+.1f} degrees")


def _brake_is_read(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    for control in (_POWER_OFF, _RELEASE, _POWER_OFF, _RELEASE):
        _brake(probe, control)
        seen = _brake(probe, _READ_BRAKE)
        if seen != control:
            text = "the brake reads another state than was set"
            raise refute(probe.traffic[-1], text, expected=f"{control:02X}h", got=f"{seen:02X}h")


def _brake_read_only(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    _brake(probe, _POWER_OFF)
    _brake(probe, _READ_BRAKE)
    held = _way(probe)
    _brake(probe, _RELEASE)
    if abs(held) > 1:
        text = "reading the brake releases it"
        raise refute(probe.traffic[-1], text, expected="no motion", got=f"{held:+.1f} degrees")


def _brake_answers_new(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
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
    before = motion.position(probe)
    probe.do(command, {field: value})
    probe.wait(500 * MS)
    went = motion.position(probe).value - before.value
    motion.stand_still(probe)
    return went


def _force_ways(field: str, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    up, down = (_force(probe, command, field, value) for value in (TORQUE, -TORQUE))
    if up * down >= 0 or min(abs(up), abs(down)) < 1:
        text = f"{command.name} does not drive the shaft both ways"
        raise refute(probe.traffic[-1], text, expected="two ways", got=f"{up:+.1f} and {down:+.1f} degrees")


def _force_sign(field: str, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    went = _force(probe, command, field, TORQUE)
    if went <= 0:
        text = f"a positive {field} does not raise the position"
        raise refute(probe.traffic[-1], text, expected="a greater position", got=f"{went:+.1f} degrees")


def _force_zero(field: str, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    _force(probe, command, field, TORQUE)
    exchange = probe.do(command, {field: 0})
    before = motion.position(probe)
    probe.wait(SECOND_NS)
    expect_stays(before, motion.position(probe), exchange, f"{command.name} with 0 drives the shaft")


def _force_is_read(field: str, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    for value in (TORQUE, -TORQUE):
        exchange = probe.do(command, {field: value})
        probe.wait(300 * MS)
        seen = probe.read(Verb.READ_STATE_2, field)
        motion.stand_still(probe)
        if abs(seen - value) > TORQUE / 4:
            text = f"the state does not read the {field} that was asked for"
            raise refute(exchange, text, expected=f"about {value}", got=str(seen))


def _other_model(name: str, probe: Probe) -> None:
    """Send a command that the model does not have, and look at the shaft."""
    if not probe.dialect.model:
        raise NotRun("which model it is was not said")
    motion.ready_to_move(probe)
    whole = probe.dialect.whole
    frame = encoder.build(whole, name, probe.address, {FORCES[name]: TORQUE})
    before = motion.position(probe)
    exchange = probe.send(frame, timeout_ns=500 * MS)
    after = motion.position(probe)
    motion.stand_still(probe)
    model = probe.dialect.model
    expect_stays(before, after, exchange, f"an {model} obeys {name}, which is not a command of its")
