"""Motion of a drive under test: making it ready, asking for motion, watching it, and bringing it to rest.

    ready_to_move(probe)                        a bus work mode and enabled (MKS), switched on (LK)
    position(probe), speed(probe)               in degrees and rpm, whatever the dialect counts in
    begin(probe, run, rpm=60)                   a run at 60 rpm, by the dialect's own command and units
    wait_standing(probe)                        until speed 0 and a position that does not change
    stand_still(probe)                          a stop by a ramp that keeps the torque, verified

Rules kept here:
- What a command does and what a read means is the catalogue's word (`declared`); nothing here knows a code.
- Distances are degrees, signed: positive raises the position. Speeds are rpm of the shaft.
- A move to a place goes from where the drive says that it is, so that nothing depends on its zero.
- A value is known to have been true at some moment between the end of the request and the begin of the reply (`Sample`).
- A motion that does not work raises Inconclusive: a claim of its own judges it.
- A move that is followed to its end stands in `arriving`.
- Nothing here disables a motor or goes faster than it is told.

Not known here: in which work mode a native MKS drive is, since none can be read. A drive that refuses to be enabled is in
a pulse mode.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, MotionKind, Verb
from conformance.claim import Inconclusive
from conformance.gate.gate import Refused
from conformance.motion import declared, ramp
from conformance.motion.declared import CALM, QUICK, SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Until

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: Room that an absolute move needs on each side, in its units: no claim goes more than twenty turns.
_ROOM = 400_000
#: What a move takes longer than the law at most before it is given up.
_PATIENCE = 1.5
_GRACE_NS = 3 * SECOND_NS
#: Between two looks at a shaft that may still turn; one that does not tremble shows each count.
_LOOK_NS, _FAST_LOOK_NS, QUIET_LOOK_NS = 50 * MS, 150 * MS, 25 * MS
#: What a look at the speed takes at most of that time.
_SPEED_NS = 10 * MS
#: How long a shaft may take to come to rest.
_REST_NS = 30 * SECOND_NS
#: After this time a shaft with an unchanged speed is not on a ramp, and the wait for the ramp's end stops.
NO_RAMP_NS, AS_FAST = 3 * SECOND_NS, 0.95
#: How often a measurement is taken again whose reply cannot be read.
_AGAIN = 2
#: The unit by which the noise of a quantity is known.
_UNITS: Mapping[str, str] = {"position": "degrees", "speed": "rpm"}


@dataclass(frozen=True)
class Sample:
    """A measured value: it held at some moment within `spread_ns` of `t_ns`. `step`: the smallest difference it shows.

    `noise`: by how much it may be off, as the run measured.
    """

    t_ns: float
    spread_ns: float
    value: float
    step: float
    noise: float = 0.0

    def minus(self, other: Sample) -> tuple[float, float]:
        """Return the difference of two values and of their times (ns)."""
        return self.value - other.value, self.t_ns - other.t_ns


# --- making ready -----------------------------------------------------------------------------------------------------


def ready_to_move(probe: Probe, mode: str = "", *, subdivision: int | None = None) -> None:
    """Bring a drive into a state in which the bus moves it.

    `mode`: the work mode by name; without one, the mode that the drive has is kept if the bus moves the motor in it.
    `subdivision`: set it to this (as sent); None: leave it, where speeds are what is sent. Raises Inconclusive where the drive
    refuses.
    """
    verbs = probe.dialect.by_verb
    if Verb.MOTOR_ON in verbs:
        probe.do(Verb.MOTOR_ON)
    else:
        if mode or not _enabled_now(probe):
            set_mode(probe, mode or declared.bus_modes(probe.dialect)[-1])
            probe.do(Verb.ENABLE, {"enabled": 1})
        if subdivision is None and probe.noise.rescaled and not _sets_subdivision(probe):
            subdivision = SUBDIVISION
        if subdivision is not None and Verb.SET_SUBDIVISION in verbs:
            probe.do(Verb.SET_SUBDIVISION, {"subdivision": subdivision})


def _sets_subdivision(probe: Probe) -> bool:
    """Say whether a claim has set the subdivision itself."""
    return any(e.command is not None and e.command.verb is Verb.SET_SUBDIVISION for e in probe.traffic)


def set_mode(probe: Probe, mode: str) -> None:
    """Set a work mode by its name."""
    command = probe.command(Verb.SET_WORK_MODE)
    probe.do(command, {"work_mode": declared.choice(command, "work_mode", mode)})


def _enabled_now(probe: Probe) -> bool:
    exchange = probe.ask(Verb.ENABLE, {"enabled": 1}, quiet_ns=0)
    probe.reply(exchange)
    return not probe.refused(exchange)


def switch(probe: Probe, on: bool) -> Exchange:
    """Switch the motor on or off. Raises Inconclusive where the drive refuses."""
    return probe.do(*declared.switching(probe.dialect, on))


def is_on(probe: Probe) -> bool | None:
    """Read whether the motor is on; None for a value that says neither, or where nothing tells it."""
    for verb, name, on, off in declared.ON_READ:
        if verb in probe.dialect.by_verb:
            return {on: True, off: False}.get(probe.read(verb, name))
    return None


# --- measuring --------------------------------------------------------------------------------------------------------


def _measure(probe: Probe, reading: declared.Reading, patience_ns: int | None = None) -> Sample:
    until = Until.REPLY if patience_ns is None else Until.READ
    exchange = probe.ask(reading.command, until=until, quiet_ns=0, timeout_ns=patience_ns)
    for _ in range(_AGAIN):
        if exchange.is_read:
            break
        # What a motion says at its end can collide with a request or its reply.
        probe.wait(_LOOK_NS // 2)
        exchange = probe.ask(reading.command, until=until, quiet_ns=0, timeout_ns=patience_ns)
    answer = probe.reply(exchange, once_more=patience_ns is None)
    names = [f.name for f in reading.fields]
    if answer.command is not None and answer.command.name != reading.command.name:
        raise Inconclusive(f"{reading.command.name} was not answered, only {answer.command.name}")
    if any(n not in answer.values for n in names):
        raise Inconclusive(f"the answer to {reading.command.name} has no {' and '.join(names)}")
    between_ns = max(0, answer.first_ns - exchange.sent_ns)
    value, unit = reading.value(answer.values), _UNITS.get(reading.quantity, "")
    return Sample(exchange.sent_ns + between_ns / 2, between_ns / 2, value, reading.step, probe.noise.of(unit, value))


def position(probe: Probe, patience_ns: int | None = None) -> Sample:
    """Measure where the shaft is, in degrees over all turns. Raises Inconclusive where it cannot be read.

    `patience_ns`: how long each reply is waited for; None: as long as the rig waits. The gate is told: it bounds moves to a
    place by where the shaft is.
    """
    sample = _measure(probe, declared.reading(probe.dialect, "position"), patience_ns)
    probe.gate.note_position(sample.value, probe.address)
    return sample


def speed(probe: Probe, patience_ns: int | None = None) -> Sample:
    """Measure the speed, in rpm, positive where the position rises. Raises Inconclusive where it cannot be read.

    `patience_ns`: as `position` takes it.
    """
    return _measure(probe, declared.reading(probe.dialect, "speed"), patience_ns)


def speed_between(first: Sample, second: Sample) -> tuple[float, float]:
    """Return the mean speed between two positions in rpm, and its uncertainty."""
    degrees, elapsed_ns = second.minus(first)
    if elapsed_ns <= 0:
        raise Inconclusive("two positions of one moment tell no speed")
    rpm = degrees / 6 / (elapsed_ns / SECOND_NS)
    spread_ns = first.spread_ns + second.spread_ns
    uncertain = abs(rpm) * spread_ns / elapsed_ns + (second.step + second.noise) / 6 / (elapsed_ns / SECOND_NS)
    return rpm, uncertain


def turning(probe: Probe) -> Sample:
    """Measure the speed of a turning shaft in rpm: as the drive reads it, or from positions where no read is about it alone."""
    if Verb.READ_SPEED in probe.dialect.by_verb:
        return speed(probe)
    rpm, spread = mean_speed(probe, 300 * MS)
    return Sample(probe.gate.now_ns(), 0.0, rpm, spread, spread)


def mean_speed(probe: Probe, over_ns: int = SECOND_NS) -> tuple[float, float]:
    """Return the speed of a turning shaft from two positions (rpm, signed), and its uncertainty."""
    first = position(probe)
    probe.wait(over_ns)
    return speed_between(first, position(probe))


def sampled(probe: Probe, duration_ns: int, every_ns: int) -> list[Sample]:
    """Measure the position again and again for a time."""
    until_ns = probe.gate.now_ns() + duration_ns
    found = []
    while True:
        begun_ns = probe.gate.now_ns()
        found.append(position(probe))
        now_ns = probe.gate.now_ns()
        if now_ns >= until_ns:
            return found
        probe.wait(min(every_ns - (now_ns - begun_ns), until_ns - now_ns))


def wait_until(probe: Probe, is_so: Callable[[], bool], *, every_ns: int = 20 * MS, limit_ns: int = 20 * SECOND_NS) -> None:
    """Wait until something is so, asking again and again, or until the time is over."""
    until_ns = probe.gate.now_ns() + limit_ns
    while not is_so() and probe.gate.now_ns() < until_ns:
        probe.wait(every_ns)


# --- asking for motion ------------------------------------------------------------------------------------------------


def miss(probe: Probe) -> float:
    """Return by how many degrees a move of this drive may miss its target, as it reads."""
    return declared.near(probe.dialect) + probe.noise.place


def same(probe: Probe) -> float:
    """Return in how many degrees two positions are one: two counts of the coarsest encoder, and the noise."""
    return probe.within("degrees")


def place(probe: Probe, command: Command) -> int:
    """Return where the shaft is as a move to a place counts it, as sent; 0 for a move by a distance.

    Raises Inconclusive where the move could not go on from there.
    """
    motion = declared.of(command)
    if not motion.counted_by:
        return 0
    # A gate that bounds turns has to know where the shaft is.
    degrees = position(probe).value
    read = probe.command(motion.counted_by)
    now = probe.read(read, next(iter(read.reply_forms[0].layout.named)))
    target = declared.distance_of(command)
    if motion.kind is MotionKind.MOVE_TO and not target.low + _ROOM <= now <= target.high - _ROOM:
        raise Inconclusive(f"{read.name} reads {now}, from where {command.name} cannot go on")
    probe.gate.note_position(degrees, probe.address, now if declared.takes_pulses(command) else None)
    return now


def prepare(probe: Probe, command: Command) -> None:
    """Make a drive ready for a motion; one that counts pulses gets the subdivision of the suite."""
    ready_to_move(probe, subdivision=SUBDIVISION if declared.takes_pulses(command) else None)


#: Units between two targets of which one begins no frame: the heads of the native dialect are three in a row.
BESIDE = 3


def ask(
    probe: Probe,
    command: Command,
    degrees: float = 0.0,
    *,
    until: Until = Until.REPLY,
    timeout_ns: int | None = None,
    quiet_ns: int | None = None,
    more: Mapping[str, int] | None = None,
    start: int | None = None,
    **how: Any,
) -> Exchange:
    """Ask for a motion and return the exchange, refused or not.

    `how`: as `values_of` takes it. `start`: where a move to a place begins; read, where it is not given. `more`: values as sent
    in place of those.
    """
    begun = place(probe, command) if start is None else start
    if until is Until.DONE and timeout_ns is None:
        law_ns = ramp.move_ns(degrees / 360, how.get("rpm", CALM), how.get("acceleration", QUICK))
        timeout_ns = int(law_ns * _PATIENCE) + _GRACE_NS
    values = declared.values_of(probe.dialect, command, degrees, start=begun, **how) | dict(more or {})
    replies: dict[str, Any] = {"until": until, "timeout_ns": timeout_ns, "quiet_ns": quiet_ns}
    try:
        return probe.ask(command, values, **replies)
    except Refused:
        distance = declared.of(command).distance
        if not distance or distance in (more or {}):
            raise
        # Where the shaft stands, the bytes of a target may read as a frame of another dialect: beside it they do not.
        beside = values[distance] + (-BESIDE if values[distance] > 0 else BESIDE)
        return probe.ask(command, values | {distance: beside}, **replies)


def refused(probe: Probe, exchange: Exchange) -> bool:
    """Say whether a motion was refused. Raises Inconclusive where there is no readable answer."""
    probe.reply(exchange)
    return probe.refused(exchange)


def begin(probe: Probe, command: Command, degrees: float = 0.0, **how: Any) -> Exchange:
    """Ask for a motion, as `ask` does. Raises Inconclusive where it is refused or not answered."""
    exchange = ask(probe, command, degrees, **{"quiet_ns": probe.quiet_behind(command), **how})
    if refused(probe, exchange):
        raise Inconclusive(f"{command.name} was refused")
    return exchange


# --- running and coming to rest ----------------------------------------------------------------------------------------


def run_at(probe: Probe, rpm: float, acceleration: int = QUICK) -> Exchange:
    """Begin a run at a speed. Raises Inconclusive where the drive refuses or does not answer."""
    command = probe.command(Verb.RUN_SPEED)
    return probe.do(command, declared.values_of(probe.dialect, command, rpm=rpm, acceleration=acceleration))


def stop(probe: Probe, acceleration: int = QUICK) -> Exchange:
    """Ask for a stop by a ramp (0: at once) that keeps the torque, and return what came at first. Judges nothing."""
    for verb in (Verb.STOP_SPEED, Verb.STOP):
        if verb in probe.dialect.by_verb:
            command = probe.command(verb)
            named = command.request_forms[0].layout.named
            values = {"acceleration": acceleration} if "acceleration" in named else None
            return probe.ask(command, values, quiet_ns=probe.quiet_behind(command))
    raise Inconclusive(f"{probe.dialect.name} has no stop")


def wait_standing(probe: Probe, *, limit_ns: int = _REST_NS, stopped: bool = False) -> Sample:
    """Wait until the speed reads 0 and the position stays; return where that is.

    Raises Inconclusive where that does not come within `limit_ns`, or where a shaft that was `stopped` goes on as fast.
    """
    begun_ns = probe.gate.now_ns()
    until_ns, no_ramp_ns = begun_ns + limit_ns, begun_ns + NO_RAMP_NS
    before, rpm, first = position(probe), 0.0, 0.0
    # The look at the speed is a part of the time between two at the position; what is told unasked comes in the other part.
    least_ns = (_LOOK_NS if probe.noise.live else QUIET_LOOK_NS) - min(_SPEED_NS, probe.gate.now_ns() - begun_ns)
    while True:
        # A fast shaft takes as long as its ramp, which may be steep: there is little to see before.
        probe.wait(max(least_ns, min(int(rpm * ramp.step_ns(QUICK)), _FAST_LOOK_NS, limit_ns)))
        rpm, now = abs(speed(probe).value), position(probe)
        if abs(now.value - before.value) <= same(probe) and rpm < 1 + probe.noise.rpm:
            probe.rig.stands_at(now.value)
            return now
        first = first or rpm
        if stopped and rpm >= max(1.0, AS_FAST * first) and probe.gate.now_ns() > no_ramp_ns:
            raise Inconclusive(f"the shaft goes on at {rpm:g} rpm after it was told to stop")
        if probe.gate.now_ns() >= until_ns:
            raise Inconclusive(f"the shaft does not come to rest within {limit_ns / 1e9:.0f} s")
        before = now


def stand_still(probe: Probe, *, limit_ns: int = _REST_NS) -> Sample:
    """Stop by a ramp, keeping the torque, and wait until the shaft stands; return where that is.

    Raises Inconclusive where it does not come to rest.
    """
    stop(probe)
    return wait_standing(probe, limit_ns=limit_ns, stopped=True)
