"""Noise of a drive and its line: measured by reads alone on a shaft that rests, and by a short move."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from analyzer.catalogue import Command, Dialect, MotionKind, Verb
from analyzer.protocols.lk_rs485 import ERROR_BITS, BrakeControl, BrakeState
from analyzer.protocols.mks_shared import Protection
from conformance.claim import Claim, Inconclusive
from conformance.gate.gate import Refused
from conformance.motion import arriving, declared, motion
from conformance.motion.declared import CALM, QUICK
from conformance.talk import restarts
from conformance.talk.noise import LOOP_DEGREES, QUIET, Noise
from conformance.talk.probe import MS, SECOND_NS, Until

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

_TIMES = 24
#: How often a shaft is looked at that was stopped at once.
_SWINGS = 4
#: How often a supply or a speed is looked at, and the bytes before a reply.
_FEWER = 12
#: How often a measurement is begun in which the line damages or loses something.
_ATTEMPTS = 4
#: Fields of the supply.
_SUPPLY = ("voltage", "current", "temperature")
#: Bytes that a line shows while nothing sends, and how many of them at most.
_IDLE, _HIGH, _MOST_STRAY = b"\x00\xff", b"\xff", 2
#: A shaft that turns is not at rest, in rpm.
_RESTS = 5.0
#: When a move has come to its speed, until when it keeps it, how far it goes, in degrees, and how fast: in whole rpm
#: a slower one shows its rounding alone.
_GOING_NS, _STEADY_NS, _WAY, _RPM = 300 * MS, 900 * MS, 1080.0, 180
#: By then a run that a drive keeps turns the shaft.
_BEGINS_NS = 150 * MS
#: How long a shaft that stands is watched.
_CREEPS_NS = 800 * MS
#: The first looks at it, in which it may still settle: that is no tremble.
_SETTLING = 5
#: From this share on a speed differs from the one asked for; a move that misses by these degrees did not go its way.
_ANOTHER, _SHORT = 0.1, 90.0
#: Short moves tell how far from its targets a loop rests: their number, their length in degrees, and when each has settled.
_MOVES, _STEP, _SETTLED_NS = 8, 30.0, 150 * MS
#: What a drive's own limits must leave to the suite, as they are sent, 0 being no limit; and a run that they allow.
_LIMITED_RPM, _LIMITED_NS = 120, 500 * MS
_LEAST = {"speed_limit": 72_000, "speed_ramp": 180_000}
#: Reading the brake and nothing else.
_ASK_BRAKE = {"brake_control": int(BrakeControl.READ)}
#: What a speed may tremble by that is told in whole rpm.
_HIDDEN_RPM = 0.5


def measure(probe: Probe) -> Noise:
    """Return the noise of a drive that rests; that of its line alone where it turns or its reads do not work."""
    try:
        probe.noise = _of_line(probe)
        places = [motion.position(probe).value for _ in range(_TIMES)]
        speeds = [motion.speed(probe).value for _ in range(_FEWER)]
        loop = [_angle_error(probe) for _ in range(_FEWER)]
        supply = _supply(probe)
    except Inconclusive:
        return probe.noise
    if max(map(abs, speeds)) > _RESTS:
        return probe.noise
    latency_ns = max((ns for _, ns in probe.latencies), default=0)
    degrees, rpm = _half_span(places), max(map(abs, speeds))
    return replace(probe.noise, degrees=degrees, loop=max(loop), rpm=rpm, supply=supply, latency_ns=latency_ns)


def let_stand(probe: Probe) -> bool:
    """Bring a shaft to rest that turns since power came on: a way back to zero ends, a kept run is stopped and forgotten.

    Returns whether a run was forgotten. Raises Inconclusive where the shaft does not come to rest, Refused where that is not
    allowed.
    """
    if max(abs(motion.speed(probe).value) for _ in range(2)) < _RESTS:
        return False
    restarts.wait_for_arrival(probe, probe.address)
    # Behind the way back a kept run has just begun.
    probe.wait(_BEGINS_NS)
    if abs(motion.speed(probe).value) < _RESTS:
        return False
    motion.stand_still(probe)
    return forget_run(probe)


def forget_run(probe: Probe, mode: int | None = None) -> bool:
    """Make a drive forget the run that it may keep for power-on; say whether its dialect has such runs.

    No read tells of one. In a pulse mode it does not begin, and forgetting is refused: so a mode of the bus is set first.
    `mode`: the work mode, as sent, to go back to. Raises Inconclusive, Refused, NotRun.
    """
    command = probe.dialect.by_verb.get(Verb.SAVE_SPEED)
    if command is None:
        return False
    for left in reversed(range(_ATTEMPTS)):
        try:
            motion.ready_to_move(probe)
            probe.do(command, {"save_state": declared.choice(command, "save_state", "clean")})
            if mode is not None:
                probe.do(Verb.SET_WORK_MODE, {"work_mode": mode})
            break
        except Inconclusive:
            # The line may have damaged it.
            if not left:
                raise
    return True


def in_motion(probe: Probe) -> Noise:
    """Turn the shaft for a moment; return the noise with that of the speed and of a shaft that has just come to rest.

    Where the drive does not run, the noise is that at rest, and the hindrance what the drive says of it. What the line damages
    or loses is measured anew, the other way: what a shaft misses behind a turn, an encoder's hysteresis, shows then too. What
    was seen before stays.
    """
    for attempt in range(_ATTEMPTS):
        since = len(probe.traffic)
        with suppress(Inconclusive, Refused):
            probe.noise = _in_motion(probe, _WAY * (-1) ** attempt)
        if not any(exchange.damaged or (exchange.awaited and not exchange.is_read) for exchange in probe.traffic[since:]):
            break
        with suppress(Inconclusive, Refused):
            motion.stand_still(probe)
    return probe.noise


def _in_motion(probe: Probe, way: float) -> Noise:
    """Measure that by a move of so many degrees. Raises Inconclusive, Refused where the drive does not run."""
    motion.ready_to_move(probe)
    before = motion.position(probe).value
    asked = motion.ask(probe, _move(probe.dialect), way, rpm=_RPM, acceleration=QUICK, quiet_ns=0)
    if motion.refused(probe, asked):
        return replace(probe.noise, hindrance=_protection(probe))
    begun_ns = probe.gate.now_ns()
    probe.wait(_GOING_NS)
    speeds: list[float] = []
    while len(speeds) < _TIMES and probe.gate.now_ns() - begun_ns < _STEADY_NS:
        now = abs(motion.speed(probe, probe.noise.silence_ns).value)
        if speeds and now < speeds[0] / 2:
            # At some subdivisions the shaft is faster than was sent, and is there before.
            break
        speeds.append(now)
    mean = sum(speeds) / len(speeds) if speeds else 0.0
    another = mean > _RESTS and abs(mean - _RPM) > _RPM * _ANOTHER
    if another and probe.dialect.subdivision is not None and not probe.noise.rescaled:
        motion.stand_still(probe)
        probe.noise = replace(probe.noise, rescaled=True)
        return _in_motion(probe, way)
    swings = _arriving(probe)
    motion.wait_standing(probe)
    # A loop goes on towards its target when the shaft seems to stand.
    after = [sample.value for sample in motion.sampled(probe, _CREEPS_NS, _CREEPS_NS // _TIMES)]
    if len(after) <= _SETTLING:
        raise Inconclusive("the replies come too late to look at a shaft again and again")
    hindrance = _hindrance(probe, abs(after[-1] - before)) or _limits(probe)
    if hindrance:
        return replace(probe.noise, hindrance=hindrance)
    lag = max([_lag(probe), *(abs(after[-1] - place) for place in swings)])
    # A loop that stands still may rest beside its target all the same, and no read of a resting shaft shows that.
    missed = abs(abs(after[-1] - before) - _WAY) / 2
    loop = max(probe.noise.loop, missed if missed <= LOOP_DEGREES else 0.0)
    degrees = max(probe.noise.degrees, _half_span(after[_SETTLING:]))
    noise = replace(probe.noise, degrees=degrees, loop=loop, lag=lag, hindrance="")
    if noise.live:
        noise = replace(noise, loop=max(loop, _beside(probe)))
    if min(speeds, default=0.0) < _RESTS:
        return noise
    trembling = _half_span(speeds)
    # A tremble that a whole rpm hides shows at higher speeds.
    least = _HIDDEN_RPM if noise.live or trembling else 0.0
    return replace(noise, share=max(trembling, least) / mean)


def _beside(probe: Probe) -> float:
    """Return how many degrees from its targets a loop rests: by its own word, and by how differently moves miss them.

    What all moves miss alike is no tremble.
    """
    move, before = _move(probe.dialect), motion.position(probe).value
    missed, told = [], []
    for _ in range(_MOVES):
        motion.ask(probe, move, _STEP, rpm=_RPM, acceleration=QUICK)
        motion.wait_standing(probe)
        probe.wait(_SETTLED_NS)
        now = motion.position(probe).value
        missed.append(abs(now - before))
        told.append(_angle_error(probe))
        before = now
    return max(_half_span(missed) / 2, *told)


def _arriving(probe: Probe) -> list[float]:
    """Wait until a move is told as complete; return where the shaft is then, again and again. Empty where no end is told."""
    if not arriving.tells_end(probe.dialect):
        return []
    probe.listen(3 * SECOND_NS, Until.REPLY)
    return [motion.position(probe).value for _ in range(_SWINGS)]


def _lag(probe: Probe) -> float:
    """Return how many degrees the shaft goes on after a stop at once has been answered."""
    if probe.dialect.ramp is None:
        return 0.0
    motion.run_at(probe, CALM)
    probe.wait(_GOING_NS)
    probe.ask(Verb.STOP_SPEED, {"acceleration": 0}, quiet_ns=0)
    swings = [motion.position(probe).value for _ in range(_SWINGS)]
    rests = motion.wait_standing(probe, stopped=True).value
    return max(abs(rests - place) for place in swings)


# --- why a shaft does not turn ----------------------------------------------------------------------------------------


def _limits(probe: Probe) -> str:
    """Return the limit of the drive's own parameters by which a run is slow, or nothing."""
    command = probe.dialect.by_verb.get(Verb.READ_PARAMETER)
    if command is None or probe.dialect.ramp is not None:
        return ""
    motion.run_at(probe, _LIMITED_RPM)
    probe.wait(_LIMITED_NS)
    rpm = abs(motion.speed(probe).value)
    motion.stand_still(probe)
    if rpm > _LIMITED_RPM * (1 - _ANOTHER):
        return ""
    for form in command.reply_forms:
        for name, least in _LEAST.items():
            if name in form.layout.named:
                answer = probe.ask(command, {"parameter": form.layout.named["parameter"].fixed}).reply
                held = answer.values.get(name, 0) if answer is not None else 0
                if 0 < abs(held) < least:
                    return f"the drive's own {name} is {held}: set it to {least} or more"
    return ""


def _protection(probe: Probe) -> str:
    """Return that a drive protects itself, as it says, or nothing."""
    read = probe.dialect.by_verb.get(Verb.READ_PROTECTION)
    protects = read is not None and probe.read(read) == Protection.PROTECTED
    return "the drive protects itself: see what held its shaft, and release the protection" if protects else ""


def _hindrance(probe: Probe, went: float) -> str:
    """Return why the shaft went less than it was told to, as the drive says itself, or nothing."""
    if went > _WAY - _SHORT:
        return ""
    verbs = probe.dialect.by_verb
    if Verb.BRAKE in verbs and probe.read(Verb.BRAKE, "brake_state", _ASK_BRAKE) == BrakeState.POWER_OFF:
        return "the brake holds the shaft"
    if Verb.READ_STATE_1 in verbs:
        told = probe.reply(probe.ask(Verb.READ_STATE_1)).values
        flags = [field.name for field in ERROR_BITS if told.get(field.name)]
        return f"the drive turns nothing while its error flags are set: {', '.join(flags)}" if flags else ""
    missing = _angle_error(probe)
    if abs(went + missing - _WAY) < _SHORT:
        return f"the shaft is held: it is {missing:.0f} degrees from where the drive wants it"
    return _protection(probe)


def can_turn(dialect: Dialect, claim: Claim) -> bool:
    """Say whether what a claim may do is enough to measure the speed of a shaft that turns."""
    return declared.can_move(dialect) and claim.risks >= declared.risks(dialect, *_move(dialect).all_risks)


def _move(dialect: Dialect) -> Command:
    """Return a move that is told its speed, and whose length no setting changes."""
    moves = dialect.motions(MotionKind.MOVE_BY, MotionKind.MOVE_TO)
    return next(m for m in moves if declared.of(m).speed and not declared.takes_pulses(m))


def _half_span(values: list[float]) -> float:
    return (max(values) - min(values)) / 2


def _angle_error(probe: Probe) -> float:
    """Return how far from its target the shaft says that it is, in degrees; 0 where nothing tells it."""
    command = probe.dialect.by_verb.get(Verb.READ_ANGLE_ERROR)
    if command is None:
        return 0.0
    field = command.reply_forms[0].layout.named["angle_error"]
    return abs(float(field.physical(probe.read(command, "angle_error"))))


def _supply(probe: Probe) -> dict[str, float]:
    """Return by how much volts, amperes and degrees Celsius tremble, by their units."""
    command = probe.dialect.by_verb.get(Verb.READ_STATE_1)
    if command is None:
        return {}
    seen = [probe.reply(probe.ask(command, quiet_ns=0)).values for _ in range(_FEWER)]
    fields = (command.reply_forms[0].layout.named[name] for name in _SUPPLY)
    spans = {f.unit: _half_span([float(f.physical(values[f.name])) for values in seen]) for f in fields}
    return {unit: span for unit, span in spans.items() if span}


def _of_line(probe: Probe) -> Noise:
    """Return the bytes of an idle line that come before every reply and behind it, and what is known of the end of a reply."""
    if probe.dialect.bus == "can":
        return QUIET
    before: set[bytes] = set()
    behind: set[bytes] = set()
    last: set[bytes] = set()
    repeated: set[int] = set()
    checked, lost = False, 0
    # The replies end in different bytes.
    reads = (declared.reads_position(probe.dialect), declared.reads_speed(probe.dialect)) * (_FEWER // 2)
    for command in reads:
        exchange = probe.ask(command, quiet_ns=0)
        answer = exchange.reply
        if answer is None or not answer.is_whole:
            # What the line damaged now and then does not show what it adds each time.
            lost += 1
            continue
        checked = checked or not answer.bare
        first, _, rest = exchange.received.partition(answer.data)
        before.add(first)
        behind.add(rest)
        last.add(answer.data[-1:])
        repeated.add(len(rest) if rest and answer.data.endswith(rest) else 0)
    if lost > _FEWER // 2:
        return QUIET
    trailing = _idle(behind)
    # A driver that lets go of the line makes a start bit of it, and ones; a byte of zeros is sent.
    trailing = trailing if trailing.strip(_HIGH) == b"" else b""
    repeats = min(repeated) if len(repeated) == 1 and len(last) > 1 and not trailing else 0
    repeats = repeats if repeats <= _MOST_STRAY else 0
    return Noise(stray=_idle(before), trailing=trailing, repeats=repeats, checked=checked)


def _idle(found: set[bytes]) -> bytes:
    """Return bytes that are the same each time and no more than those of an idle line."""
    (stray, *others) = found
    return stray if not others and len(stray) <= _MOST_STRAY and not stray.strip(_IDLE) else b""
