"""The locked-rotor protection: when a shaft that is held is let go, what the drive then refuses, and how it is released.

Only an emulated drive can be held, so these claims run on one alone. A motor that is given no current (83 with 0) does not
follow either: so the protection, what it refuses and the angle error show without hands on the drive.

Rules kept here:
- How far the shaft must lag behind is printed for CAN alone (89: 1.8 degrees a unit); elsewhere two turns are enough.
- The answer to a move that ends so is not printed: that it is no success is judged, what it is observed.
- A motor without current that lags behind gets current again when it is disabled, or told as protected: so it does not leap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import product
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from analyzer.protocols.mks_shared import Protection
from conformance.claim import Inconclusive
from conformance.claims import bench
from conformance.claims.control_reads import received_text
from conformance.claims.declare import Case, Cases, commands, motions, needing
from conformance.claims.motion.motion_claim import (
    expect_goes,
    expect_stays,
    expect_taken,
    of_motion,
    risks_by,
    that_tell_their_end,
)
from conformance.claims.motion.refusals import expect_refused
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.declared import MOVES, QUICK, RUNS_AND_MOVES
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe

_TURNS = 2.0
_BEHIND_RELEASE = "behind 3D, with the motor told as enabled"


def _of_protection(
    refuted_by: str, *, each: Cases, more_risks: tuple[Verb, ...] = (), **facts: Any
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    facts = {"settings": ("protection",), "risks": risks_by(Verb.SET_PROTECTION, *more_risks), **facts}
    return of_motion(each=each, refuted_by=refuted_by, emulated=True, **facts)


# --- a held shaft -----------------------------------------------------------------------------------------------------


def _prepare(probe: Probe, protection: int, move: Verb | Command = Verb.MOVE_RELATIVE_AXIS, mode: str = "") -> None:
    """Make ready for a move with the protection on or off. `mode`: as `ready_to_move` takes it."""
    if mode:
        motion.ready_to_move(probe, mode)
    motion.prepare(probe, probe.command(move))
    probe.do(Verb.SET_PROTECTION, {"protection": protection})


def _watching(dialect: Dialect) -> list[str]:
    """Return the modes of the bus in which a drive goes by its encoder, by name: an open loop cannot see a locked rotor."""
    return [mode for mode in declared.bus_modes(dialect) if "open" not in mode]


def _held_move(probe: Probe, turns: float = _TURNS, move: Verb | Command = Verb.MOVE_RELATIVE_AXIS) -> Exchange:
    """Hold the shaft and ask for a move; let the time for it pass."""
    bench.hold(probe)
    exchange = motion.begin(probe, probe.command(move), turns * 360, rpm=120, acceleration=QUICK)
    probe.wait(4 * SECOND_NS)
    return exchange


def _switch_on(probe: Probe) -> None:
    """Enable a motor that its release has left disabled; one that is told as enabled has to turn without that."""
    if not motion.is_on(probe):
        probe.do(Verb.ENABLE, {"enabled": 1})


def is_protected(probe: Probe) -> int:
    """Return what 3E reads."""
    return probe.read(Verb.READ_PROTECTION, "status")


def protect(probe: Probe) -> None:
    """Bring the drive into protection and let the shaft go. Raises Inconclusive where it is not protected."""
    _prepare(probe, 1)
    _held_move(probe)
    bench.hold(probe, False)
    if not is_protected(probe):
        raise Inconclusive("the drive does not protect itself from a held shaft")


def _expect(probe: Probe, exchange: Exchange, wanted: int, text: str) -> None:
    probe.expect(is_protected(probe), equal=wanted, refutes=text, exchange=exchange)


def _expect_let_go(probe: Probe, exchange: Exchange) -> None:
    """Let a shaft go that is told as protected; refute unless the motor has let it go too."""
    before = motion.position(probe)
    bench.hold(probe, False)
    probe.wait(SECOND_NS)
    moved = motion.position(probe).value - before.value
    text = "the motor goes on when the held shaft is let go"
    probe.expect(moved, near=0, unit="degrees", refutes=text, exchange=exchange)
    bench.expect_hold(probe, False, "while 3E reads protected")


def _stall_outputs(dialect: Dialect) -> Iterator[Case]:
    """Yield the read of the ports with the port that reports a stall: ALM on CAN, OUT_1 of a 57D elsewhere."""
    for case in commands(Verb.READ_IO)(dialect):
        if dialect.bus == "can":
            yield Case(dialect, case.command, {"port": "alm"})
        elif dialect.model.startswith("57"):
            yield Case(dialect, case.command, {"port": "out_1"})


def _surety(case: Case) -> Certainty:
    # That a locked rotor is an alarm is said of OUT_1.
    return Certainty.LIKELY if case["port"] == "alm" else Certainty.CERTAIN


@_of_protection("another level", each=_stall_outputs, name="{command}/stall", at_best=_surety)
def _stall(probe: Probe, command: Command, port: str) -> None:
    """{port} is 0 while the protection holds, and 1 before and after."""
    _prepare(probe, 1)
    for when, wanted in (("before", 1), ("while", 0), ("after", 1)):
        if when == "while":
            protect(probe)
        elif when == "after":
            probe.do(Verb.RELEASE_PROTECTION)
        text = f"{port} is not {wanted} {when} the protection holds"
        probe.expect(probe.read(command, port), equal=wanted, refutes=text)


@_of_protection("3E that reads 0", each=commands(Verb.SET_PROTECTION), more_risks=(Verb.RELEASE_PROTECTION, Verb.ENABLE))
def _lets_go(probe: Probe) -> None:
    """With the protection on, a shaft that is held in any move, either way, is let go, and 3E reads 1."""
    for move, turns in product(probe.dialect.motions(*MOVES), (_TURNS, -_TURNS)):
        _prepare(probe, 1, move)
        _expect(probe, probe.traffic[-1], 0, "3E reads protected before the shaft was held")
        exchange = _held_move(probe, turns, move)
        _expect(probe, exchange, 1, f"3E does not read protected after the shaft was held in {move.name}")
        _expect_let_go(probe, exchange)
        probe.do(Verb.RELEASE_PROTECTION)
        probe.do(Verb.ENABLE, {"enabled": 1})


@_of_protection(
    "3E that reads 0", each=commands(Verb.SET_PROTECTION), more_risks=(Verb.RUN_SPEED, Verb.RELEASE_PROTECTION, Verb.ENABLE)
)
def _lets_go_turning(probe: Probe) -> None:
    """With the protection on, a shaft that is held while it turns is let go, in both directions, in each closed loop."""
    for mode, way in product(_watching(probe.dialect), (1, -1)):
        _prepare(probe, 1, mode=mode)
        motion.run_at(probe, way * 120, QUICK)
        probe.wait(300 * MS)
        exchange = probe.traffic[-1]
        bench.hold(probe)
        probe.wait(4 * SECOND_NS)
        _expect(probe, exchange, 1, "3E does not read protected after a shaft was held that turned")
        _expect_let_go(probe, exchange)
        probe.do(Verb.RELEASE_PROTECTION)
        probe.do(Verb.ENABLE, {"enabled": 1})


@_of_protection("3E that reads 1", each=commands(Verb.SET_PROTECTION))
def _off_holds_on(probe: Probe) -> None:
    """With the protection off, a shaft that is held is not let go, and 3E reads 0."""
    _prepare(probe, 0)
    _expect(probe, _held_move(probe), 0, "3E reads protected although the protection is off")


@_of_protection("3E that reads 1", each=commands(Verb.READ_PROTECTION))
def _at_first(probe: Probe) -> None:
    """A motor that was never held is not protected: 3E reads 0."""
    _prepare(probe, 1)
    arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 90)
    _expect(probe, probe.traffic[-1], 0, "3E reads protected although the shaft was never held")


# --- while protected, and after ---------------------------------------------------------------------------------------


@_of_protection("another state", each=commands(Verb.RELEASE_PROTECTION), at_best=Certainty.OPEN)
def _leaves_enabled(probe: Probe, command: Command) -> None:
    """3D leaves the motor enabled or disabled as it was while the protection held."""
    protect(probe)
    before = motion.is_on(probe)
    exchange = probe.do(command)
    probe.expect(motion.is_on(probe), equal=before, refutes="3D enables or disables the motor", exchange=exchange)


@_of_protection("a motor that stays protected", each=commands(Verb.RELEASE_PROTECTION), more_risks=(Verb.RUN_SPEED,))
def _releases(probe: Probe, command: Command) -> None:
    """3D ends the protection: 3E reads 0, and the motor moves again."""
    protect(probe)
    before = motion.position(probe)
    exchange = probe.do(command)
    _expect(probe, exchange, 0, "3E reads protected after 3D")
    _switch_on(probe)
    probe.wait(SECOND_NS)
    before, rested = motion.position(probe), before
    expect_stays(rested, before, exchange, "3D takes the motion up again that the protection ended", _MISSING)
    expect_taken(probe, motion.ask(probe, probe.command(Verb.RUN_SPEED)), f"a run is refused {_BEHIND_RELEASE}")
    probe.wait(SECOND_NS)
    moved = motion.stand_still(probe).value - before.value
    text = "the motor does not move after 3D"
    probe.expect(abs(moved), at_least=10, unit="degrees", refutes=text, exchange=exchange)


@_of_protection("a motion, or an answer that says success", each=needing(Verb.SET_PROTECTION, motions(*RUNS_AND_MOVES)))
def _protected(probe: Probe, command: Command) -> None:
    """{command} is refused either way while the rotor protection holds."""
    protect(probe)
    expect_refused(probe, command, "while protected", ways=(1, -1))


@_of_protection("status 2", each=that_tell_their_end(commands(Verb.MOVE_RELATIVE_AXIS)), at_best=Certainty.LIKELY)
def _held(probe: Probe, command: Command) -> None:
    """A move that a held shaft ends is not told as complete."""
    _prepare(probe, 1)
    exchange = _held_move(probe)
    if not is_protected(probe):
        raise Inconclusive("the drive does not protect itself from a held shaft")
    statuses = arriving.statuses(probe.traffic, command)
    text = "a move that a held shaft ended is told as complete"
    probe.expect(statuses, holds=2 not in statuses, expected="no status 2", refutes=text, exchange=exchange)
    probe.measured["status"] = float(statuses[-1])


#: Tolerances as sent (1.8 degrees each), by how many degrees the shaft lags behind, and whether it is let go.
_LAGS = (
    (50, 100, 1),
    (50, -80, 0),
    (20, 50, 1),
    (20, -30, 0),
    (200, 270, 0),
    (200, -380, 1),
    (400, 700, 0),
    (400, -740, 1),
    (1200, 2100, 0),
    (1200, -2250, 1),
)


@_of_protection(
    "a shaft that is let go sooner or later",
    each=commands(Verb.SET_STALL_TOLERANCE),
    settings=("protection", "stall_tolerance"),
)
def _angle(probe: Probe, command: Command) -> None:
    """The shaft is let go when it lags behind by the tolerance: at 36 degrees for 20, at 2160 for 1200, either way."""
    for sent, degrees, wanted in (*_LAGS, (0x7FFF, 2000, 0)):
        turns = degrees / 360
        _prepare(probe, 1)
        probe.do(command, {"stall_tolerance": sent})
        exchange = _held_move(probe, turns)
        text = f"with a tolerance of {sent * 1.8:g} degrees the shaft lags behind by {turns * 360:.0f}"
        _expect(probe, exchange, wanted, text)
        bench.hold(probe, False)
        probe.do(Verb.RELEASE_PROTECTION)
        probe.do(Verb.ENABLE, {"enabled": 1})
        motion.stand_still(probe)


# --- a motor without current, which no hand holds ---------------------------------------------------------------------


def _without_hands(
    refuted_by: str, *, each: Cases, more: tuple[str, ...] = (), **facts: Any
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    risks = risks_by(
        Verb.SET_PROTECTION, Verb.SET_CURRENT, Verb.RELEASE_PROTECTION, Verb.ENABLE, Verb.SET_STALL_TOLERANCE, *_MOVING
    )
    settings = ("protection", "current", *more)
    return of_motion(each=needing(Verb.SET_CURRENT, each), refuted_by=refuted_by, risks=risks, settings=settings, **facts)


_MOVING = (
    Verb.RUN_SPEED,
    Verb.MOVE_RELATIVE_PULSES,
    Verb.MOVE_ABSOLUTE_PULSES,
    Verb.MOVE_RELATIVE_AXIS,
    Verb.MOVE_ABSOLUTE_AXIS,
)


def current(probe: Probe, on: bool) -> dict[str, int]:
    """Return the default current of the motor, or none, as sent."""
    default = declared.field_of(probe.command(Verb.SET_CURRENT), "current").default
    return {"current": int(default or _WEAK) if on else 0}


def _give_current(probe: Probe, on: bool) -> Exchange:
    return probe.do(Verb.SET_CURRENT, current(probe, on))


#: How fast a motor without current is asked to turn; how long the drive has to see that the shaft lags.
_LIMP_RPM, _LAGS_NS = 240, 500 * MS
#: Between two looks whether it has.
_LOOK_NS = 40 * MS


def limp_move(
    probe: Probe, degrees: float, watch_ns: int = _LAGS_NS, move: Verb | Command = Verb.MOVE_RELATIVE_AXIS
) -> tuple[Exchange, float]:
    """Ask a motor without current for a move; return by how many degrees it went all the same.

    `watch_ns`: how long the drive has, behind the time of the move, to see that the shaft lags.
    """
    before = motion.position(probe)
    _give_current(probe, False)
    exchange = motion.begin(probe, probe.command(move), degrees, rpm=_LIMP_RPM, acceleration=QUICK)
    _watch(probe, int(ramp.move_ns(degrees / 360, _LIMP_RPM, QUICK)) + watch_ns)
    return exchange, motion.position(probe).value - before.value


def _watch(probe: Probe, for_ns: int) -> None:
    """Wait until 3E reads protected, which it does until 3D, or for so long."""
    motion.wait_until(probe, lambda: is_protected(probe) == Protection.PROTECTED, every_ns=_LOOK_NS, limit_ns=for_ns)


def end_limp(probe: Probe) -> None:
    """Drop what the motor still wants, and give it current again."""
    probe.ask(Verb.ENABLE, {"enabled": 0})
    _give_current(probe, True)


def _expect_free(probe: Probe, exchange: Exchange, went: float) -> None:
    """Refute a drive that refuses motion as a protected one does, and says that it is none. Raises Inconclusive otherwise."""
    end_limp(probe)
    probe.do(Verb.ENABLE, {"enabled": 1})
    refused = motion.refused(probe, motion.ask(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 90, acceleration=QUICK))
    motion.stand_still(probe)
    text = "3E reads 0, and motion is refused after a motor without current was to turn"
    probe.expect("a refusal", holds=not refused, expected="3E 1, or motion", refutes=text, exchange=exchange)
    raise Inconclusive(f"the drive does not take a motor without current for a locked one; it went {went:+.0f} degrees")


def _expect_left(probe: Probe, exchange: Exchange, watch_ns: int = 0) -> Callable[[], None]:
    """Give a motor current again that is told as protected; refute where that turns the shaft: it was to be let go.

    Return what looks again, for a claim that has other things to do after so long a time.
    """
    before = motion.position(probe)
    _give_current(probe, True)
    text = "a motor that is told as protected turns the shaft when it gets current again"

    def look() -> None:
        expect_stays(before, motion.position(probe), exchange, text, _MISSING)

    probe.wait(watch_ns or _LEAPS_NS)
    look()
    return look


@_without_hands("a motion, an answer that says success, or 3E that reads otherwise", each=commands(Verb.RELEASE_PROTECTION))
def _limp(probe: Probe, command: Command) -> None:
    """Once a motor without current is protected, 3E reads 1, every motion is refused either way, and 3D ends it.

    Moves behind 3D begin where the shaft stands.
    """
    _prepare(probe, 1)
    _expect(probe, probe.traffic[-1], 0, "3E reads protected before the motor was to turn")
    exchange, went = limp_move(probe, _TURNS * 360)
    if not is_protected(probe):
        _expect_free(probe, exchange, went)
    look_again = _expect_left(probe, exchange, _SOON_NS)
    for each in probe.dialect.motions(*RUNS_AND_MOVES):
        expect_refused(probe, each, "while protected", ways=(1, -1))
        _expect(probe, probe.traffic[-1], 1, f"{each.name} ends the protection")
    look_again()
    exchange = probe.ask(command)
    text = f"{command.name} is refused while protected"
    probe.expect(
        received_text(exchange), holds=not probe.refused(exchange), expected="a release", refutes=text, exchange=exchange
    )
    _expect(probe, exchange, 0, "3E reads protected after 3D")
    before = motion.position(probe)
    _switch_on(probe)
    probe.wait(_LEAPS_NS)
    text = "3D takes the motion up again that the protection ended"
    expect_stays(before, motion.position(probe), exchange, text, _MISSING)
    for move in sorted(probe.dialect.motions(MotionKind.MOVE_BY), key=declared.takes_pulses):
        if declared.takes_pulses(move):
            motion.prepare(probe, move)
        expect_goes(probe, move, 45, _BEHIND_RELEASE)


@_without_hands("3E that reads 1", each=commands(Verb.SET_PROTECTION))
def _off_again(probe: Probe) -> None:
    """With the protection on and off again a motor without current is not protected: 3E reads 0."""
    for protection in (1, 0):
        _prepare(probe, protection)
    exchange, _ = limp_move(probe, _TURNS * 360)
    protected = is_protected(probe)
    end_limp(probe)
    probe.do(Verb.ENABLE, {"enabled": 1})
    text = "a protection that was switched on and off again acts on"
    probe.expect(protected, equal=0, refutes=text, exchange=exchange)


@_without_hands("3E that reads otherwise", each=commands(Verb.RELEASE_PROTECTION), at_best=Certainty.LIKELY)
def _limp_either_way(probe: Probe) -> None:
    """A motor without current is protected both ways, in each move from rest, and from a run, in each closed loop."""
    # In the first move the first way is that of the claim above.
    moves = probe.dialect.motions(*MOVES)
    rest = [(move, (-1) ** n) for n, move in enumerate(sorted(moves, key=lambda c: c.verb is not Verb.MOVE_RELATIVE_AXIS), 1)]
    # The last one comes in another mode where there is one.
    another, *own = _watching(probe.dialect)
    for number, (move, way) in enumerate((*rest, (None, 1), (None, -1))):
        _prepare(probe, 1, move or Verb.MOVE_RELATIVE_AXIS, another if own and (move, way) == (None, -1) else "")
        if move is None:
            motion.run_at(probe, way * _LIMP_RPM, QUICK)
            probe.wait(300 * MS)
            text = "a motor that was given its current again does not turn"
            turning = abs(motion.speed(probe).value)
            probe.expect(turning, at_least=_LIMP_RPM / 2, unit="rpm", refutes=text, exchange=probe.traffic[-1])
            exchange, went = _give_current(probe, False), 0.0
            # The shaft that runs out lags behind by two turns.
            _watch(probe, 1500 * MS)
        else:
            exchange, went = limp_move(probe, way * _TURNS * 360, move=move)
        protected = is_protected(probe)
        if not protected and not number:
            _expect_free(probe, exchange, went)
        if protected and (move is None or not number):
            _expect_left(probe, exchange)
        end_limp(probe)
        released = probe.do(Verb.RELEASE_PROTECTION)
        text = f"a motor without current is not protected in {move.name if move else 'a run'}"
        probe.expect(protected, equal=1, refutes=text, exchange=exchange)
        _expect(probe, released, 0, "3E reads protected after 3D")
        probe.do(Verb.ENABLE, {"enabled": 1})


@_without_hands(
    "a shaft that is let go sooner or later",
    each=commands(Verb.SET_STALL_TOLERANCE),
    at_best=Certainty.LIKELY,
    more=("stall_tolerance",),
)
def _limp_angle(probe: Probe, command: Command) -> None:
    """A motor without current is protected when it lags behind by the tolerance, and not before."""
    for number, (sent, degrees, wanted) in enumerate(_LAGS):
        _prepare(probe, 1)
        probe.do(command, {"stall_tolerance": sent})
        exchange, went = limp_move(probe, degrees)
        protected = is_protected(probe)
        if not protected and not number:
            _expect_free(probe, exchange, went)
        end_limp(probe)
        probe.do(Verb.RELEASE_PROTECTION)
        probe.do(Verb.ENABLE, {"enabled": 1})
        text = f"with a tolerance of {sent * 1.8:g} degrees a motor without current lags behind by {abs(degrees)}"
        probe.expect(protected, equal=wanted, refutes=text, exchange=exchange, key="tolerance")


@_without_hands("3E that reads 1", each=commands(Verb.SET_PROTECTION))
def _limp_off(probe: Probe) -> None:
    """With the protection off, a motor without current that is to turn is not protected."""
    _prepare(probe, 0)
    exchange, _ = limp_move(probe, _TURNS * 360)
    protected = is_protected(probe)
    end_limp(probe)
    text = "3E reads protected although the protection is off"
    probe.expect(protected, equal=0, refutes=text, exchange=exchange)


def _errors(dialect: Dialect) -> Iterable[Case]:
    return needing(Verb.MOVE_RELATIVE_AXIS, commands(Verb.READ_ANGLE_ERROR))(dialect)


@_without_hands("another angle, or another sign", each=_errors, name="{command}/limp")
def _limp_error(probe: Probe, command: Command) -> None:
    """The angle error of a motor without current is what is missing of its move: wanted less real, either way."""
    field = command.reply_forms[0].layout.named["angle_error"]
    # The last is more than 16 bits hold.
    for degrees in (90.0, -45.0, 540.0):
        _prepare(probe, 0)
        # The move would be over, and nothing is to protect the motor.
        exchange, went = limp_move(probe, degrees, 100 * MS)
        error = float(field.physical(probe.read(command, "angle_error")))
        end_limp(probe)
        text = "the angle error of a motor without current is not what is missing of its move"
        probe.expect(error, near=degrees - went, within=_MISSING, unit="degrees", refutes=text, exchange=exchange)


#: A current for models whose default is not known, in mA; degrees by which a shaft without current may tremble.
_WEAK, _MISSING = 800, 2.0
#: How long a motor that gets current again is watched.
_LEAPS_NS = 500 * MS
#: How long it is watched before other things are done with it, which take that time.
_SOON_NS = 100 * MS
