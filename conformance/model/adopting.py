"""What the twin of a walk (`model.walk`) takes over from the drive, because the manual leaves it open.

    settings(pair)                   what the drive holds at the begin        own(pair, ...)      what it tells by itself
    place(pair, anywhere=True)       where a shaft is that was stopped, let go or held
    encoder(pair)                    how the encoder counts beside the position
    enabled(pair)                    whether another mode or a restart enables the motor
    pulses(pair, degrees)            parts of a pulse behind another subdivision

Rules kept here:
- Where the shaft turned it may be anywhere. Where it was only let go or held it is nearly where it was, else it refutes.
- What differs at the very begin is the drive's own: no request of the walk has set it.
"""

from __future__ import annotations

from typing import Any

from analyzer.catalogue import Command, Verb
from conformance.model.comparing import degrees_of
from conformance.model.pair import Pair
from conformance.model.steps import selectors
from conformance.talk.exchange import Answer

#: A shaft that is let go or held may settle by so many degrees.
_LETS_GO = 2.0
#: What tells the place of an LK shaft within the turn and over all turns.
ENCODER = (Verb.READ_ENCODER, Verb.READ_SINGLE_TURN, Verb.READ_POSITION)


def settings(pair: Pair) -> None:
    """Make the twin hold what the drive holds, as far as it tells."""
    held: dict[str, int] = {}
    for number in selectors(pair.dialect):
        answer = pair.probe.ask(Verb.READ_PARAMETER, {"parameter": number}, quiet_ns=0).reply
        if answer is None:
            # Other claims judge it.
            pair.missing = {Verb.READ_PARAMETER, Verb.WRITE_PARAMETER}
            break
        held |= {n: v for n, v in answer.values.items() if n != "parameter"}
    pair.twin.change(lambda drive: drive.hold(held))
    encoder(pair)


def encoder(pair: Pair) -> None:
    """Let the encoder of the twin differ from its position by what that of the drive does."""
    if Verb.READ_ENCODER in pair.dialect.by_verb:
        told: dict[str, int] = {}
        for read in ENCODER:
            told |= pair.probe.reply(pair.probe.ask(read, quiet_ns=0)).values
        _stand(pair, told)


def own(pair: Pair, *commands: Command) -> None:
    """Take what these reads tell otherwise than the twin as the drive's own from now on."""
    for command in commands:
        answer, told = pair.ask(command)
        if answer is not None and told is not None:
            pair.comparing.own |= {(command.name, name) for name in pair.different(command, answer, told)}


def place(pair: Pair, *, anywhere: bool) -> None:
    """Let the shaft of the twin be where that of the drive is. Raises Refuted where it cannot be there."""
    for verb in (Verb.READ_POSITION, Verb.READ_PULSES):
        command = pair.dialect.by_verb.get(verb)
        if command is None:
            continue
        answer, told = pair.ask(command)
        if answer is None or told is None:
            return
        if not anywhere and (away := pair.different(command, answer, told, _LETS_GO)):
            if pair.explained(command, answer, away):
                continue
            pair.refute_read(command, answer, told, away)
        if verb is Verb.READ_PULSES and _pulses_agree(pair, answer, command):
            continue
        _stand(pair, dict(answer.values))
    pair.course.loose = False


def enabled(pair: Pair) -> None:
    """Let the motor of the twin be enabled if that of the drive is."""
    read = pair.dialect.by_verb.get(Verb.READ_ENABLED)
    if read is not None:
        _stand(pair, {"enabled": pair.probe.read(read)})


def pulses(pair: Pair, before: float) -> None:
    """Let the twin count pulses as the drive does: what either was off counts anew. `before`: degrees of a pulse."""
    command = pair.dialect.by_verb.get(Verb.READ_PULSES)
    if command is None or pair.twin.turning:
        return
    answer, told = pair.ask(command)
    if answer is None or told is None or answer.values == told.values:
        return
    away = abs(answer.values["pulses"] - told.values["pulses"])
    if away > pair.probe.within("degrees") / before + 1:
        pair.refute_read(command, answer, told, ["pulses"])
    _stand(pair, {"pulses": answer.values["pulses"]})
    pair.comparing.pulse_degrees = _degrees_of_pulse(pair, command)


def _pulses_agree(pair: Pair, answer: Answer, command: Command) -> bool:
    """Say whether the twin counts pulses as the drive does; it knows parts of a pulse, which stay then."""
    drive: Any = pair.twin.drive
    degrees = _degrees_of_pulse(pair, command)
    if abs(answer.values["pulses"] - drive.pulses) * degrees <= pair.probe.within("degrees") + degrees:
        return True
    pair.comparing.pulse_degrees = degrees
    return False


def _degrees_of_pulse(pair: Pair, command: Command) -> float:
    return degrees_of(pair.twin.drive, command.reply_forms[0].layout.named["pulses"])


def _stand(pair: Pair, values: dict[str, int]) -> None:
    pair.twin.change(lambda drive: drive.stand(values))
