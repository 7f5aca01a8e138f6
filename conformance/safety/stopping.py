"""Stopping a motor with proof: a stop by a ramp that keeps the torque, and reads that show the shaft standing.

The proof: three times in a row the speed reads 0 and the position is that of the first look. If the ramped stops fail, the
immediate stop is tried (it keeps the torque too), then a run by speed 0. A motor is never disabled, for its load could fall. If
nothing helps, the user's command to cut the power is run, and the run says NOT STOPPED.

Others may send on the line at the same time, and a stop or a reply that they run into is lost. So a stop is sent once more
after each look that shows nothing, and each second while the shaft turns on. A look that shows nothing refutes no other look.

The proof has limits. After a claim, a creep below 0.1 rpm passes as standing (two counts of the encoder in a tenth of a
second). At the end of a run, and for a trembling shaft, the mean position is watched for longer. There a creep below 0.03 rpm
(0.15 degrees in a second) passes. Speeds are read in whole rpm, so they show neither.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from statistics import mean
from typing import NamedTuple

from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Role
from analyzer.dialects import drive_name
from analyzer.encoder import assemble
from analyzer.errors import ServotapError, UsageError
from analyzer.values import counted
from conformance.bus.line import Line, LineLost
from conformance.claim import Inconclusive, NotStopped
from conformance.gate.gate import Gate, Refused
from conformance.gate.permissions import Allowance
from conformance.motion import motion
from conformance.motion.declared import GENTLE, SAME
from conformance.talk.exchange import Exchange
from conformance.talk.noise import QUIET, Noise
from conformance.talk.probe import Probe, plain_probe

#: What may set a shaft in motion: an unknown code may be anything.
MAY_MOVE = frozenset({Risk.MOTION, Risk.UNBOUNDED, Risk.UNKNOWN, Risk.POWER_ON})
#: How often in a row the shaft must be seen standing.
PROOFS = 3
_LOOK_NS = 100_000_000
#: Between two looks of a proof: a shaft that turns by 1 rpm goes ten counts in it.
_PROOF_NS = 40_000_000
#: A shaft that trembles stands where it stays within so many degrees for so long, and its mean place stays too.
_SPOT_DEGREES, _SPOT_NS, _TREMBLE_RPM = 0.3, 600_000_000, 3.0
#: How long a ramp may take, and how long a stop at once.
_RAMP_NS = 15_000_000_000
_AT_ONCE_NS = 3_000_000_000
_POWER_SECONDS = 20
#: How often a stop is sent to a shaft that turns on.
_AGAIN_NS = 1_000_000_000
#: How long a reply is waited for on a line where others send: it is lost more often than late.
_BUSY_NS = 150_000_000
#: How many of the last exchanges tell whether others are sending now.
_RECENT = 8
#: Bytes that others send in a second where their traffic is worth a word; so many times what the line brings come from no line.
_FLOOD, _NO_LINE = 50, 2
#: Between stops whose replies are not looked at: a stop and its reply have so many bytes, and a drive takes so long.
_STOP_BYTES, _STOP_GAP_NS = 30, 4_000_000


class GuardLost(LineLost):
    """The process that owns the port has gone, the port itself perhaps not: another one may stop the motor."""


def stopping(address: int) -> Allowance:
    """Return the allowance of a stop; it needs no permission of the user."""
    return Allowance(frozenset({Risk.READ, Risk.MOTION}), addresses=frozenset({address}))


class Stopped(NamedTuple):
    """How a drive was stopped, in words. `failure`: why there is no proof that it stands, or nothing."""

    way: str
    failure: str


def stop(
    gate: Gate,
    dialect: Dialect,
    address: int,
    stands_at: float | None = None,
    noise: Noise = QUIET,
    *,
    thoroughly: bool = False,
    told_ns: int | None = None,
) -> Stopped:
    """Stop a drive, by a ramp if that works, and prove that it stands. Raises LineLost.

    `stands_at`: where it was seen standing, if nothing was sent since then that may move it: one stop and one look are enough
    if it still stands there. `noise`: of a shaft at rest. `thoroughly`: as `prove_standing` takes it.
    `told_ns`: when it was told to stop by a ramp already, which then counts from there.

    Where one way of stopping fails, the next is tried until none is left. The address of all drives: they are told to stop, and
    none can be asked whether it does. A line that goes meanwhile is tried once more: its port may be back (`bus.lasting`).
    """
    try:
        return _stop(gate, dialect, address, stands_at, noise, thoroughly, told_ns)
    except GuardLost:
        raise
    except LineLost:
        return _stop(gate, dialect, address, None, noise, thoroughly, None)


def _stop(
    gate: Gate, dialect: Dialect, address: int, stands_at: float | None, noise: Noise, thoroughly: bool, told_ns: int | None
) -> Stopped:
    if address == dialect.broadcast:
        return _stop_all(gate, dialect, address)
    probe = plain_probe(dialect, address, gate)
    probe.noise = noise
    failure = ""
    ramped = ramped_stops(dialect)
    at_once = tuple(c for c in dialect.motions(MotionKind.STOP) if c not in ramped)
    if stands_at is not None and ramped and not ask(probe, ramped[0]) and not prove_standing(probe, _LOOK_NS, stands_at):
        return Stopped("by a ramp", "")
    ramp_ns = _RAMP_NS if told_ns is None else max(_AT_ONCE_NS, told_ns + _RAMP_NS - gate.now_ns())
    ways = (("by a ramp", ramped, ramp_ns), ("at once", at_once, _AT_ONCE_NS), ("by speed 0", _runs(dialect), _AT_ONCE_NS))
    for way, sent, limit_ns in ways:
        refused = [text for command in sent if (text := ask(probe, command))]
        if sent:
            failure = prove_standing(probe, limit_ns, thoroughly=thoroughly, again=sent)
            if not failure:
                return Stopped(way, "")
            failure = "; ".join([failure, *refused])
    failure = failure or f"{dialect.name} has no stop"
    return Stopped("", "; ".join([failure, *others_send(probe.traffic, gate.line)]))


def _stop_all(gate: Gate, dialect: Dialect, address: int) -> Stopped:
    refused = tell(gate, dialect, address)
    return Stopped("", refused or "a stop was sent to all; whether they stand cannot be asked of all")


def tell(gate: Gate, dialect: Dialect, address: int, *, at_once: bool = False) -> str:
    """Send every stop of a dialect to an address, and wait for nothing; return why one could not be sent, or nothing.

    `at_once`: those that take no ramp, too. Raises LineLost.
    """
    everyone = address == dialect.broadcast
    own = gate.under(replace(stopping(address), alone=True) if everyone else stopping(address))
    refused = ""
    for command in dialect.motions(MotionKind.STOP) if at_once else ramped_stops(dialect):
        try:
            own.send(assemble(dialect, command, address, _gentle(command)).item())
        except (Refused, UsageError, Inconclusive) as error:
            refused = f"{command.name}: {error}"
        # The next stop waits until the reply to this one has gone by.
        own.wait(_STOP_BYTES * own.line.byte_ns + _STOP_GAP_NS)
    return refused


def others_send(traffic: Sequence[Exchange], line: Line) -> list[str]:
    """Return in words how much came in these exchanges that answers nothing; nothing where it is little."""
    frames = [m.frame for e in traffic for m in (*(a.message for a in e.others), *e.foreign)]
    count = sum(len(frame.data) for frame in frames) + sum(e.passed + sum(len(j.data) for j in e.junk) for e in traffic)
    return [*flood(count, sum(e.until_ns - e.sent_ns for e in traffic), line), *_moved_by_others(traffic)]


def _moved_by_others(traffic: Sequence[Exchange]) -> list[str]:
    """Return in words which frames of others in these exchanges set a shaft in motion."""
    orders = [
        answer
        for exchange in traffic
        for answer in exchange.others
        if answer.message.role is Role.REQUEST and answer.message.frame.checksum_ok and answer.command is not None
        and answer.command.motion is not None and answer.command.motion.kind is not MotionKind.STOP
    ]  # fmt: skip
    if not orders:
        return []
    last = orders[-1]
    assert last.command is not None  # chosen by it
    what = f"{counted(len(orders), 'frame')}, the last {last.command.name}: {last.data.hex(' ').upper()}"
    return [f"others tell address {last.message.address} to move: {what}"]


def flood(count: int, duration_ns: int, line: Line) -> list[str]:
    """Return in words that others send, if it is so many bytes in such a time that they hide what is asked and answered."""
    rate = count * 1e9 / max(1, duration_ns)
    if rate < _FLOOD:
        return []
    is_no_line = not line.is_can and rate >= _NO_LINE * line.brings
    brings = f", and a line of {line.endpoint.bits_per_second} bit/s brings {line.brings}" * is_no_line
    return [f"others send on this bus ({rate:.0f} bytes a second{brings}), and what runs into theirs is lost"]


def _gentle(command: Command) -> dict[str, int]:
    """Return what makes a command a stop: no speed, and a gentle ramp."""
    return {
        name: value for name, value in (("acceleration", GENTLE), ("speed", 0)) if name in command.request_forms[0].layout.named
    }


def _runs(dialect: Dialect) -> tuple[Command, ...]:
    """Return the runs that speed 0 makes a stop and that are no stop of their own."""
    stops = {command.code for command in dialect.motions(MotionKind.STOP)}
    return tuple(command for command in dialect.motions(MotionKind.RUN) if command.code not in stops)


def ramped_stops(dialect: Dialect) -> tuple[Command, ...]:
    """Return the stops that take an acceleration; all stops of a dialect where none does."""
    stops = dialect.motions(MotionKind.STOP)
    return tuple(c for c in stops if c.motion is not None and c.motion.acceleration) or stops


def ask(probe: Probe, command: Command) -> str:
    """Send a stop; return why it could not be sent, or nothing. Raises LineLost."""
    try:
        # Whether it is answered says nothing about the shaft: that is looked at.
        probe.ask(command, _gentle(command), timeout_ns=_LOOK_NS, quiet_ns=0)
    # The guard tells by Inconclusive that it has stopped the motor itself.
    except (Refused, UsageError, Inconclusive) as error:
        return f"{command.name}: {error}"
    return ""


def prove_standing(
    probe: Probe, limit_ns: int, stands_at: float | None = None, *, thoroughly: bool = False, again: Sequence[Command] = ()
) -> str:
    """Return nothing once the shaft is proved to stand; else what was seen last.

    Three looks in a row are a proof: each reads speed 0 and, noise aside, the position of the first. A shaft that trembles by
    more than the probe's noise is watched longer, until its mean position would show a creep; with `thoroughly` every shaft
    is. `stands_at`: the position of an earlier standstill; then one look that shows it is enough. `again`: the stops that are
    sent once more where nothing is seen, or no effect of them. Raises LineLost.
    """
    begun_ns = probe.gate.now_ns()
    until_ns = begun_ns + limit_ns
    within = SAME + min(_SPOT_DEGREES, 2 * probe.noise.degrees)
    slowest = 1 + min(_TREMBLE_RPM, probe.noise.rpm)
    first, failure = 0.0, "nothing was read"
    asked_ns, patience_ns = begun_ns, _patience_ns(probe)
    row = [] if stands_at is None else [stands_at] * (PROOFS - 1)
    spot: list[tuple[int, float]] = []
    while (now_ns := probe.gate.now_ns()) < until_ns:
        try:
            speed = motion.speed(probe, patience_ns).value
            position = motion.position(probe, patience_ns).value
        except (Inconclusive, Refused) as error:
            failure = str(error)
            patience_ns = _patience_ns(probe)
            for command in again:
                ask(probe, command)
            asked_ns = probe.gate.now_ns()
            # Where others send, unread frames would be taken for the next answer.
            (probe.wait if patience_ns is None else probe.pass_over)(_LOOK_NS)
            continue
        before = row[-1:]
        if abs(speed) >= slowest:
            row = []
        else:
            row = [*row, position] if row and abs(position - row[0]) <= within else [position]
        spot.append((now_ns, position))
        while len(spot) > PROOFS + 1 and now_ns - spot[1][0] >= _SPOT_NS:
            spot.pop(0)
        places = [place for _, place in spot]
        if max(places) - min(places) > _SPOT_DEGREES or abs(speed) > _TREMBLE_RPM:
            spot = []
        if (len(row) >= PROOFS and not thoroughly) or _stays(spot):
            return ""
        failure = f"speed {speed:.4g} rpm, position {position:.4f} deg" + "".join(f" after {b:.4f} deg" for b in before)
        first = first or abs(speed)
        if abs(speed) >= max(1.0, motion.AS_FAST * first) and probe.gate.now_ns() > begun_ns + motion.NO_RAMP_NS:
            return failure
        if row == [] and now_ns - asked_ns >= _AGAIN_NS:
            asked_ns = now_ns
            for command in again:
                ask(probe, command)
        probe.wait(now_ns + _PROOF_NS - probe.gate.now_ns())
    return failure


def _patience_ns(probe: Probe) -> int | None:
    return _BUSY_NS if others_send(probe.traffic[-_RECENT:], probe.gate.line) else None


def _stays(spot: Sequence[tuple[int, float]]) -> bool:
    """Say whether the mean position of both halves is the same, over a long enough time."""
    if len(spot) <= PROOFS or spot[-1][0] - spot[0][0] < _SPOT_NS:
        return False
    places, half = [place for _, place in spot], len(spot) // 2
    return abs(mean(places[:half]) - mean(places[-half:])) <= SAME


def standing_failure(gate: Gate, dialect: Dialect, address: int) -> str:
    """Look whether a drive stands already, without sending it anything but reads; return why not, or nothing."""
    try:
        return prove_standing(plain_probe(dialect, address, gate.under(stopping(address))), 8 * _LOOK_NS)
    # What cannot be looked at is not seen standing.
    except Exception as error:
        return str(error) or type(error).__name__


def cut_power(command: str) -> str:
    """Run the user's command that cuts the power; return how that went, in words."""
    if not command:
        return "no --cut-power command was given"
    try:
        done = subprocess.run(command, shell=True, timeout=_POWER_SECONDS, capture_output=True, text=True, check=False)
    except subprocess.TimeoutExpired:
        return f"--cut-power {command!r} did not end within {_POWER_SECONDS} s"
    if done.returncode:
        return f"--cut-power {command!r} failed with {done.returncode}: {done.stderr.strip() or done.stdout.strip()}"
    return f"--cut-power {command!r} was run"


def not_stopped(dialect: Dialect, address: int, failure: str, power: str) -> NotStopped:
    """Run the user's command that cuts the power, say that a drive may turn on, and return the error that tells it."""
    text = f"NOT STOPPED: {drive_name(dialect, address)}: {failure}; {cut_power(power)}"
    print(text, file=sys.stderr, flush=True)
    return NotStopped(text)


def stop_or_cut(
    gate: Gate,
    dialect: Dialect,
    address: int,
    power: str,
    stands_at: float | None = None,
    noise: Noise = QUIET,
    *,
    thoroughly: bool = False,
) -> None:
    """Stop a drive by a gate of its own, through which nothing but that passes.

    `stands_at`, `noise`, `thoroughly`: as `stop` takes them.
    Raises NotStopped, after the power command, where there is no proof that the motor stands; GuardLost.
    """
    try:
        own = gate.under(stopping(address))
        failure = stop(own, dialect, address, stands_at, noise, thoroughly=thoroughly).failure
    except (NotStopped, GuardLost):
        raise
    except ServotapError as error:
        failure = str(error)
    # Any error here means that the stop was not sent or not proved: the motor may turn.
    except Exception as error:
        failure = f"{type(error).__name__}: {error}"
    if failure:
        raise not_stopped(dialect, address, failure, power)
