"""Plain requests as a claim sends them to the drive under test: values, what must be done before, what after.

    exchange = plain_exchange(probe, command)

Values are those of `conformance.talk.samples`. Two of them are read from the drive: a move to a place goes to the shaft's
present place, and a change of the line's speed keeps the present speed.

Rules kept here:
- A command that needs a bus mode or a motor that is on gets it first; what turned stands still afterwards.
- A command that restarts the drive is waited for.
- What cannot be made ready, or read, does not stop a claim that is about the exchange alone.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from analyzer import layout
from analyzer.catalogue import Command, Dialect, Form, Risk, Role, Verb
from analyzer.encoder import Built
from conformance.claim import Inconclusive
from conformance.model.limits import with_bits
from conformance.motion import arriving, declared, motion
from conformance.talk import samples
from conformance.talk.exchange import Completion, Exchange
from conformance.talk.probe import MS, Until
from conformance.talk.restarts import wait_for_answer

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: Moves to a place, and the read that tells where in its own unit the shaft is: verb -> (read, field, field of the move).
_PLACES: Mapping[Verb, tuple[Verb, str, str]] = {
    Verb.MOVE_ABSOLUTE_PULSES: (Verb.READ_PULSES, "pulses", "position"),
    Verb.MOVE_ABSOLUTE_AXIS: (Verb.READ_POSITION, "position", "position"),
    Verb.MOVE_SINGLE_TURN: (Verb.READ_SINGLE_TURN, "angle", "angle"),
}
#: Commands that turn a motor which no bus command can be refused for: they need no preparation and leave it turning.
_TURNING = frozenset({Verb.HOME, Verb.CALIBRATE})


def needs_motion(command: Command) -> bool:
    """Say whether a command needs a drive that is ready to move."""
    return bool(command.modes) or (command.moves and command.verb in (*_MOVING, *_TURNING))


_MOVING = frozenset(
    {
        Verb.RUN_SPEED, Verb.RUN_TORQUE, Verb.RUN_OPEN_LOOP, Verb.MOVE_RELATIVE_PULSES, Verb.MOVE_ABSOLUTE_PULSES,
        Verb.MOVE_RELATIVE_AXIS, Verb.MOVE_ABSOLUTE_AXIS, Verb.MOVE_SINGLE_TURN,
    }
)  # fmt: skip


def is_motion(command: Command) -> bool:
    """Say whether a command sets the shaft in motion."""
    return command.verb in _MOVING or command.verb in _TURNING


def values_for(probe: Probe, command: Command) -> dict[str, Any]:
    """Return plain values of a request to this drive; those of any drive where this one cannot be asked."""
    values = samples.sample(probe.dialect, command, address=probe.address)
    place = _PLACES.get(command.verb)
    if place is not None and place[0] in probe.dialect.by_verb:
        with contextlib.suppress(Inconclusive):
            values[place[2]] = _within(command, place[2], probe.read(place[0], place[1]))
    if (name := command.sets(layout.Effect.BAUD_RATE)) in values:
        values[name] = _line_speed(probe, values[name])
    if (name := command.sets(layout.Effect.DIALECT)) in values:
        values[name] = probe.dialect.chosen_by
    return values


def _within(command: Command, name: str, value: int) -> int:
    field = command.request_forms[0].layout.named[name]
    return min(max(value, field.low), field.high)


def _line_speed(probe: Probe, otherwise: int) -> int:
    """Return the value of a speed setting that leaves the line at the speed that it has."""
    rates = {rate: code for code, rate in probe.dialect.rates.items()}
    speed = probe.gate.line.endpoint.speed
    return rates.get(speed, otherwise) if speed is not None else otherwise


def plain_exchange(probe: Probe, command: Command) -> Exchange:
    """Ask for a command plainly, made ready before and put to rest after it; return what came back."""
    if command.verb in _TURNING:
        # It begins in every work mode, and in some of them no stop is taken.
        motion.ready_to_move(probe)
    elif needs_motion(command):
        # A drive that cannot be made ready refuses: that has the shape of a reply too.
        with contextlib.suppress(Inconclusive):
            motion.ready_to_move(probe)
    exchange = probe.ask(command, values_for(probe, command))
    with contextlib.suppress(Inconclusive):
        put_to_rest(probe, command)
    return exchange


def put_to_rest(probe: Probe, command: Command) -> None:
    """Bring the drive to rest behind a command: stop what turns, wait for what restarts.

    Raises Inconclusive where it does not come to rest.
    """
    after = _AFTER.get(command.verb)
    if after is not None:
        after(probe)
    elif is_motion(command):
        _rest(probe)


def _rest(probe: Probe) -> None:
    """Stop by a ramp. The end of the stop is told by a reply of its own, which a read at once would run into."""
    stopped = motion.stop(probe)
    if arriving.tells_end(probe.dialect) and stopped.completion is Completion.RUNNING:
        probe.listen(200 * MS, Until.REPLY)
    motion.wait_standing(probe)


def _end_homing(probe: Probe) -> None:
    if Verb.EMERGENCY_STOP in probe.dialect.by_verb:
        probe.ask(Verb.EMERGENCY_STOP)


def _wait_for_calibration(probe: Probe) -> None:
    probe.wait(probe.rig.done_ns)


_AFTER: Mapping[Verb, Callable[[Probe], None]] = {
    Verb.RESTART: wait_for_answer,
    Verb.RESTORE: wait_for_answer,
    Verb.HOME: _end_homing,
    Verb.CALIBRATE: _wait_for_calibration,
}


def with_reserved(probe: Probe, command: Command, form: Form, values: Mapping[str, Any], mask: int) -> Built:
    """Return a request with reserved bits set beside its values."""
    data = with_bits(form.layout, values, mask)
    frame = probe.dialect.link.build(command, form, probe.address, data, Role.REQUEST)
    return replace(probe.build(command, values, form=form), frame=frame, risks=command.risks(values), refusals=())


def demands(dialect: Dialect, command: Command) -> dict[str, Any]:
    """Return what a claim must declare that asks for a command plainly: its risks, settings and who may run it."""
    risks = set(command.risks(samples.sample(dialect, command))) if command.slots is None else set(command.all_risks)
    settings = [name for form in command.request_forms for name in form.layout.named] if Risk.SETTING in risks else []
    if needs_motion(command):
        risks |= declared.risks(dialect)
        settings += declared.settings(dialect)
    return {
        "risks": frozenset(risks) - {Risk.READ},
        "settings": tuple(dict.fromkeys(settings)),
        "alone": bool(risks & {Risk.LINK}),
        "by_name": Risk.DESTRUCTIVE in risks or command.verb is Verb.CALIBRATE,
    }
