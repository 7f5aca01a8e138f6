"""The state of a drive that a gate needs to bound motion, read from the drive itself.

It is the shaft's position (for absolute moves) and the subdivision (for speeds and pulses). Native MKS cannot read the
subdivision: there the user gives it.
"""

from __future__ import annotations

from analyzer.catalogue import Dialect, Verb
from analyzer.codec import codec
from analyzer.encoder import assemble
from analyzer.errors import UsageError
from analyzer.layout import Effect
from conformance.gate.bounds import DEGREES
from conformance.talk.dialogue import MS, Dialogue

_TIMEOUT_NS = 1000 * MS


def read_drive_state(dialogue: Dialogue, dialect: Dialect, address: int) -> None:
    """Read what the bounds of a dialogue's gate need, and note it there. What the drive does not answer stays unknown."""
    gate = dialogue.gate
    bounds = gate.allowance.bounds
    if not dialect.addresses[0] <= address <= dialect.addresses[1]:
        return
    if bounds.turns is not None:
        position = _read(dialogue, dialect, address, Verb.READ_POSITION, "position")
        pulses = _read(dialogue, dialect, address, Verb.READ_PULSES, "pulses")
        if position is not None:
            command = dialect.by_verb[Verb.READ_POSITION]
            field = command.reply_forms[0].layout.named["position"]
            counts = field.unit == "counts"
            degrees = position * DEGREES / dialect.counts_per_turn if counts else float(field.physical(position))
            gate.note_position(degrees, address, pulses)
    wanted = bounds.turns is not None or bounds.speed is not None
    found = dialect.effect(Effect.SUBDIVISION)
    if wanted and gate.allowance.subdivision is None and found is not None:
        setting, subdivided = found
        if setting.readable and Verb.READ_PARAMETER in dialect.by_verb:
            subdivision = _read(dialogue, dialect, address, Verb.READ_PARAMETER, subdivided.name, parameter=setting.code)
            if subdivision is not None:
                gate.note_subdivision(subdivision, address)


def _read(dialogue: Dialogue, dialect: Dialect, address: int, verb: Verb, name: str, **values: int) -> int | None:
    """Return a field of the reply to a read as sent, None where there is none."""
    command = dialect.by_verb.get(verb)
    if command is None:
        return None
    try:
        item = assemble(dialect, command, address, values).item()
    except UsageError:
        return None
    for reply in dialogue.ask(item, _TIMEOUT_NS).replies:
        message = reply.message
        if message.form is not None and message.frame.checksum_ok and name in message.form.layout.named:
            value = codec(message.form.layout).wire(message.data)[name]
            return value if isinstance(value, int) else None
    return None
