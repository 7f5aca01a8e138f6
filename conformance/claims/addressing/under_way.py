"""What is sent to several drives while the shaft turns: it is executed as at rest, and not answered.

And what others are asked leaves a motion of the drive itself, and what tells its end, as it is.

    a run at 60 rpm, then each motion and homing to address 0, or to the group, at 120 rpm the other way
    then the emergency stop, or disabling, to the same address
    what ends by itself (homing, a move at a limit or with a locked rotor, a calibration) to any of them: no end is told

Rules kept here:
- Of what comes the speed alone is looked at, and of a run the way: of moves and homing that is other claims' matter.
- Every second run that is taken over was begun by the same address.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims import bench
from conformance.claims.addressing.package import others_of
from conformance.claims.addressing.ways import BROADCAST, Many, addresses, addressing, ways
from conformance.claims.control_reads import expect_silence, plain_read
from conformance.claims.declare import Case
from conformance.claims.motion import homing
from conformance.claims.motion.stops import expect_ended
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.attempts import undamaged
from conformance.motion.declared import CALM, MOVES, QUICK, RUNS_AND_MOVES, SUBDIVISION
from conformance.talk import samples
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE, TOLD_LATE_NS
from conformance.talk.probe import MS, SECOND_NS, Probe, Until

#: How fast what comes turns the shaft (rpm), and how far a move is to go (degrees).
_RPM, _FAR = 2 * CALM, 720
#: How long the shaft turns before, until a newer motion surely has its speed, and how long what ends it is listened to.
_GOING_NS, _RUNS_NS, _ENDS_NS = 40 * MS, 130 * MS, 20 * MS
#: How long the shaft has to stand, and to run out.
_STANDS_NS, _RUNS_OUT_NS = 500 * MS, 4_000 * MS
#: What turns the shaft, and what ends that, with its values.
Ended = tuple[Command, tuple[Command, dict[str, int]]]


def _cases(dialect: Dialect) -> Iterator[Case]:
    motions = dialect.motions(MotionKind.RUN, *MOVES) if dialect.ramp is not None and declared.can_move(dialect) else ()
    homes = [dialect.by_verb[v] for v in (Verb.HOME, *homing.SETS_HOME) if v in dialect.by_verb]
    # The emergency stop ends each motion; disabling ends homing and a run, which come once more.
    chosen: list[Ended] = [(each, (dialect.by_verb[Verb.EMERGENCY_STOP], {})) for each in (*motions, *homes[:1]) if motions]
    again = (*homes[:1], *motions[:1]) if Verb.ENABLE in dialect.by_verb else ()
    chosen += [(each, declared.switching(dialect, False)) for each in again]
    risks = frozenset[Risk]().union(*(command.all_risks for command in (*motions, *homes))) - {Risk.UNKNOWN}
    for many in addresses(dialect) if motions else ():
        facts = {
            "risks": declared.risks(dialect, *risks, *many.risks(dialect), Risk.UNBOUNDED, Risk.TORQUE),
            "settings": (*declared.settings(dialect, *homing.fields(dialect)), *many.settings),
        }
        yield Case(dialect, given={"many": many, "what": many.what, "chosen": chosen}, facts=facts)


@addressing("a shaft that goes on as before, or an answer", _cases, name="{many}/while-turning")
def _while_turning(probe: Probe, many: Many, chosen: list[Ended]) -> None:
    """By {what} each motion and homing takes over from a run, emergency stop and disabling end it; none is answered."""
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1], subdivision=SUBDIVISION)
    # Its own claims end homing of either kind: here each address has one.
    homing.set_home(probe, home_speed=_RPM, home_mode=int(many is BROADCAST), return_angle=0)
    to = many.join(probe)
    run = probe.command(Verb.RUN_SPEED)
    going = declared.values_of(probe.dialect, run)
    for number, (command, (stop, values)) in enumerate(chosen):
        begun = many.frame(probe, run, going, to) if number % 2 else probe.build(run, going).item()
        probe.send(begun, timeout_ns=_GOING_NS)
        before = motion.speed(probe).value if command is run else 0.0
        sent = [probe.send(many.frame(probe, command, _values(probe, command), to), timeout_ns=_RUNS_NS)]
        seen = motion.speed(probe)
        sent.append(probe.send(many.frame(probe, stop, values, to), timeout_ns=_ENDS_NS))
        # Without torque the shaft runs out.
        limit_ns = _RUNS_OUT_NS if values else _STANDS_NS
        expect_ended(probe, sent[-1], f"{stop.name} by {many.what} does not end {command.name}", limit_ns)
        if values:
            motion.switch(probe, True)
        text = f"{command.name} by {many.what} is not executed while the shaft turns"
        within = 2 + 2 * CLOCK_SHARE * _RPM + seen.noise
        probe.expect(abs(seen.value), near=_RPM, within=within, unit="rpm", refutes=text, exchange=sent[0])
        text = f"{command.name} by {many.what} turns the shaft the other way than to the drive itself"
        got = f"{before:+g} rpm, then {seen.value:+g} rpm"
        probe.expect(got, holds=before * seen.value <= 0, expected="one way, then the other", refutes=text, exchange=sent[0])
        for each in sent:
            expect_silence(probe, each, f"{command.name} by {many.what} is answered while the shaft turns")


def _values(probe: Probe, command: Command) -> dict[str, int]:
    if command.verb is Verb.HOME:
        return dict.fromkeys(command.request_forms[0].layout.named, 1)
    rpm = -_RPM if declared.of(command).kind is MotionKind.RUN else _RPM
    return declared.values_of(probe.dialect, command, -_FAR, rpm=rpm, acceleration=QUICK, start=motion.place(probe, command))


# --- the end of a motion ----------------------------------------------------------------------------------------------

#: How far a move goes (degrees, at `CALM`), the ramp of a stop and how long it takes; a request to others, the pause behind it.
_WAY, _RAMP, _BETWEEN_NS = 27, 226, 10 * MS
_FALLS_NS = CALM * ramp.step_ns(_RAMP)
#: A motion that is told to end, and its stop: without one it goes as far as it was sent.
_Told = tuple[Command, Command | None]


def _that_tell_their_end(dialect: Dialect) -> Iterator[Case]:
    motions = dialect.motions(*RUNS_AND_MOVES) if arriving.tells_end(dialect) and declared.can_move(dialect) else ()
    rows: list[_Told] = [(each, None) for each in motions if declared.of(each).kind in MOVES]
    rows += [(each, stop) for each in motions for stop in dialect.stops_of(each) if declared.of(stop).acceleration]
    ways = list(addresses(dialect))
    risks = {risk for each in motions for risk in each.all_risks} - {Risk.UNKNOWN}
    for many in ways[-1:] if rows else ():
        more = frozenset().union(*(way.risks(dialect) for way in ways))
        facts = {
            "risks": declared.risks(dialect, *risks, *more, Risk.UNBOUNDED),
            "settings": (*declared.settings(dialect), *many.settings),
        }
        yield Case(dialect, given={"many": many, "ways": ways, "rows": rows}, facts=facts)


@addressing("a motion whose end is not told", _that_tell_their_end, name="others-asked/ends-told", at_best=Certainty.LIKELY)
def _ends_told(probe: Probe, many: Many, ways: list[Many], rows: list[_Told]) -> None:
    """What all drives, a group or another drive is asked during a motion leaves the reply that tells its end, as of a stop."""
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1], subdivision=SUBDIVISION)
    read = plain_read(probe.dialect)
    to = [*(way.join(probe) for way in ways), *others_of(probe.dialect, probe.address, 1)]
    for row in rows:
        told, exchange = undamaged(probe, _is_end_told, row, read, to)
        if not told and not undamaged(probe, _is_end_told, row, read, [])[0]:
            raise Inconclusive("the end of a motion is not told either when no other drive is asked")
        command, stop = row
        text = f"the end of {(stop or command).name} is not told when others are asked before it"
        probe.expect("silence", holds=told, expected="a reply that tells the end", refutes=text, exchange=exchange)


def _is_end_told(probe: Probe, row: _Told, read: Command, others: list[int]) -> tuple[bool, Exchange]:
    """Say whether the end of a motion is told, during which others are asked."""
    command, stop = row
    exchange = motion.begin(probe, command, _WAY if stop is None else _FAR, acceleration=QUICK, quiet_ns=0)
    lasts_ns = int(ramp.move_ns(_WAY / 360, CALM, QUICK))
    if stop is not None:
        probe.wait(_GOING_NS)
        exchange, lasts_ns = probe.ask(stop, {"acceleration": _RAMP}, quiet_ns=0), int(_FALLS_NS)
    since, told = len(probe.traffic), stop or command
    for address in others:
        probe.ask(read, address=address, until=Until.TIMEOUT, timeout_ns=_BETWEEN_NS)
    until_ns = exchange.sent_ns + lasts_ns + TOLD_LATE_NS
    while not (found := told.replies.final.intersection(arriving.statuses([exchange, *probe.traffic[since:]], told))):
        if (left_ns := until_ns - probe.gate.now_ns()) <= 0:
            break
        probe.listen(left_ns, Until.REPLY)
    motion.wait_standing(probe)
    return bool(found), exchange


# --- an end that no stop brings ---------------------------------------------------------------------------------------

#: How long a move that cannot arrive, and a calibration, are listened to; how far such a move is to go (degrees).
_FAILS_NS, _CALIBRATES_NS, _BLOCKED = 4 * SECOND_NS, 60 * SECOND_NS, 720
#: Where homing finds its end limit, in counts below the shaft.
_LIMIT_COUNTS = 3000
#: What is sent, for how long it is listened to, and in words how it ends.
_Ending = tuple[Command, dict[str, int], int, str]


@dataclass(frozen=True)
class _Ends:
    """A motion that ends by itself. `make`: yields it where it will end so, and clears up. `verbs`: what is sent for it."""

    name: str
    make: Callable[[Probe], Iterator[_Ending]]
    verbs: tuple[Verb, ...]
    by_name: bool = False


def _finds_home(probe: Probe) -> Iterator[_Ending]:
    home = probe.command(Verb.HOME)
    for row in homing.places(probe.dialect):
        shown = homing.mounted(probe, **row, home_speed=300)
        yield home, _values(probe, home), homing.FOUND_NS, f"at home, {shown}"
        text = "homing by several addresses does not end where it should"
        seen, exchange = probe.read(Verb.READ_POSITION, "position"), probe.traffic[-1]
        probe.expect(seen, near=0, unit="counts", expected=f"0: {shown}", refutes=text, exchange=exchange)


def _blocked_move(probe: Probe, ends: str) -> _Ending:
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    values = declared.values_of(probe.dialect, move, -_BLOCKED, rpm=_RPM, start=motion.place(probe, move))
    return move, values, _FAILS_NS, ends


def _meets_limit(probe: Probe) -> Iterator[_Ending]:
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    homing.set_home(probe, end_limit=1)
    bench.left_switch(probe, -_LIMIT_COUNTS)
    homing.find_home(probe)
    # Homing may have let the shaft go.
    motion.switch(probe, True)
    yield _blocked_move(probe, "at a closed end limit")


def _is_held(probe: Probe) -> Iterator[_Ending]:
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    probe.do(Verb.SET_PROTECTION, {"protection": 1})
    bench.hold(probe)
    yield _blocked_move(probe, "with a locked rotor")
    bench.hold(probe, False)
    probe.do(Verb.RELEASE_PROTECTION)


def _calibrates(probe: Probe) -> Iterator[_Ending]:
    motion.ready_to_move(probe)
    command = probe.command(Verb.CALIBRATE)
    yield command, samples.sample(probe.dialect, command), _CALIBRATES_NS, "when it is done"


_ENDINGS = (
    _Ends("home", _finds_home, (Verb.HOME, *homing.SETS_HOME)),
    _Ends("limit", _meets_limit, (Verb.HOME, *homing.SETS_HOME, Verb.ENABLE)),
    _Ends("locked-rotor", _is_held, (Verb.SET_PROTECTION, Verb.RELEASE_PROTECTION)),
    _Ends("calibration", _calibrates, (Verb.CALIBRATE,), by_name=True),
)


def _ending_alone(dialect: Dialect) -> Iterator[Case]:
    for many in ways(dialect) if arriving.tells_end(dialect) and declared.can_move(dialect) else ():
        for ends in _ENDINGS:
            if not all(verb in dialect.by_verb for verb in ends.verbs):
                continue
            sent = (Verb.MOVE_RELATIVE_AXIS, *ends.verbs)
            risks = frozenset[Risk]().union(*(dialect.by_verb[verb].all_risks for verb in sent)) - {Risk.UNKNOWN}
            facts = {
                "risks": declared.risks(dialect, *risks, *many.risks(dialect), Risk.UNBOUNDED, Risk.TORQUE),
                "settings": (*declared.settings(dialect, "protection", *homing.fields(dialect)), *many.settings),
                "by_name": ends.by_name,
            }
            yield Case(dialect, given={"many": many, "what": many.what, "kind": ends.name, "ends": ends}, facts=facts)


@addressing("an answer", _ending_alone, name="{many}/ends-by-itself/{kind}", emulated=True, at_best=Certainty.LIKELY)
def _ends_alone(probe: Probe, many: Many, ends: _Ends) -> None:
    """What was begun by {what} and ends by itself is not answered then: {kind}."""
    to = many.join(probe)
    for command, values, lasts_ns, when in ends.make(probe):
        sent = probe.send(many.frame(probe, command, values, to), timeout_ns=lasts_ns)
        expect_silence(probe, sent, f"{command.name} by {many.what} is answered {when}", key=f"{command.name} answered")
