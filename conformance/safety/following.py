"""Following a drive whose link was changed: it is found at any of the settings that were sent, and set back.

The link decides how a drive is reached: its address, the speed of the line, the dialect it speaks. The link at which a drive
answers is its setting, so it need not be read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Verb, all_fields
from analyzer.errors import UsageError
from analyzer.layout import Effect
from conformance.gate.gate import Gate
from conformance.safety.journal import values_text
from conformance.talk.probe import Probe, Rig, plain_probe
from conformance.talk.settings import LINK_EFFECTS

_READS = (Verb.READ_STATUS, Verb.READ_SPEED, Verb.READ_STATE_1, Verb.READ_STATE_2, Verb.READ_POSITION, Verb.READ_ENCODER)
#: A drive may take its time to change its link, and a restarting one to be there again.
_TRIES = 4
_PAUSE_NS = 300_000_000


def default_values(command: Command) -> list[dict[str, int]]:
    """Return the values that a setting of the link may have after a restore of the defaults; empty for other settings."""
    name = next((name for effect in LINK_EFFECTS if (name := command.sets(effect))), "")
    if not name:
        return []
    field = all_fields(command.request_forms)[name]
    return [{name: code} for code in (field.choice_names if field.default is None else [int(field.default)])]


def restore_link(
    gate: Gate,
    dialect: Dialect,
    address: int,
    command: Command,
    before: Mapping[str, int],
    sent: Iterable[Mapping[str, int]],
    *,
    write_gap_ns: int = Rig.write_gap_ns,
    quiet_ns: int = Rig.quiet_ns,
) -> str:
    """Find the drive at one of the settings that it may have, and set it back; return why not, or nothing.

    `write_gap_ns`: its distance from the setting before. `quiet_ns`: how long a second reply is listened for. The host's end of
    the line is set back too. Raises LineLost.
    """
    tried = [before, *reversed(list(sent))]
    own = gate.line.endpoint.bits_per_second
    failure = ""
    for values in tried:
        probe = _reach(gate, dialect, address, command, values)
        if probe is None:
            continue
        probe.rig.write_gap_ns = write_gap_ns
        probe.ask(probe.command(command.verb), before, quiet_ns=quiet_ns)
        if _reach(gate, dialect, address, command, before) is not None:
            return ""
        failure = f"{command.name}: the drive was set to {values_text(command, before)} and does not answer there"
    if gate.line.endpoint.bits_per_second != own:
        gate.set_speed(own)
    places = ", ".join(values_text(command, values) for values in tried)
    return failure or f"{command.name}: the drive no longer answers, neither at {places}"


def _reach(gate: Gate, dialect: Dialect, address: int, command: Command, values: Mapping[str, int]) -> Probe | None:
    """Return a probe that reaches a drive whose link has these values, None where no drive answers."""
    if name := command.sets(Effect.ADDRESS):
        address = values[name]
    elif name := command.sets(Effect.DIALECT):
        spoken = dialect.switched(values[name])
        dialect = dialect if dialect.name == spoken else dialects.get(spoken)
    else:
        speed = dialect.rates.get(values[command.sets(Effect.BAUD_RATE)])
        if speed is None:
            return None
        try:
            if speed != gate.line.endpoint.bits_per_second:
                gate.set_speed(speed)
        except UsageError:
            return None
    if not dialect.addresses[0] <= address <= dialect.addresses[1]:
        return None
    probe = plain_probe(dialect, address, gate)
    for _ in range(_TRIES):
        if answers(probe):
            return probe
        probe.wait(_PAUSE_NS)
    return None


def cannot_follow(gate: Gate, dialect: Dialect, command: Command, values: Mapping[str, int]) -> str:
    """Return why the host cannot follow a drive to new values, or nothing.

    A drive at a speed that the host cannot set could not be set back.
    """
    speed = dialect.rates.get(values.get(command.sets(Effect.BAUD_RATE), -1))
    own = gate.line.endpoint.bits_per_second
    if speed is None or speed == own:
        return ""
    try:
        gate.set_speed(speed)
        gate.set_speed(own)
    except UsageError as error:
        return f"the host cannot follow the drive to {speed} bits per second: {error}"
    return ""


def answers(probe: Probe) -> bool:
    """Say whether the drive answers a read."""
    verb = next(v for v in _READS if v in probe.dialect.by_verb)
    answer = probe.ask(verb, timeout_ns=_PAUSE_NS, quiet_ns=0).reply
    return answer is not None and answer.message.frame.checksum_ok
