"""The locked-rotor protection: when a shaft that is held is let go, what the drive then refuses, and how it is released.

Only an emulated drive can be held, so these claims run on one alone.

Rules kept here:
- How far the shaft must lag behind is printed for CAN alone (89: 1.8 degrees a unit); elsewhere two turns are enough.
- The answer to a move that ends so is not printed: that it is no success is judged, what it is observed.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims import world
from conformance.claims.motion_claim import motion_claim, refute
from conformance.claims.motion_states import expect_refused
from conformance.motion import motion
from conformance.motion import moves as journey
from conformance.motion.motion import QUICK, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

_TURNS = 2.0


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about the locked-rotor protection."""
    setting = dialect.by_verb[Verb.SET_PROTECTION]
    made = partial(motion_claim, dialect, emulated=True, settings=("protection",), risks=setting.all_risks)
    yield made(
        setting, "lets-go", "With the protection on, a shaft that is held is let go, and 3E reads 1.", "3E that reads 0",
        _lets_go,
    )  # fmt: skip
    yield made(
        setting, "off-holds-on", "With the protection off, a shaft that is held is not let go, and 3E reads 0.",
        "3E that reads 1", _holds_on,
    )  # fmt: skip
    read = dialect.by_verb[Verb.READ_PROTECTION]
    yield made(read, "at-first", "A motor that was never held is not protected: 3E reads 0.", "3E that reads 1", _at_first)
    release = dialect.by_verb[Verb.RELEASE_PROTECTION]
    yield made(
        release, "releases", "3D ends the protection: 3E reads 0, and the motor moves again.",
        "a motor that stays protected", _releases, risks=setting.all_risks | dialect.by_verb[Verb.RUN_SPEED].all_risks,
    )  # fmt: skip
    for command in (dialect.by_verb[Verb.RUN_SPEED], *journey.moves(dialect)):
        yield made(
            command,
            "protected",
            f"{command.name} is refused while the rotor protection holds.",
            "a motion, or an answer that says success",
            _protected,
        )
    if journey.tells(dialect):
        yield made(
            dialect.by_verb[Verb.MOVE_RELATIVE_AXIS], "held", "A move that a held shaft ends is not told as complete.",
            "status 2", _no_success, at_best=Certainty.LIKELY,
        )  # fmt: skip
    tolerance = dialect.by_verb.get(Verb.SET_STALL_TOLERANCE)
    if tolerance is not None:
        yield motion_claim(
            dialect,
            tolerance,
            "angle",
            "The shaft is let go when it lags behind by the tolerance: at 90 degrees for 50, not at 270 for 200.",
            "a shaft that is let go sooner or later",
            _tolerance,
            emulated=True,
            settings=("protection", "stall_tolerance"),
            risks=setting.all_risks,
        )


def _prepare(probe: Probe, protection: int) -> Command:
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    journey.prepare(probe, move)
    probe.do(Verb.SET_PROTECTION, {"protection": protection})
    return move


def _held_move(probe: Probe, turns: float) -> Exchange:
    """Hold the shaft and ask for a move; let the time for it pass."""
    world.hold(probe)
    exchange = journey.begin(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), turns, acceleration=QUICK)
    probe.wait(4 * SECOND_NS)
    return exchange


def _is_protected(probe: Probe) -> int:
    return probe.read(Verb.READ_PROTECTION, "status")


def _protect(probe: Probe) -> None:
    """Bring the drive into protection and let the shaft go. Raises Inconclusive where it is not protected."""
    _prepare(probe, 1)
    _held_move(probe, _TURNS)
    world.hold(probe, False)
    if not _is_protected(probe):
        raise Inconclusive("the drive does not protect itself from a held shaft")


def _expect(probe: Probe, exchange: Exchange, wanted: int, text: str) -> None:
    seen = _is_protected(probe)
    if seen != wanted:
        raise refute(exchange, text, expected=str(wanted), got=str(seen))


def _lets_go(probe: Probe, command: Command) -> None:
    _prepare(probe, 1)
    _expect(probe, probe.traffic[-1], 0, "3E reads protected before the shaft was held")
    exchange = _held_move(probe, _TURNS)
    _expect(probe, exchange, 1, "3E does not read protected after the shaft was held")
    world.hold(probe, False)
    before = motion.position(probe)
    probe.wait(SECOND_NS)
    after = motion.position(probe)
    if abs(after.value - before.value) > motion.SAME:
        text = "the motor goes on when the held shaft is let go"
        raise refute(exchange, text, expected="no motion", got=f"{after.value - before.value:+.2f} degrees")


def _holds_on(probe: Probe, command: Command) -> None:
    _prepare(probe, 0)
    exchange = _held_move(probe, _TURNS)
    _expect(probe, exchange, 0, "3E reads protected although the protection is off")


def _at_first(probe: Probe, command: Command) -> None:
    _prepare(probe, 1)
    journey.travel(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 0.25)
    _expect(probe, probe.traffic[-1], 0, "3E reads protected although the shaft was never held")


def _releases(probe: Probe, command: Command) -> None:
    _protect(probe)
    exchange = probe.do(command)
    _expect(probe, exchange, 0, "3E reads protected after 3D")
    probe.do(Verb.ENABLE, {"enabled": 1})
    before = motion.position(probe)
    motion.run_at(probe, 60, QUICK)
    probe.wait(SECOND_NS)
    after = motion.stand_still(probe)
    if abs(after.value - before.value) < 10:
        text = "the motor does not move after 3D"
        raise refute(exchange, text, expected="motion", got=f"{after.value - before.value:+.2f} degrees")


def _protected(probe: Probe, command: Command) -> None:
    _protect(probe)
    expect_refused(probe, command, "while protected")


def _no_success(probe: Probe, command: Command) -> None:
    _prepare(probe, 1)
    exchange = _held_move(probe, _TURNS)
    if not _is_protected(probe):
        raise Inconclusive("the drive does not protect itself from a held shaft")
    told = [a.values["status"] for a in journey.told(probe.traffic, command)]
    if 2 in told:
        text = "a move that a held shaft ended is told as complete"
        raise refute(exchange, text, expected="no status 2", got=", ".join(map(str, told)))
    probe.measured["status"] = float(told[-1])


def _tolerance(probe: Probe, command: Command) -> None:
    for sent, turns, wanted in ((50, 80 / 360, 0), (50, 100 / 360, 1), (200, 270 / 360, 0), (200, 380 / 360, 1)):
        _prepare(probe, 1)
        probe.do(command, {"stall_tolerance": sent})
        exchange = _held_move(probe, turns)
        text = f"with a tolerance of {sent * 1.8:g} degrees the shaft lags behind by {turns * 360:.0f}"
        _expect(probe, exchange, wanted, text)
        world.hold(probe, False)
        probe.do(Verb.RELEASE_PROTECTION)
        probe.do(Verb.ENABLE, {"enabled": 1})
        motion.stand_still(probe)
