"""Faults of what a drive knows of its place: zero, homing, end limits, and of the locked rotor."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from analyzer.catalogue import Verb
from analyzer.protocols import mks_shared
from conformance.drives.drive import Fault, Values
from conformance.drives.faults.mks_makers import (
    CAN,
    EVERY,
    NATIVE,
    SERIAL,
    Install,
    changed,
    heedless,
    instead,
    lying,
    tuned,
    unstored,
    wrapped,
)
from conformance.drives.mks.core import Behaviour, Kind, MksCore, Script, Task
from conformance.drives.mks.speaker import Order

_OK: Values = {"status": int(mks_shared.Success.SUCCESS)}


def _home_at_once(drive: MksCore, order: Order) -> Values:
    """Say that home was found where the shaft is."""
    drive.begin(Kind.HOME, _found(drive), order)
    return {"status": int(mks_shared.HomeStatus.STARTING)}


def _found(drive: MksCore) -> Script:
    now_ns = drive.now_ns
    yield lambda: now_ns
    drive.finish(mks_shared.HomeStatus.SUCCESS)


def _homing_by(change: Callable[[Mapping[str, int]], Mapping[str, int]]) -> Install:
    """Home by other settings than those that are stored."""

    def tune(drive: MksCore) -> None:
        drive.home_settings = lambda: {**drive.settings, **change(drive.settings)}

    return tuned(tune)


def _then(after: Callable[[MksCore], None]) -> Install:
    """Do something more when home is found."""

    def wrap(behaviour: Behaviour) -> Behaviour:
        def act(drive: MksCore, order: Order) -> Values | None:
            answer = behaviour(drive, order)
            task = drive.task
            if task is not None and task.order is order:
                drive.begin(Kind.HOME, _going_on(drive, task, after), order)
            return answer

        return act

    return wrapped({Verb.HOME}, wrap)


def _going_on(drive: MksCore, task: Task, after: Callable[[MksCore], None]) -> Script:
    yield task.wait
    yield from task.script
    after(drive)


def _lose_zero(drive: MksCore) -> None:
    drive.memory.zero += 500


def _zeroed(drive: MksCore, order: Order) -> Values:
    """Set the zero of the pulses alone."""
    drive.memory.pulse_zero = drive.motor.wanted(drive.now_ns)
    return dict(_OK)


def _hold(drive: MksCore) -> None:
    drive.memory.enabled = True
    drive.grip()


FAULTS: tuple[Fault, ...] = (
    # Zero
    Fault("set-zero-ignored", EVERY, "92 sets no zero", "zero", lying({Verb.SET_ZERO})),
    Fault("set-zero-pulses-only", EVERY, "92 sets the zero of the pulses alone", "zero", instead({Verb.SET_ZERO}, _zeroed)),
    Fault("zero-mode-ignored", SERIAL, "9A brings nothing back at power-on", "zero", unstored("zero_mode")),
    Fault("zero-direction-ignored", SERIAL, "the way back at power-on is always clockwise", "direction",
          unstored("zero_direction")),
    Fault("zero-status-frozen", SERIAL, "3B always says success", "frozen",
          changed(Verb.READ_ZERO_STATUS, "status", lambda s: 1)),
    # Limits
    Fault("end-limit-ignored", EVERY, "the end limit stops nothing", "limit", heedless("end_limit")),
    Fault("limit-remap-ignored", EVERY, "9E remaps nothing", "limit", unstored("limit_remap")),
    # Homing
    Fault("home-lies", EVERY, "91 says that home was found and turns nothing", "homing",
          instead({Verb.HOME}, _home_at_once)),
    Fault("home-sets-no-zero", EVERY, "home is found and not made zero", "homing", _then(_lose_zero)),
    Fault("home-wrong-way", EVERY, "homing goes the other way", "homing",
          _homing_by(lambda s: {"home_direction": 1 - s["home_direction"]})),
    Fault("home-speed-ignored", EVERY, "homing turns at 30 rpm always", "homing", _homing_by(lambda s: {"home_speed": 30})),
    # Modbus has no register for homing without a switch.
    Fault("home-return-ignored", (NATIVE, CAN), "without a switch homing stays at the obstacle", "homing",
          _homing_by(lambda s: {"return_angle": 0})),
    Fault("home-mode-ignored", (NATIVE, CAN), "homing always looks for a switch", "homing",
          _homing_by(lambda s: {"home_mode": 0})),
    Fault("home-trigger-not-stored", EVERY, "90 keeps the old level of the end stop", "homing", unstored("home_trigger")),
    Fault("home-keeps-the-shaft", SERIAL, "with the end limit on homing does not let the shaft go", "homing",
          _then(_hold)),
    # Locked rotor, calibration
    Fault("protection-ignored", EVERY, "a locked rotor is never let go", "protection", heedless("protection")),
    Fault("release-ignored", EVERY, "3D ends no protection", "protection", lying({Verb.RELEASE_PROTECTION})),
    Fault("stall-tolerance-ignored", (CAN,), "the stall tolerance is 180 degrees always", "protection",
          unstored("stall_tolerance")),
)  # fmt: skip
