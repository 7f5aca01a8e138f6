"""The keeper of a drive's settings: knows what each was before it was changed, and puts all of them back.

Before the first change of a setting its value is asked of the drive; where the drive does not tell, the user's word is
taken, and where there is none, it is not changed. What was is written into the journal first. A change of the link (address,
speed, dialect) is followed: the drive is looked for where it may be now.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Verb
from analyzer.errors import UsageError
from conformance.claim import NotRun
from conformance.drives.speed import SPEEDS
from conformance.gate import Gate
from conformance.gate_readings import Reading
from conformance.probe import Probe
from conformance.safety import settings
from conformance.safety.bare import bare_probe
from conformance.safety.journal import Entry, Journal, values_text

#: The dialect that a drive speaks after this one was switched.
OTHER_DIALECT = {"mks-rs485": "mks-modbus", "mks-modbus": "mks-rs485"}


@dataclass
class _Kept:
    """A command and the values that its settings had; `sent`: those that were sent since."""

    command: Command
    before: dict[str, int]
    sent: list[dict[str, int]] = field(default_factory=list)


class Keeper:
    """Keeps the settings of one drive. `known`: the user's word on them; `journal` None: nothing is written down."""

    def __init__(
        self,
        gate: Gate,
        dialect: Dialect,
        address: int,
        known: Mapping[str, int],
        journal: Journal | None,
        on: str = "",
    ) -> None:
        self._gate = gate
        self._dialect = dialect
        self._address = address
        self._known = known
        self._journal = journal
        self._on = on
        self._target = f"{dialect.name}@{address}" + (f",model={dialect.model}" if dialect.model else "")
        self._kept: dict[tuple[str, int], _Kept] = {}
        self._asking = False

    def why_not(self, names: tuple[str, ...]) -> str:
        """Return why settings (by field) cannot be changed here, or nothing."""
        for name in names:
            commands = [c for c in self._dialect.commands if settings.changes(c) and _has(c, name)]
            if commands and not any(self._can_keep(c) for c in commands):
                return f"the drive does not tell its {name}: say in --settings FILE what to put back"
        return ""

    def _can_keep(self, command: Command) -> bool:
        if settings.readable(self._dialect, command):
            return True
        names = {n for form in command.request_forms for n, f in form.layout.named.items() if f.fixed is None}
        return names <= self._known.keys() or _says_itself(command)

    def before(self, readings: tuple[Reading, ...]) -> None:
        """Make sure that what is about to leave can be put back.

        Raises NotRun where nobody says what to put back.
        """
        if self._asking:
            return
        for reading in readings:
            command = reading.command
            if command is not None and reading.sound and settings.changes(command) and reading.address == self._address:
                self._keep(command, dict(reading.values))

    def _keep(self, command: Command, values: dict[str, int]) -> None:
        key = (command.name, settings.selector(command, values))
        kept = self._kept.get(key)
        if kept is None:
            before = self._value(command, values)
            if before is None:
                raise NotRun(f"the drive does not tell what {command.name} sets: say in --settings FILE what to put back")
            kept = self._kept[key] = _Kept(command, before)
            if self._journal is not None:
                change = Entry(
                    event="change", target=self._target, on=self._on, command=command.name, address=self._address, values=before
                )
                self._journal.write(change)
        if values not in kept.sent:
            kept.sent.append(values)

    def _value(self, command: Command, values: Mapping[str, int]) -> dict[str, int] | None:
        self._asking = True
        try:
            if settings.readable(self._dialect, command):
                found = settings.read(self._probe(), command, values)
                if found is not None:
                    return found
        finally:
            self._asking = False
        if _says_itself(command):
            return self._link(command)
        names = {n for form in command.request_forms for n, f in form.layout.named.items() if f.fixed is None}
        return {n: self._known[n] for n in names} if names <= self._known.keys() else None

    def _link(self, command: Command) -> dict[str, int]:
        """Return what a setting of the link must be, since the drive is heard as it is."""
        if command.verb is Verb.SET_ADDRESS:
            return {"new_address": self._address}
        if command.verb is Verb.SET_MODBUS:
            return {"modbus": int(self._dialect.name == "mks-modbus")}
        name = next(n for n in SPEEDS if _has(command, n))
        speed = self._gate.line.endpoint.bits_per_second
        return {name: next(code for code, bits in SPEEDS[name].items() if bits == speed)}

    def _probe(self, address: int | None = None, dialect: Dialect | None = None) -> Probe:
        return bare_probe(dialect or self._dialect, address or self._address, self._gate, "put-back")

    # --- putting back -------------------------------------------------------------------------------------------------

    @property
    def changed(self) -> bool:
        """Whether something is to be put back."""
        return bool(self._kept)

    def put_back(self) -> str:
        """Put everything back, the last change first; return what could not be, or nothing."""
        failed = []
        self._asking = True
        try:
            # The link first: nothing else can be put back on a drive that is not heard.
            newest = list(self._kept.items())[::-1]
            newest.sort(key=lambda item: not _says_itself(item[1].command))
            for key, kept in newest:
                told = self._restore(kept)
                if told:
                    failed.append(told)
                    continue
                del self._kept[key]
                if self._journal is not None:
                    back = Entry(event="back", target=self._target, command=kept.command.name, address=self._address)
                    self._journal.write(back)
        finally:
            self._asking = False
        return "; ".join(failed)

    def _restore(self, kept: _Kept) -> str:
        command = kept.command
        if _says_itself(command):
            return self._restore_link(kept)
        return put_back(self._probe(), command, kept.before)

    def _restore_link(self, kept: _Kept) -> str:
        """Find the drive at what it may have been told, and tell it what it was."""
        command = kept.command
        for values in [kept.before, *reversed(kept.sent)]:
            probe = self._reach(command, values)
            if probe is None:
                continue
            told = put_back(probe, probe.command(command.verb), kept.before)
            self._reach(command, kept.before)
            if not told:
                return ""
        return f"{command.name}: the drive is not heard any more, at what it was nor at {[values_text(v) for v in kept.sent]}"

    def _reach(self, command: Command, values: Mapping[str, int]) -> Probe | None:
        """Return a probe that reaches a drive whose link is set so, None where nobody is there."""
        address, dialect = self._address, self._dialect
        if command.verb is Verb.SET_ADDRESS:
            address = values["new_address"]
        elif command.verb is Verb.SET_MODBUS:
            name = "mks-modbus" if values["modbus"] else "mks-rs485"
            dialect = dialect if dialect.name == name else dialects.get(name)
        else:
            name = next(n for n in SPEEDS if _has(command, n))
            speed = SPEEDS[name].get(values[name])
            if speed is None:
                return None
            try:
                self._gate.set_speed(speed)
            except UsageError:
                return None
        probe = self._probe(address, dialect)
        # A drive may take its time to change its link.
        for _ in range(3):
            if is_there(probe):
                return probe
            probe.wait(300_000_000)
        return None


def is_there(probe: Probe) -> bool:
    """Say whether the drive answers a read."""
    verbs = (Verb.READ_STATUS, Verb.READ_SPEED, Verb.READ_STATE_1, Verb.READ_STATE_2, Verb.READ_POSITION, Verb.READ_ENCODER)
    verb = next(v for v in verbs if v in probe.dialect.by_verb)
    return any(a.message.frame.checksum_ok for a in probe.ask(verb, timeout_ns=300_000_000, quiet_ns=0).answers)


def put_back(probe: Probe, command: Command, values: Mapping[str, int]) -> str:
    """Set a command's settings to values and look that they are; return why not, or nothing."""
    told = ""
    for _ in range(2):
        exchange = probe.ask(command, values)
        if exchange.reply is None:
            told = f"{command.name} {values_text(values)}: not answered"
            continue
        if probe.refused(exchange):
            return f"{command.name} {values_text(values)}: refused"
        if not settings.readable(probe.dialect, command):
            return ""
        now = settings.read(probe, command, values)
        if now is None or all(now.get(n) == v for n, v in values.items()):
            return ""
        told = f"{command.name}: put back {values_text(values)}, read {values_text(now)}"
    return told


def _has(command: Command, name: str) -> bool:
    return any(name in form.layout.named for form in command.request_forms)


def _says_itself(command: Command) -> bool:
    """Say whether the present value of a setting shows in how the drive is reached."""
    verbs = (Verb.SET_ADDRESS, Verb.SET_MODBUS, Verb.SET_BAUD_RATE, Verb.SET_BIT_RATE)
    return command.verb in verbs
