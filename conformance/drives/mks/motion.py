"""How an MKS drive moves: runs at a speed, four kinds of moves to a position, stops, enabling.

    FD  relative, in pulses     wanted position + pulses        F4  relative, in counts   wanted position + counts
    FE  absolute, in pulses     pulse 0 + pulses                F5  absolute, in counts   the encoder's 0 + counts

Rules kept here:
- A motion is refused while the motor is disabled, protected, without supply or calibrating. A stop is not: it has nothing
  to refuse, unless the motor calibrates.
- A newer motion begins with the speed that the shaft has: so mode 4 takes new targets and speeds on the way.
- A move is answered when it begins and when the shaft is there; in a closed loop a blocked shaft is not there. One at
  speed 0 is a stop. A stop is answered when it begins and when the shaft stands.
- Towards an end limit that is closed: a run at a speed is refused, a move begins and is stopped at once (status 3). A
  limit met on the way stops at once; a run at a speed has no reply that could tell.
- A locked rotor with its protection on ends a move as failed (0) and lets the shaft go.
- Emergency stop and disabling end what is under way without a completion.
- A run at a speed is kept for power-on by FF; without one nothing turns at power-on.

Decided, since nothing is printed: the direction of pulses is that of the direction bit, 0 raises their count.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from analyzer.catalogue import Verb
from analyzer.protocols import mks_shared as mks
from conformance.drives.drive import Values
from conformance.drives.mks.core import Behaviour, Kind, MksCore, Script
from conformance.drives.mks.paths import Number
from conformance.drives.mks.settings import put
from conformance.drives.mks.speaker import Order

_SUCCESS: Values = {"status": int(mks.Success.SUCCESS)}
_STARTING: Values = {"status": int(mks.RunStatus.STARTING)}


def _speed(drive: MksCore, order: Order) -> int:
    """Return the speed as sent, cut to what the work mode allows."""
    declared = order.command.request_forms[0].layout.named["speed"]
    speed: int = order.values["speed"]
    return min(speed, drive.highest_speed(declared.high))


def _way(direction: int) -> int:
    return 1 if direction == mks.MotionDirection.CCW else -1


def begin_run(drive: MksCore, direction: int, speed: int, acceleration: int) -> None:
    """Turn at a speed as sent."""
    drive.drop()
    rpm = _way(direction) * drive.bus_sense * drive.real_speed(speed)
    drive.motor.run(drive.now_ns, rpm, drive.ramp(acceleration))
    drive.memory.run = (direction, speed, acceleration) if speed else None


def _run(drive: MksCore, order: Order) -> Values:
    values, speed = order.values, _speed(drive, order)
    if not drive.ready or (speed and drive.at_limit(_way(values["direction"]) * drive.bus_sense)):
        return drive.refused(order)
    begin_run(drive, values["direction"], speed, values["acceleration"])
    return dict(_SUCCESS)


# --- moves to a position --------------------------------------------------------------------------------------------


def _by_pulses(drive: MksCore, order: Order) -> Number:
    pulses = _way(order.values["direction"]) * int(order.values["pulses"])
    return drive.motor.wanted(drive.now_ns) + pulses * drive.pulse_counts


def _to_pulse(drive: MksCore, order: Order) -> Number:
    return drive.memory.pulse_zero + int(order.values["position"]) * drive.pulse_counts


def _by_counts(drive: MksCore, order: Order) -> Number:
    return drive.motor.wanted(drive.now_ns) + int(order.values["position"])


def _to_count(drive: MksCore, order: Order) -> Number:
    # What the encoder shows is the shaft; an open loop may have lost steps since.
    lost = drive.motor.lost
    return drive.memory.zero + int(order.values["position"]) - lost


#: Where each kind of move ends, in counts of where the shaft is meant to be.
TARGETS: Mapping[Verb, Callable[[MksCore, Order], Number]] = {
    Verb.MOVE_RELATIVE_PULSES: _by_pulses,
    Verb.MOVE_ABSOLUTE_PULSES: _to_pulse,
    Verb.MOVE_RELATIVE_AXIS: _by_counts,
    Verb.MOVE_ABSOLUTE_AXIS: _to_count,
}


def _move(drive: MksCore, order: Order) -> Values:
    if not drive.ready:
        return drive.refused(order)
    rpm, step_ns = drive.real_speed(_speed(drive, order)), drive.ramp(order.values["acceleration"])
    target = TARGETS[order.command.verb](drive, order)
    drive.drop()
    drive.memory.run = None
    if rpm:
        drive.motor.move(drive.now_ns, target, rpm, step_ns)
        drive.begin(Kind.MOVE, _arriving(drive), order)
    else:
        drive.motor.run(drive.now_ns, 0, step_ns)
        drive.begin(Kind.MOVE, _standing(drive), order)
    return dict(_STARTING)


def _arriving(drive: MksCore) -> Script:
    def arrives() -> Number | None:
        settled = drive.motor.settled
        there = not drive.motor.closed_loop or drive.motor.error(max(settled, drive.now_ns)) == 0
        return settled if there else None

    yield arrives
    drive.finish(mks.RunStatus.COMPLETE)


# --- stops ----------------------------------------------------------------------------------------------------------


def _stop(drive: MksCore, order: Order) -> Values:
    if drive.doing(Kind.CALIBRATE):
        return drive.refused(order)
    drive.drop()
    drive.memory.run = None
    drive.motor.run(drive.now_ns, 0, drive.ramp(order.values["acceleration"]))
    drive.begin(Kind.STOP, _standing(drive), order)
    return dict(_STARTING)


def _standing(drive: MksCore) -> Script:
    yield lambda: drive.motor.settled
    drive.finish(mks.StopStatus.COMPLETE)


def _emergency_stop(drive: MksCore, order: Order) -> Values:
    drive.drop()
    drive.memory.run = None
    drive.motor.halt(drive.now_ns)
    return dict(_SUCCESS)


# --- enabling, keeping a run ----------------------------------------------------------------------------------------


def _enable(drive: MksCore, order: Order) -> Values:
    drive.memory.enabled = bool(order.values["enabled"])
    if not drive.memory.enabled:
        drive.drop()
        drive.memory.run = None
    drive.grip()
    return dict(_SUCCESS)


def _release_protection(drive: MksCore, order: Order) -> Values:
    drive.memory.protected = False
    drive.grip()
    return dict(_SUCCESS)


def _save(drive: MksCore, order: Order) -> Values:
    run = drive.memory.run if order.values["save_state"] == mks.SaveState.SAVE else None
    put(drive, "saved_run", int(run is not None))
    for name, value in zip(("saved_direction", "saved_speed", "saved_acceleration"), run or (0, 0, 0), strict=True):
        put(drive, name, value)
    return dict(_SUCCESS)


MOTION: Mapping[Verb, Behaviour] = {
    Verb.RUN_SPEED: _run,
    **dict.fromkeys(TARGETS, _move),
    Verb.STOP_SPEED: _stop,
    Verb.STOP_RELATIVE_PULSES: _stop,
    Verb.STOP_ABSOLUTE_PULSES: _stop,
    Verb.STOP_RELATIVE_AXIS: _stop,
    Verb.STOP_ABSOLUTE_AXIS: _stop,
    Verb.EMERGENCY_STOP: _emergency_stop,
    Verb.ENABLE: _enable,
    Verb.RELEASE_PROTECTION: _release_protection,
    Verb.SAVE_SPEED: _save,
}
