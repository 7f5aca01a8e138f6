"""Faults of the replies to motion: interim and completion replies, superseded moves, respond and active."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction

from analyzer.catalogue import Command, Verb
from analyzer.protocols import mks_shared
from conformance.drives.drive import Drive, Fault, Hooks, Outgoing, Values
from conformance.drives.faults.mks_makers import MOVES, TELLING, answered, changed, ended, heedless, wrapped
from conformance.drives.mks.core import STOPS, Behaviour, Kind, MksCore, Script
from conformance.drives.mks.speaker import Order

_COMPLETE, _LIMIT = int(mks_shared.RunStatus.COMPLETE), int(mks_shared.RunStatus.LIMIT_STOP)
_STARTING: Values = {"status": int(mks_shared.RunStatus.STARTING)}
_RUNS = MOVES | {Verb.RUN_SPEED}
_LATE_NS = 2_000_000_000


def _half_way(drive: MksCore, order: Order) -> Script:
    begin_ns, settled = drive.now_ns, drive.motor.settled
    yield lambda: begin_ns + Fraction(settled - begin_ns) / 2
    drive.finish(_COMPLETE)


def _afterwards(drive: MksCore, order: Order) -> Script:
    yield lambda: drive.motor.settled + _LATE_NS
    drive.finish(_COMPLETE)


def _silently(drive: MksCore, order: Order) -> Script:
    yield lambda: drive.motor.settled
    drive.drop()


def _twice(drive: MksCore, order: Order) -> Script:
    yield lambda: drive.motor.settled
    drive.complete(order, {"status": _COMPLETE})
    drive.finish(_COMPLETE)


def _saying(status: int) -> Callable[[MksCore, Order], Script]:
    def script(drive: MksCore, order: Order) -> Script:
        yield lambda: drive.motor.settled
        drive.finish(status)

    return script


def _older_too(behaviour: Behaviour) -> Behaviour:
    """Complete the older move when a newer one takes its place."""

    def act(drive: MksCore, order: Order) -> Values | None:
        older = drive.task.order if drive.task is not None and drive.doing(Kind.MOVE) else None
        if older is not None:
            drive.complete(older, {"status": _COMPLETE})
        return behaviour(drive, order)

    return act


def _silencing(drive: MksCore, command: Command, asked: Values, values: Values) -> Values | None:
    return values if drive.settings["respond"] or command.verb is Verb.SET_RESPOND else None


def _double_interim(hooks: Hooks) -> None:
    """Send the first reply to a move twice."""
    last: list[Values] = []

    def result(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        last[:] = [values] if values is not None else []
        return values

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        begins = command.verb in MOVES and last == [_STARTING]
        return (outgoing, outgoing) if begins else (outgoing,)

    hooks.result.append(result)
    hooks.reply.append(say)


def _silent_home(drive: MksCore, command: Command, asked: Values, values: Values) -> Values | None:
    return None if values.get("status") == mks_shared.HomeStatus.SUCCESS else values


FAULTS: tuple[Fault, ...] = (
    # Replies to motion
    Fault("completion-missing", TELLING, "the end of a move is not told", "completion", ended(_silently)),
    Fault("completion-doubled", TELLING, "the end of a move is told twice", "completion", ended(_twice)),
    Fault("completion-too-early", TELLING, "the end of a move is told half-way", "completion", ended(_half_way)),
    Fault("completion-too-late", TELLING, "the end of a move is told two seconds late", "completion", ended(_afterwards)),
    Fault("completion-says-1", TELLING, "the end of a move is told by status 1", "completion", ended(_saying(1))),
    Fault("completion-says-3", TELLING, "the end of a move is told as an end limit", "completion", ended(_saying(_LIMIT))),
    Fault("completion-says-0", TELLING, "the end of a move is told as a failure", "completion", ended(_saying(0))),
    Fault("stop-completion-missing", TELLING, "the end of a stop is not told", "completion", ended(_silently, STOPS)),
    Fault("stop-completion-early", TELLING, "the end of a stop is told half-way", "completion", ended(_half_way, STOPS)),
    Fault("interim-missing", TELLING, "the beginning of a move is not told", "completion",
          answered(MOVES, lambda d, c, a, v: None if v["status"] == 1 else v)),
    Fault("interim-doubled", TELLING, "the beginning of a move is told twice", "completion", _double_interim),
    Fault("interim-and-completion-swapped", TELLING, "a move begins with 2 and ends with 1", "completion",
          changed(MOVES, "status", lambda s: {1: 2, 2: 1}.get(s, s))),
    Fault("superseded-completes-too", TELLING, "a move whose place a newer one took is told as done", "completion",
          wrapped(_RUNS, _older_too)),
    Fault("respond-ignored", TELLING, "respond 0 silences nothing", "respond", heedless("respond")),
    Fault("respond-silences-all", TELLING, "respond 0 silences every reply", "respond", answered(None, _silencing)),
    Fault("active-ignored", TELLING, "active 0 leaves completions as they are", "respond", heedless("active")),
    Fault("active-silences-first", TELLING, "active 0 silences the first reply to motion too", "respond",
          answered(_RUNS | STOPS, lambda d, c, a, v: v if d.settings["active"] else None)),
    Fault("limit-stop-says-2", TELLING, "a move stopped by an end limit is told as complete", "completion",
          changed(MOVES, "status", lambda s: _COMPLETE if s == _LIMIT else s)),
    Fault("home-completion-missing", TELLING, "the end of homing is not told", "completion",
          answered({Verb.HOME}, _silent_home)),
    Fault("home-begins-with-2", TELLING, "homing begins with status 2", "completion",
          changed(Verb.HOME, "status", lambda s: 2 if s == 1 else s)),
    Fault("calibration-without-interim", TELLING, "80 is not answered when it begins", "completion",
          answered({Verb.CALIBRATE}, lambda d, c, a, v: None if v["status"] == 0 else v)),
)  # fmt: skip
