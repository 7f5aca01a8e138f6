"""The activities of an MKS drive: scripts (a move, a homing), end limits, the locked rotor.

    Request -> behaviours[verb] -> reply values
                    |
               script: waits, and a completion reply at its end

A script is a generator. It yields its next wait, as a function that returns the time when the wait ends. The drive calls that
function again after each change. So a script treats a switch pressed by hand like a switch that the shaft reaches.

Rules kept here:
- A motion with a speed above its range runs at the highest speed of the work mode. Reserved bits of a motion are
  ignored. A command that needs certain work modes is refused in the others.
- One script runs at a time: a newer motion replaces the older one, whose completion is not sent. A refused request
  leaves the older motion alone.
- `respond` 0 silences the commands that the catalogue marks, `active` 0 all completion replies.
- A completion is sent when the motion ends, in the dialect that began the motion. In another dialect it is not sent.

Not emulated: a drive that is too busy to answer.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import ceil
from typing import Unpack

from analyzer.catalogue import Command, MotionKind, Verb
from analyzer.codec import Violation
from analyzer.protocols import mks_rs485, mks_shared
from conformance.drives.drive import Options, Request, Values
from conformance.drives.mks.paths import Number
from conformance.drives.mks.responders import MksResponder
from conformance.drives.mks.state import MksState

#: When a script goes on: a time, or None while nothing leads there.
Wait = Callable[[], Number | None]
Script = Generator[Wait, None, None]

_RAMPED = [c for c in mks_rs485.DIALECT.commands if c.motion is not None and c.motion.acceleration]
#: The commands that ramp the speed of the motor down to a stop, and all others that do.
STOPS = frozenset(c.verb for c in _RAMPED if c.motion is not None and c.motion.kind is MotionKind.STOP)
MOTIONS = frozenset(c.verb for c in _RAMPED) - STOPS


class Activity(StrEnum):
    """What a script does."""

    MOVE = "move"
    STOP = "stop"
    HOME = "home"
    CALIBRATE = "calibrate"
    RETURN = "return"
    START = "start"


@dataclass
class Task:
    """A script under way. `request`: what asked for it, which its end completes; None where the drive began it by itself."""

    kind: Activity
    script: Script
    request: Request | None = None
    wait: Wait = lambda: None


Behaviour = Callable[["MksCore", Request], Values | None]


class MksCore(MksState):
    """A drive that does what `behaviours` says, and `power_on` when power has come on."""

    def __init__(
        self,
        responders: Sequence[MksResponder],
        address: int,
        behaviours: Mapping[Verb, Behaviour],
        power_on: Callable[[MksCore], None],
        **options: Unpack[Options],
    ) -> None:
        super().__init__(responders, address, **options)
        self.behaviours = dict(behaviours)
        self.power_on = power_on
        self.task: Task | None = None
        for setup in self.hooks.setup:
            setup(self)
        self.power_on(self)

    def doing(self, *kinds: Activity) -> bool:
        """Say whether a script of one of these kinds is under way."""
        return self.task is not None and self.task.kind in kinds

    @property
    def ready(self) -> bool:
        """Whether a motion can begin."""
        return self.enabled and self.healthy and not self.doing(Activity.CALIBRATE)

    # --- requests -------------------------------------------------------------------------------------------------

    def behave(self, request: Request) -> Values | None:
        """Do what a request says, unless the work mode does not allow it."""
        modes = request.command.modes
        fits = not modes or self.mode in modes or "work_mode" in self.heedless
        return self.behaviours[request.command.verb](self, request) if fits else self.refused(request)

    def tolerates(self, command: Command, violation: Violation) -> bool:
        """Say whether the drive overlooks what a request breaks: reserved bits and the speed of a motion."""
        motion = command.motion
        ramped = motion is not None and motion.acceleration != ""
        return ramped and (violation.rule == "reserved_bits" or violation.field == "speed")

    def silenced(self, command: Command) -> bool:
        return command.silenced and not self.settings.get("respond", 1) and "respond" not in self.heedless

    def refused(self, request: Request) -> Values:
        return {"status": min(request.responder.meanings(request.command).failed, default=0)}

    # --- scripts --------------------------------------------------------------------------------------------------

    def begin(self, kind: Activity, script: Script, request: Request | None = None) -> None:
        """Begin a script in the place of the one under way."""
        self.task = Task(kind, script, request)
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
        """End the script under way without a completion reply."""
        if self.doing(Activity.RETURN):
            self.memory.zero_status = int(mks_shared.ZeroStatus.FAILED)
        self.task = None

    def finish(self, status: int | None) -> None:
        """End the script under way with a completion reply: its status, None where it failed."""
        task, self.task = self.task, None
        if task is not None and task.request is not None:
            self.complete(task.request, self.refused(task.request) if status is None else {"status": status})

    def complete(self, request: Request, values: Values) -> None:
        """Send the completion reply of a request, where there is one and nothing silences it."""
        responder = self.responder
        told = request.responder is responder and responder.completes and request.answered
        if not told or self.silenced(request.command):
            return
        if self.settings.get("active", 1) or "active" in self.heedless:
            self.answer(request, values, True, self.address, max(self.now_ns, request.reply_ns))

    def foresee(self) -> tuple[int, Callable[[], None]] | None:
        """Return what the drive does next by itself, and when."""
        if not self.powered:
            return None
        found: list[tuple[Number | None, Callable[[], None]]] = []
        if self.task is not None:
            found.append((self.task.wait(), self._go_on))
        if self.limits_hold:
            found += [(self._limit_time(side), self._limit_stop) for side in self.switches]
        if self.guarded and not self.doing(Activity.CALIBRATE, Activity.START):
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
        return bool(switched_on) and self.by_bus and not self.doing(Activity.HOME, Activity.CALIBRATE, Activity.START)

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
        if self.doing(Activity.RETURN):
            self.drop()
        self.let_go()
        self.memory.run = None
        self.finish(None)
