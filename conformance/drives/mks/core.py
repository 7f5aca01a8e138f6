"""The core of an MKS drive: frames to orders, orders to behaviours and answers, scripts that go on by themselves, time.

    frame -> Speaker.hear -> whom it is for -> Order -> behaviours[verb] -> reply values -> Speaker.reply -> bytes
                                                 |
                                              script (a move, a homing): waits, and a completion reply at its end

A script is a generator: it yields what it waits for, as a function that says when that will be. The drive asks again
whenever something has changed, so that a switch pressed by hand and one on the shaft's way are the same to a script.

Rules kept here:
- Silence: a bad checksum, a wrong head, another address, an unknown code or length, a drive that is starting. Broadcast,
  group and package are executed and not answered; of a package's slots for one address only the first counts.
- A value outside its range or choices is refused and changes nothing. A motion's speed above its range runs at the
  highest speed of the work mode, and reserved bits of a motion are not looked at.
- What needs certain work modes is refused in the others.
- One script at a time: a newer motion takes the place of the older one, whose completion is not sent. What is refused
  leaves the older one alone.
- `respond` 0 silences what the catalogue marks as silenced, `active` 0 all completion replies.
- A completion is told in the dialect that began the motion, or not at all.
- Replies are ready `reply_delay_ns` after the request, completions at the time at which the motion ends.
- Everything happens at its exact time (the next whole ns), in whatever steps the time is told.

Not emulated: a drive that is too busy to answer.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import ceil

from analyzer.catalogue import Command, Risk, Verb
from analyzer.protocols import mks_shared
from analyzer.records import Frame, Message
from conformance.drives.drive import Fault, Outgoing, Quirk, Values
from conformance.drives.mks.modbus import ModbusSpeaker
from conformance.drives.mks.paths import Number
from conformance.drives.mks.speaker import Order, Speaker
from conformance.drives.mks.state import MksState

#: When a script goes on: a time, or None while nothing leads there.
Wait = Callable[[], Number | None]
Script = Generator[Wait, None, None]

#: Commands that turn the motor; a speed above their range is cut and not refused.
MOTIONS = frozenset(
    {
        Verb.RUN_SPEED, Verb.MOVE_RELATIVE_PULSES, Verb.MOVE_ABSOLUTE_PULSES, Verb.MOVE_RELATIVE_AXIS,
        Verb.MOVE_ABSOLUTE_AXIS,
    }
)  # fmt: skip
STOPS = frozenset(
    {
        Verb.STOP_SPEED, Verb.STOP_RELATIVE_PULSES, Verb.STOP_ABSOLUTE_PULSES, Verb.STOP_RELATIVE_AXIS,
        Verb.STOP_ABSOLUTE_AXIS,
    }
)  # fmt: skip

#: A frame has a code and a check at least.
_SHORTEST = 2


class Kind(StrEnum):
    """What a script does."""

    MOVE = "move"
    STOP = "stop"
    HOME = "home"
    CALIBRATE = "calibrate"
    RETURN = "return"
    START = "start"


def _never() -> None:
    return None


@dataclass
class Task:
    """A script under way. `order`: what asked for it, and is told how it ends; None for what the drive does by itself."""

    kind: Kind
    script: Script
    order: Order | None = None
    wait: Wait = _never


Behaviour = Callable[["MksCore", Order], Values | None]


class MksCore(MksState):
    """A drive that does what `behaviours` says, and `power_on` when power has come on."""

    def __init__(
        self,
        speakers: Sequence[Speaker],
        address: int,
        behaviours: Mapping[Verb, Behaviour],
        power_on: Callable[[MksCore], None],
        *,
        settings: Mapping[str, int] | None = None,
        quirks: Iterable[Quirk] = (),
        faults: Iterable[Fault] = (),
        seed: int = 0,
    ) -> None:
        super().__init__(speakers, address, settings=settings, quirks=quirks, faults=faults, seed=seed)
        self.behaviours = dict(behaviours)
        self.power_on = power_on
        self.task: Task | None = None
        self._outbox: list[Outgoing] = []
        self._due: tuple[int, Callable[[], None]] | None = None
        self._stale = True
        for setup in self.hooks.setup:
            setup(self)
        self.power_on(self)

    def doing(self, *kinds: Kind) -> bool:
        """Say whether a script of one of these kinds is under way."""
        return self.task is not None and self.task.kind in kinds

    @property
    def ready(self) -> bool:
        """Whether a motion can begin."""
        return self.enabled and self.sound and not self.doing(Kind.CALIBRATE)

    # --- frames ---------------------------------------------------------------------------------------------------

    def receive(self, frame: Frame, t_ns: int) -> list[Outgoing]:
        """Take a frame that is complete at `t_ns`, also one that is damaged or not for this drive; return replies."""
        self._pass(t_ns)
        if self.powered and not self.starting and len(frame.data) >= _SHORTEST:
            self._take(frame, self.speaker)
            self.changed()
            self._pass(self.now_ns)
        return self._sent()

    def _take(self, frame: Frame, speaker: Speaker) -> None:
        message = speaker.hear(frame)
        known = frame.dialect.name == speaker.dialect.name and speaker.understands(message)
        package = message.command is not None and message.command.slots is not None
        own = message.address == self.address and not package
        several = package or message.address in (speaker.dialect.broadcast, self.settings.get("group_address"))
        wanted = frame.checksum_ok and known and (own or several)
        for accept in self.hooks.accept:
            wanted = accept(self, frame, message, wanted)
        if not wanted:
            return
        answered = own
        for answer in self.hooks.answer:
            answered = answer(self, message, answered)
        if known and not package and (code := speaker.exception(message)) is not None:
            self._refuse(message, code, answered)
            return
        for order in self._orders(message, answered, package):
            self.obey(order)

    def _orders(self, message: Message, answered: bool, package: bool) -> list[Order]:
        speaker = self.speaker
        if not package:
            order = speaker.order(message, self.now_ns, answered)
            return [] if order is None else [order]
        every, chosen = speaker.slots(message, self.address)
        for choose in self.hooks.slots:
            chosen = choose(self, every, chosen)
        orders = [speaker.order(slot, self.now_ns, answered) for slot in chosen]
        return [order for order in orders if order is not None]

    def _refuse(self, message: Message, code: int, answered: bool) -> None:
        """Answer by an exception."""
        speaker = self.speaker
        if answered and isinstance(speaker, ModbusSpeaker):
            data = speaker.refusal(message, code, self.address)
            command = message.command or speaker.unknown
            self.send(command, Outgoing(self.now_ns + self.reply_delay_ns, data))

    # --- orders ---------------------------------------------------------------------------------------------------

    def obey(self, order: Order) -> None:
        """Do what an order says, and answer it."""
        command, address, speaker = order.command, self.address, order.speaker
        refused = not self._allows(order) or not self._mode_fits(command)
        for change in self.hooks.request:
            order.values = change(self, command, dict(order.values))
        order.reply_ns = self.now_ns + self.reply_delay_ns
        answered = order.answered and not self.silenced(command)
        result = self.refused(order) if refused else self.behaviours[command.verb](self, order)
        self._answer(order, result, answered, speaker, address, order.reply_ns)

    def _allows(self, order: Order) -> bool:
        """Say whether an order's values are what the manual allows; a read has nothing to refuse."""
        if order.command.all_risks == {Risk.READ}:
            return True
        motion = order.command.verb in MOTIONS or order.command.verb in STOPS
        broken = [v for v in order.broken if not (motion and (v.rule == "reserved_bits" or v.field == "speed"))]
        wanted = not broken
        for allow in self.hooks.allow:
            wanted = allow(self, order.command, order.values, wanted)
        return wanted

    def _mode_fits(self, command: Command) -> bool:
        return not command.modes or self.mode in command.modes or "work_mode" in self.heedless

    def silenced(self, command: Command) -> bool:
        """Say whether the replies of a command are switched off."""
        return command.silenced and not self.settings.get("respond", 1) and "respond" not in self.heedless

    def refused(self, order: Order) -> Values:
        """Return the answer that an order failed."""
        return {"status": min(order.speaker.meanings(order.command).failed, default=0)}

    def _answer(self, order: Order, result: Values | None, answered: bool, speaker: Speaker, address: int, at_ns: int) -> None:
        command = order.command
        for change in self.hooks.result:
            result = change(self, command, order.values, result)
        if result is None or not answered:
            return
        data = speaker.reply(command, order.values, result, address)
        self.send(command, Outgoing(at_ns, data, address if speaker.dialect.bus == "can" else None))

    def send(self, command: Command, outgoing: Outgoing) -> None:
        """Send bytes that answer a command."""
        sent = [outgoing]
        for change in self.hooks.reply:
            sent = [changed for each in sent for changed in change(self, command, each)]
        self._outbox += sent

    def forget(self) -> None:
        """Drop what is ready and not sent yet."""
        self._outbox = []

    def _sent(self) -> list[Outgoing]:
        sent, self._outbox = self._outbox, []
        return sent

    # --- scripts --------------------------------------------------------------------------------------------------

    def begin(self, kind: Kind, script: Script, order: Order | None = None) -> None:
        """Begin a script in the place of the one under way."""
        self.task = Task(kind, script, order)
        self._go_on()

    def _go_on(self) -> None:
        task = self.task
        assert task is not None  # only a task's own wait leads here
        try:
            task.wait = next(task.script)
        except StopIteration:
            if self.task is task:
                self.task = None

    def drop(self) -> None:
        """End the script under way without a word."""
        if self.doing(Kind.RETURN):
            self.memory.zero_status = int(mks_shared.ZeroStatus.FAILED)
        self.task = None

    def finish(self, status: int | None) -> None:
        """End the script under way, and tell whoever asked for it; None: that it failed."""
        task, self.task = self.task, None
        if task is not None and task.order is not None:
            self.complete(task.order, self.refused(task.order) if status is None else {"status": status})

    def complete(self, order: Order, values: Values) -> None:
        """Send the completion reply of an order, where there is one and nothing silences it."""
        speaker = self.speaker
        if order.speaker is not speaker or not speaker.completes or not order.answered or self.silenced(order.command):
            return
        if self.settings.get("active", 1) or "active" in self.heedless:
            self._answer(order, values, True, speaker, self.address, max(self.now_ns, order.reply_ns))

    # --- time -----------------------------------------------------------------------------------------------------

    def advance(self, t_ns: int) -> list[Outgoing]:
        """Let time pass until `t_ns`; return what the drive sends by itself (completion replies)."""
        self._pass(t_ns)
        return self._sent()

    def next_ns(self) -> int | None:
        """Return when the drive will do something by itself, or None while nothing is under way."""
        if self._outbox:
            return self.now_ns
        due = self._next()
        return None if due is None else due[0]

    def changed(self) -> None:
        """Say that something changed, so that what comes next must be found anew."""
        self._stale = True

    def _pass(self, t_ns: int) -> None:
        while (due := self._next()) is not None and due[0] <= t_ns:
            self.now_ns = due[0]
            due[1]()
            self.changed()
        self.now_ns = max(self.now_ns, t_ns)

    def _next(self) -> tuple[int, Callable[[], None]] | None:
        """Return what the drive does next by itself, and when."""
        if self._stale:
            self._due, self._stale = self._foresee(), False
        return self._due

    def _foresee(self) -> tuple[int, Callable[[], None]] | None:
        if not self.powered:
            return None
        found: list[tuple[Number | None, Callable[[], None]]] = []
        if self.task is not None:
            found.append((self.task.wait(), self._go_on))
        if self.limits_hold:
            found += [(self._limit_time(side), self._limit_stop) for side in self.switches]
        if self.guarded and not self.doing(Kind.CALIBRATE, Kind.START):
            found.append((self.motor.strays(self.stall_counts, self.now_ns), self.protect))
        times = [(max(ceil(t), self.now_ns), n) for n, (t, _) in enumerate(found) if t is not None]
        if not times:
            return None
        t_ns, number = min(times)
        return t_ns, found[number][1]

    # --- limits and protection ------------------------------------------------------------------------------------

    @property
    def limits_hold(self) -> bool:
        """Whether the end limits can stop a motion: switched on, homed since, in a bus mode."""
        settings = self.settings
        switched_on = settings["end_limit"] and settings["limits_homed"] and "end_limit" not in self.heedless
        return bool(switched_on) and self.by_bus and not self.doing(Kind.HOME, Kind.CALIBRATE, Kind.START)

    def at_limit(self, way: int) -> bool:
        """Say whether an end limit forbids to turn a way now."""
        return self.limits_hold and any(self.effective(s) and self.side_way(s) == way for s in self.switches)

    def _limit_time(self, side: str) -> Number | None:
        """Return when the motor will turn towards a side whose limit holds."""
        reached = self.until_effective(side, True)
        return None if reached is None else self.motor.moves(self.side_way(side), reached)

    def _limit_stop(self) -> None:
        self.motor.halt(self.now_ns)
        self.memory.run = None
        self.finish(mks_shared.RunStatus.LIMIT_STOP)

    @property
    def guarded(self) -> bool:
        """Whether a locked rotor would be let go."""
        return bool(self.settings["protection"]) and self.motor.holding and "protection" not in self.heedless

    def protect(self) -> None:
        """Let the shaft go because the rotor is locked."""
        self.memory.protected = True
        self.fail()

    def fail(self) -> None:
        """Let the shaft go and end what is under way as failed."""
        if self.doing(Kind.RETURN):
            self.drop()
        self.let_go()
        self.memory.run = None
        self.finish(None)
