"""A kept run (FF): what it was begins again when the drive restarts or power comes on, and what was forgotten does not.

save_speed/restart, power         it begins again, though the shaft was stopped before
save_speed/as-it-was              with its speed, its way and its ramp
save_speed/no-sooner              but not when another mode, enabling or releasing makes the motor ready
save_speed/clean, clean-at-rest   one that was forgotten does not
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import copysign

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from conformance.claim import Inconclusive, Refuted
from conformance.claims.declare import Case
from conformance.claims.settings.read_back import of_read_back
from conformance.motion import declared, motion
from conformance.motion.declared import SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe
from conformance.talk.restarts import need_axis_lock, power_cycle, restart

#: What makes a drive begin again: its name in ids, in words, and what does it. Power is cut of emulated drives alone.
BeginsAgain = Callable[[Probe], object]
ENDS: tuple[tuple[str, str, BeginsAgain], ...] = (
    ("restart", "a restart", restart),
    ("power", "the power was cut", power_cycle),
)
#: The speed of most runs, and as what share of it two speeds are one.
_RPM, _SHARE = 60, 0.1
#: A run whose speed takes two bytes, and whose ramp takes two seconds.
_FAST_RPM, _LONG_RAMP, _RAMP_NS = 600, 192, 2_000 * MS
#: What keeps a run, and what makes the drive forget it.
_KEEP, _FORGET = {"save_state": 0xC8}, {"save_state": 0xCA}
#: How long a run is given to end where it should not, to show its way on a long ramp, and what is damaged to be answered.
_GOES_ON_NS, _SHOWS_NS = 60 * MS, 150 * MS
_DAMAGED_NS = 60 * MS
#: How long a drive that answers is given to begin a kept run, and its shaft to stand behind what ends it: without torque it
#: runs out.
_BEGINS_NS, _ENDS_NS = 300 * MS, 4_000 * MS


def _saved_runs(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.SAVE_SPEED)
    if command is not None:
        risks = command.risks(_KEEP) | command.risks(_FORGET) | declared.risks(dialect, Risk.UNBOUNDED)
        facts = {
            "fields": ("save_state",),
            "risks": risks | dialect.by_verb[Verb.RESTART].all_risks,
            "settings": declared.settings(dialect),
        }
        yield Case(dialect, command, {}, facts)


def _turning(probe: Probe, rpm: int, mode: str = "") -> float:
    motion.ready_to_move(probe, mode, subdivision=SUBDIVISION)
    # A drive that keeps an older run than the newest is found by this one.
    motion.run_at(probe, -rpm)
    motion.run_at(probe, rpm)
    probe.wait(100 * MS)
    return motion.speed(probe).value


def _after(probe: Probe, begin_again: BeginsAgain, stop: Verb = Verb.STOP_SPEED, rpm: float = 0.0) -> tuple[float, Exchange]:
    """Stop the shaft at once, let the drive begin again, and return how fast it turns then, and what was sent last.

    `rpm`: a speed at which no more is waited for.
    """
    command = probe.command(stop)
    probe.ask(command, {"acceleration": 0} if "acceleration" in command.request_forms[0].layout.named else None)
    motion.wait_standing(probe)
    begin_again(probe)
    exchange = probe.traffic[-1]
    seen = [0.0]

    def turns() -> bool:
        seen.append(motion.speed(probe).value)
        return bool(rpm) and abs(seen[-1] - rpm) <= abs(rpm) * _SHARE

    motion.wait_until(probe, turns, limit_ns=2 * _BEGINS_NS if rpm else _BEGINS_NS)
    return seen[-1], exchange


def _forget(probe: Probe, command: Command) -> None:
    probe.ask(command, _FORGET)
    motion.stand_still(probe)


def _saved_in_a_mode(dialect: Dialect) -> Iterator[Case]:
    """Yield it for the mode between: in the others a run is kept by other claims."""
    for case in _saved_runs(dialect):
        mode = [each for each in declared.bus_modes(dialect) if "no_encoder" not in each][-2]
        for end, how, begin_again in ENDS:
            given = {"mode": mode, "end": end, "how": how, "begin_again": begin_again}
            facts = {"parameters": {"mode": mode}, "emulated": end == "power"}
            yield Case(dialect, case.command, given, {**case.facts, **facts})


@of_read_back(each=_saved_in_a_mode, name="{command}/{end}", refuted_by="another speed, or none", rests_on=(Doubt.VALUES,))
def _saved(probe: Probe, command: Command, mode: str, how: str, begin_again: BeginsAgain) -> None:
    """In {mode} a run that is kept goes on, and begins again after {how}, though the emergency stop ended it."""
    need_axis_lock(probe)
    before = _turning(probe, -_RPM, mode)
    exchange = probe.do(command, _KEEP)
    text = "a run does not go on when it is kept"
    within = max(2.0, abs(before) * _SHARE)
    probe.expect(motion.speed(probe).value, near=before, within=within, unit="rpm", refutes=text, exchange=exchange)
    after, exchange = _after(probe, begin_again, Verb.EMERGENCY_STOP, before)
    _forget(probe, command)
    probe.expect(
        after,
        near=before,
        within=max(2.0, abs(before) * _SHARE),
        unit="rpm",
        refutes=f"a kept run at {before:.0f} rpm is one at {after:.0f} rpm after {how}",
        exchange=exchange,
        key="saved run",
    )


def _saved_as_set(dialect: Dialect) -> Iterator[Case]:
    for case in _saved_runs(dialect):
        yield Case(dialect, case.command, {}, {**case.facts, "settings": (*case.facts["settings"], "motor_direction")})


@of_read_back(each=_saved_as_set, name="{command}/as-it-was", refuted_by="another run, or none", rests_on=(Doubt.VALUES,))
def _saved_as_it_was(probe: Probe, command: Command) -> None:
    """In an open mode, at 8 subdivisions, a kept run is as it was after each of two restarts, and disabling ends it."""
    need_axis_lock(probe)
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[0], subdivision=8)
    probe.do(Verb.SET_DIRECTION, {"motor_direction": 1})
    run = probe.command(Verb.RUN_SPEED)
    # A ramp that is still under way when the speed is first looked at, and a speed of two bytes.
    values = declared.values_of(probe.dialect, run, rpm=_FAST_RPM, acceleration=_LONG_RAMP, subdivision=8)
    probe.do(run, values)
    probe.do(command, _KEEP)
    probe.wait(_SHOWS_NS)
    wanted = copysign(_FAST_RPM, motion.speed(probe).value)
    for number in ("first", "second"):
        motion.stand_still(probe)
        exchange = restart(probe)
        early = motion.speed(probe)
        probe.wait(_RAMP_NS)
        seen = motion.speed(probe)
        text = f"a run kept at {wanted:+g} rpm and 8 subdivisions is another after the {number} restart"
        try:
            probe.expect(seen.value, near=wanted, within=_FAST_RPM * _SHARE, unit="rpm", refutes=text, exchange=exchange)
            text = "a run kept with a slow ramp begins without it"
            probe.expect(abs(early.value), at_most=_FAST_RPM * (1 - 2 * _SHARE), unit="rpm", refutes=text, exchange=exchange)
        except Refuted:
            _forget(probe, command)
            raise
    _expect_ended(probe, command, motion.switch(probe, False))
    motion.switch(probe, True)
    _forget(probe, command)


def _expect_ended(probe: Probe, command: Command, ended: Exchange) -> None:
    """Refute a kept run that goes on behind what was to end it; it is forgotten then."""
    assert ended.command is not None  # it was asked for
    try:
        motion.wait_standing(probe, limit_ns=_ENDS_NS)
    except Inconclusive:
        turning = motion.speed(probe)
        _forget(probe, command)
        text = f"{ended.command.name} does not end a kept run that began again"
        probe.expect(turning.value, near=0, within=_RPM / 2, unit="rpm", refutes=text, exchange=ended)
        raise


def _made_ready(probe: Probe) -> Iterator[tuple[str, Exchange]]:
    """Make the motor ready in each way that is not a begin of the drive; yield each in words, and what was sent."""
    modes, buses = probe.command(Verb.SET_WORK_MODE), declared.bus_modes(probe.dialect)
    for mode in (buses[0], buses[-1]):
        motion.set_mode(probe, declared.pulse_modes(probe.dialect)[0])
        yield "a mode of pulses is left", probe.do(modes, {"work_mode": declared.choice(modes, "work_mode", mode)})
    yield "another mode is set", probe.do(modes, {"work_mode": declared.choice(modes, "work_mode", buses[0])})
    motion.switch(probe, False)
    yield "the motor is enabled", motion.switch(probe, True)
    release = probe.dialect.by_verb.get(Verb.RELEASE_PROTECTION)
    if release is not None:
        yield "the protection is released", probe.ask(release)


@of_read_back(each=_saved_runs, refuted_by="a shaft that turns", at_best=Certainty.LIKELY)
def _no_sooner(probe: Probe, command: Command) -> None:
    """A kept run that was stopped does not begin when a pulse mode is left, another mode is set, or the motor is enabled."""
    before = _turning(probe, -_RPM)
    probe.do(command, _KEEP)
    motion.stand_still(probe)
    for when, exchange in _made_ready(probe):
        probe.wait(_BEGINS_NS)
        seen = motion.speed(probe)
        if abs(seen.value) > abs(before) / 2:
            _forget(probe, command)
        text = f"a kept run begins when {when}"
        probe.expect(abs(seen.value), at_most=abs(before) / 2, unit="rpm", refutes=text, exchange=exchange)
    _forget(probe, command)


@of_read_back(each=_saved_runs, refuted_by="a shaft that turns", rests_on=(Doubt.VALUES,))
def _clean(probe: Probe, command: Command) -> None:
    """A run that was forgotten goes on, and does not begin after a restart, nor one that was kept with a wrong check alone."""
    before = _turning(probe, _RPM)
    probe.do(command, _KEEP)
    exchange = probe.do(command, _FORGET)
    probe.wait(_GOES_ON_NS)
    text, within = "a run does not go on when it is forgotten", max(2.0, abs(before) * _SHARE)
    probe.expect(motion.speed(probe).value, near=before, within=within, unit="rpm", refutes=text, exchange=exchange)
    _expect_forgotten(probe, command)


@of_read_back(each=_saved_runs, name="{command}/clean-at-rest", refuted_by="a shaft that turns", rests_on=(Doubt.VALUES,))
def _clean_at_rest(probe: Probe, command: Command) -> None:
    """A run that began again ends by the emergency stop; forgotten then, at rest, it does not begin after another restart."""
    _turning(probe, -_RPM)
    probe.do(command, _KEEP)
    motion.stand_still(probe)
    restart(probe)
    probe.wait(_BEGINS_NS)
    _expect_ended(probe, command, probe.ask(Verb.EMERGENCY_STOP))
    probe.do(command, _FORGET)
    _expect_forgotten(probe, command)


def _expect_forgotten(probe: Probe, command: Command) -> None:
    built = probe.build(command, _KEEP)
    for check in probe.dialect.link.checks(built.frame, probe.address):
        changed = bytearray(built.frame)
        changed[check.start] ^= 1
        probe.send(built.item(bytes(changed)), timeout_ns=_DAMAGED_NS)
    after, exchange = _after(probe, restart)
    if abs(after) > 1 + probe.noise.rpm:
        _forget(probe, command)
    refutes = f"a forgotten run turns the shaft at {after:.0f} rpm after a restart"
    probe.expect(abs(after), at_most=1, unit="rpm", refutes=refutes, exchange=exchange, key="clean run")
