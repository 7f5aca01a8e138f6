"""The keeper of a drive's settings: knows the value of each before it was changed, and puts all of them back.

Before the first change of a setting the keeper reads its value from the drive. Where the drive has no such read it takes the
user's value, and without one the setting is not changed. The old value goes into the journal first. After a change of the
link (address, speed, dialect) the drive is followed (`conformance.safety.following`).

Rules kept here:
- A frame to all drives, in a package, or to an address that the drive may have taken counts as sent to the drive.
- Old values may be put back also where they are beyond the bounds and the budget of the run.
- A speed that is kept for the next power-on is forgotten again: a motor must not turn by itself because a suite has run.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Risk, Verb, all_fields
from analyzer.errors import UsageError
from analyzer.layout import Effect, Field
from analyzer.values import quote
from conformance.claim import NotRun
from conformance.gate.budget import Budget
from conformance.gate.gate import Gate, Refused
from conformance.gate.interpretations import Interpretation
from conformance.gate.permissions import Allowance
from conformance.motion import declared, motion
from conformance.safety import following, settings
from conformance.safety import journal as journals
from conformance.safety.journal import Entry, Journal, values_text
from conformance.talk.probe import Probe, Rig, plain_probe
from conformance.talk.settings import changes_link

#: What may be sent to put settings back: no motion, nothing that wipes, no unknown code.
PUTTING_BACK = Allowance(
    frozenset({Risk.READ, Risk.SETTING, Risk.TORQUE, Risk.LINK, Risk.POWER_ON, Risk.WEAR}), alone=True, budget=Budget(wear=None)
)


@dataclass
class _Kept:
    """A command and the values that its settings had; `sent`: those that were sent since, each once; `last`: the last of them.

    `failed`: why it was not put back, where that was tried.
    """

    command: Command
    before: dict[str, int]
    sent: list[dict[str, int]] = field(default_factory=list)
    last: dict[str, int] = field(default_factory=dict)
    failed: str = ""


def cannot_keep(dialect: Dialect, names: Iterable[str], known: Mapping[str, int]) -> str:
    """Return why settings (by field) of a drive cannot be changed, with what the user told of it, or nothing."""
    for name in names:
        commands = [c for c in dialect.commands if settings.changes(c) and name in all_fields(c.request_forms)]
        if commands and not any(_can_keep(dialect, c, known) for c in commands):
            return f"the drive does not tell its {name}: say in --settings FILE what to put back"
    return ""


def _can_keep(dialect: Dialect, command: Command, known: Mapping[str, int]) -> bool:
    if settings.readable(dialect, command) or command.verb is Verb.SAVE_SPEED:
        return True
    return _fields(command) <= known.keys() or changes_link(command)


class Keeper:
    """Keeps the settings of one drive.

    `known`: values that the user gave; `journal` None: nothing is written down. `alone`: no other drive is on the bus.
    `named`: its name in the journal, where it is another one than the dialect's. `write_gap_ns`: between settings.
    `quiet_ns`: how long a second reply is listened for.
    """

    write_gap_ns, quiet_ns = Rig.write_gap_ns, Rig.quiet_ns

    def __init__(
        self,
        gate: Gate,
        dialect: Dialect,
        address: int,
        known: Mapping[str, int],
        journal: Journal | None,
        on: str = "",
        *,
        alone: bool = False,
        named: str = "",
    ) -> None:
        self._gate = gate
        self._dialect = dialect
        self._address = address
        self._known = known
        self._journal = journal
        self._on = on
        self._alone = alone
        self._target = named or f"{dialect.name}@{address}" + (f",model={dialect.model}" if dialect.model else "")
        self._kept: dict[tuple[str, int], _Kept] = {}
        self._asking = False

    def use_gate(self, gate: Gate) -> None:
        """Use another gate from now on: the process behind the first one has gone."""
        self._gate = gate
        self._asking = False

    def cannot_keep(self, names: tuple[str, ...]) -> str:
        """Return why settings (by field) cannot be changed here, or nothing."""
        return cannot_keep(self._dialect, names, self._known)

    def _can_keep(self, command: Command) -> bool:
        return _can_keep(self._dialect, command, self._known)

    def keep_before(self, found: tuple[Interpretation, ...]) -> None:
        """Make sure that the changes of what is about to leave can be put back.

        Raises NotRun where an old value is not known.
        """
        if self._asking:
            return
        for asked in found:
            if asked.command is None or not asked.fits or not self._may_hear(asked):
                continue
            # In another dialect too, for a drive that was switched: its settings stay the same.
            command = self._dialect.by_name.get(asked.command.name)
            if command is None:
                continue
            if command.verb is Verb.RESTORE:
                self._keep_all()
            elif settings.changes(command) and asked.values and not asked.reads_only:
                self._keep(command, dict(asked.values))

    def _may_hear(self, asked: Interpretation) -> bool:
        """Say whether the drive may take a asked for its own; where it is alone a faulty one may take any."""
        return self._alone or asked.to_many or asked.address in (None, self._address)

    def _keep_all(self) -> None:
        """Keep all that can be, before the drive goes back to its defaults."""
        for command in self._dialect.commands:
            if not settings.changes(command) or not self._can_keep(command) or command.verb is Verb.SAVE_SPEED:
                continue
            # The defaults of the link, by which the drive is found again.
            for values in following.default_values(command) or settings.every_selector(command):
                self._keep(command, values)

    def _keep(self, command: Command, values: dict[str, int]) -> None:
        if command.verb is Verb.SAVE_SPEED and values == _forgotten(command):
            return
        refused = following.cannot_follow(self._gate, self._dialect, command, values)
        if refused:
            raise NotRun(refused)
        key = (command.name, settings.selector(command, values))
        kept = self._kept.get(key)
        if kept is None:
            before = self._value(command, values)
            if before is None:
                raise NotRun(f"the drive does not tell what {command.name} sets: say in --settings FILE what to put back")
            kept = _Kept(command, before)
        if values not in kept.sent or key not in self._kept:
            # Where a drive can be found again must be known; of other settings the first change says enough.
            if self._journal is not None and (key not in self._kept or changes_link(command)):
                self._journal.write(self._entry("change", command, kept.before, values))
            kept.sent.append(values)
        kept.last = values
        self._kept[key] = kept

    def _entry(self, event: journals.Event, command: Command, before: dict[str, int], *sent: dict[str, int]) -> Entry:
        # What was tells apart the settings of one command (LK's parameters).
        return Entry(
            event=event, target=self._target, on=self._on, command=command.name, address=self._address, values=before,
            sent=list(sent),
        )  # fmt: skip

    def _value(self, command: Command, values: Mapping[str, int]) -> dict[str, int] | None:
        if command.verb is Verb.SAVE_SPEED:
            return _forgotten(command)
        self._asking = True
        try:
            if settings.readable(self._dialect, command):
                found = settings.read(self._probe(), command, values)
                if found is not None:
                    return found | self._unset(command, found)
        finally:
            self._asking = False
        if changes_link(command):
            return self._link(command)
        names = _fields(command)
        return {n: self._known[n] for n in names} if names <= self._known.keys() else None

    def _unset(self, command: Command, found: Mapping[str, int]) -> dict[str, int]:
        """Return what the user says of fields that were never set: they read 0, which cannot be set (a drive in no group).

        Raises NotRun where the user does not say it.
        """
        fields = all_fields(command.request_forms)
        names = [n for n, v in found.items() if v == 0 and fields[n].default is None and not fields[n].allows(0)]
        for name in names:
            if name not in self._known:
                raise NotRun(f"the drive has no {name} yet, and 0 cannot be set: say in --settings FILE what to leave it at")
        return {name: self._known[name] for name in names}

    def _link(self, command: Command) -> dict[str, int] | None:
        """Return what a setting of the link must be, since the drive answers at it; None where it has no such value."""
        if name := command.sets(Effect.ADDRESS):
            return {name: self._address}
        if name := command.sets(Effect.DIALECT):
            return {name: self._dialect.chosen_by}
        name, speed = command.sets(Effect.BAUD_RATE), self._gate.line.endpoint.bits_per_second
        return next(({name: code} for code, bits in self._dialect.rates.items() if bits == speed), None)

    def _probe(self, gate: Gate | None = None) -> Probe:
        probe = plain_probe(self._dialect, self._address, gate or self._gate)
        probe.rig.write_gap_ns, probe.rig.quiet_ns = self.write_gap_ns, self.quiet_ns
        return probe

    # --- putting back -------------------------------------------------------------------------------------------------

    @property
    def before(self) -> dict[str, int]:
        """The values of all settings that were changed and are not put back, by field."""
        return {name: value for kept in self._kept.values() for name, value in kept.before.items()}

    @property
    def changed(self) -> bool:
        """Whether something is to be put back."""
        return bool(self._kept)

    @property
    def untried(self) -> bool:
        """Whether something is to be put back of which that was not tried in vain."""
        return any(not kept.failed for kept in self._kept.values())

    @property
    def link_changed(self) -> bool:
        """Whether the drive may answer elsewhere than it did."""
        return any(changes_link(kept.command) for kept in self._kept.values())

    def take_over(self, entries: Iterable[Entry]) -> None:
        """Take over what a journal says was changed; it counts as written down already."""
        for entry in reversed(list(entries)):
            command = self._dialect.by_name.get(entry.command)
            if command is None:
                raise NotRun(f"{self._dialect.name} has no command {entry.command}")
            key = (command.name, settings.selector(command, entry.values))
            # A speed saved for power-on is cleared even if the file has one: a motor must not turn by itself.
            before = _forgotten(command) if command.verb is Verb.SAVE_SPEED else dict(entry.values)
            self._kept[key] = _Kept(command, before, [dict(s) for s in entry.sent])

    def left_at(self, values: Mapping[str, Mapping[str, int]]) -> set[str]:
        """Return the commands, of those whose values are given by name, that last set these values."""
        return {k.command.name for k in self._kept.values() if k.last and values.get(k.command.name) == k.last}

    def put_back(self, *, link_only: bool = False, again: bool = False, but: Collection[str] = ()) -> str:
        """Put back all `but` some commands, the last change first; return what was not put back, or nothing. Raises LineLost.

        What could not be put back is tried once more only with `again`: a drive that refuses goes on refusing.
        """
        self._asking = True
        try:
            if again:
                for kept in self._kept.values():
                    kept.failed = ""
            gate = self._gate.under(PUTTING_BACK)
            failed = self._pass(gate, link_only, but)
            if failed and not link_only and self._into_bus_mode(gate):
                # Some settings are refused in a mode in which the bus does not move the motor.
                for kept in failed:
                    kept.failed = ""
                failed = self._pass(gate, link_only, but)
        finally:
            self._asking = False
        return "; ".join(kept.failed for kept in failed)

    def _pass(self, gate: Gate, link_only: bool, but: Collection[str]) -> list[_Kept]:
        """Put back what was not tried in vain; return what could not be."""
        failed = []
        # The link first: a drive that does not answer takes nothing back. The work mode last: other settings depend on it.
        newest = list(self._kept.items())[::-1]
        newest.sort(key=lambda item: (not changes_link(item[1].command), item[1].command.verb is Verb.SET_WORK_MODE))
        for key, kept in newest:
            if link_only and not changes_link(kept.command):
                continue
            if kept.failed or kept.command.name in but:
                continue
            kept.failed = self._restore(gate, kept)
            if kept.failed:
                failed.append(kept)
                continue
            del self._kept[key]
            if self._journal is not None:
                self._journal.tell(self._entry("back", kept.command, kept.before))
        return failed

    def _into_bus_mode(self, gate: Gate) -> bool:
        """Set a work mode in which the bus moves the motor, where that can be put back; say whether it was set."""
        command = self._dialect.by_verb.get(Verb.SET_WORK_MODE)
        if command is None or not self._can_keep(command):
            return False
        mode = {"work_mode": declared.choice(command, "work_mode", declared.bus_modes(self._dialect)[-1])}
        try:
            self._keep(command, mode)
        except NotRun:
            return False
        finally:
            # Reading the mode ends with asking; there is more to be put back.
            self._asking = True
        probe = self._probe(gate)
        return not probe.refused(probe.ask(command, mode))

    def _restore(self, gate: Gate, kept: _Kept) -> str:
        if changes_link(kept.command):
            waits = {"write_gap_ns": self.write_gap_ns, "quiet_ns": self.quiet_ns}
            return following.restore_link(gate, self._dialect, self._address, kept.command, kept.before, kept.sent, **waits)
        return put_back(self._probe(gate), kept.command, kept.before)


def put_back(probe: Probe, command: Command, values: Mapping[str, int]) -> str:
    """Set a command's settings to values and look that they are; return why not, or nothing."""
    failure = ""
    for _ in range(2):
        try:
            exchange = probe.ask(command, values, quiet_ns=0)
        except Refused as error:
            failure = f"{command.name} {values_text(command, values)}: {error}"
            if command.name != settings.SET_POSITION:
                return failure
            # Its bytes may read as a frame of another dialect: beside it, by less than a shaft trembles, they do not.
            values = {name: value - motion.BESIDE for name, value in values.items()}
            continue
        if exchange.reply is None:
            failure = f"{command.name} {values_text(command, values)}: not answered"
            continue
        if probe.refused(exchange):
            return f"{command.name} {values_text(command, values)}: refused"
        if not settings.readable(probe.dialect, command) or command.name == settings.SET_POSITION:
            return ""
        now = settings.read(probe, command, values)
        if now is None or all(now.get(n) == v for n, v in values.items()):
            return ""
        failure = f"{command.name}: put back {values_text(command, values)}, read {values_text(command, now)}"
    return failure


def _fields(command: Command) -> set[str]:
    return {n for form in command.request_forms for n, f in form.layout.named.items() if f.fixed is None}


def _forgotten(command: Command) -> dict[str, int]:
    """Return what makes a drive forget the speed that it kept for the next power-on."""
    state: Field = command.request_forms[0].layout.named["save_state"]
    return {"save_state": next(value for value, name in state.choice_names.items() if name != "save")}


# --- after a crash ----------------------------------------------------------------------------------------------------


def restore(path: Path, gate: Gate, known: Mapping[int, Dialect] | None = None, *, link_only: bool = False) -> str:
    """Put back what is open in a journal and write into it what was; return what was not put back, or nothing.

    `known`: dialects by address, for a model that the journal does not name. `link_only`: only where the drive is reached.
    Raises UnreadableError, LineLost, Refused.
    """
    changes = journals.open_changes(journals.read(path))
    if not changes:
        return ""
    failed = []
    journal = Journal(path, again=True)
    try:
        for (_, address), entries in groupby(sorted(changes, key=_drive), key=_drive):
            own = list(entries)
            dialect = (known or {}).get(address) or dialect_of(own[0])
            keeper = Keeper(gate, dialect, address, {}, journal, named=own[0].target)
            keeper.take_over(own)
            failure = keeper.put_back(link_only=link_only)
            if failure:
                failed.append(failure)
        if not failed and not link_only:
            journal.tell(Entry(event="end", text="all was put back from the journal"))
    finally:
        journal.close(remove=False)
    return "; ".join(failed)


def _drive(entry: Entry) -> tuple[str, int]:
    return entry.target, entry.address


def link_changed(path: Path) -> bool:
    """Say whether a journal's drives may answer elsewhere than they did. Raises UnreadableError."""
    for entry in journals.open_changes(journals.read(path)):
        command = dialect_of(entry).by_name.get(entry.command)
        if entry.sent and command is not None and changes_link(command):
            return True
    return False


def dialect_of(entry: Entry) -> Dialect:
    """Return the dialect that a journal's line names, for its model. Raises UsageError."""
    return dialects.of_drive(entry.target)


def command_of(entry: Entry) -> Command:
    """Return the command that a journal's line names. Raises UsageError where a run cannot have written the line."""
    dialect = dialect_of(entry)
    command = dialect.by_name.get(entry.command)
    first, last = dialect.addresses
    if command is None or not settings.changes(command):
        raise UsageError(f"{dialect.name} has no setting {quote(entry.command)}")
    if not first <= entry.address <= last:
        raise UsageError(f"{command.name}: got the address {entry.address}, expected {first}..{last}")
    forms = [{n for n, f in form.layout.named.items() if f.fixed is None} for form in command.request_forms]
    whole = command.verb is Verb.SAVE_SPEED or any(names <= entry.values.keys() for names in forms)
    strange = {name for values in (entry.values, *entry.sent) for name in values} - all_fields(command.request_forms).keys()
    if strange or not whole:
        told = ", ".join(map(quote, sorted(strange or entry.values))) or "nothing"
        raise UsageError(f"{command.name}: got {told}, expected {' or '.join(', '.join(sorted(names)) for names in forms)}")
    return command
