"""Calibration: what is answered, what the status says meanwhile, and what a held shaft makes of it.

A calibration turns the shaft without a bound and with torque, so these claims run on a real drive only when they are named.

Rules kept here:
- Here 0 says that it goes on, 1 that it is done and 2 that it failed.
- The manual gives no time; a minute is waited.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims import world
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import motion_claim, refute
from conformance.motion import motion, moves
from conformance.motion.motion import MS, SECOND_NS
from conformance.talk.probe import Probe, Until

_LIMIT_NS = 60 * SECOND_NS
_CALIBRATING, _STOPPED = 6, 1
_AT_ONCE = "calibration-answers-1"


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about calibration."""
    command = dialect.by_verb[Verb.CALIBRATE]
    made = partial(motion_claim, dialect, command, by_name=True)
    yield made("status", "While calibrating F1 reads 6, and afterwards 1.", "another status", _status)
    if moves.tells(dialect):
        quirks = known(dialect, _AT_ONCE)
        yield made("replies", "A calibration is answered by 0 when it begins and by 1 when it is done.", "others",
                   _replies, quirks=quirks)  # fmt: skip
        yield made(
            "held", "A calibration whose shaft is held is answered by 0 and then by 2.", "others", _held,
            emulated=True, quirks=quirks,
        )  # fmt: skip


def _status_now(probe: Probe) -> int:
    return probe.read(Verb.READ_STATUS, "status")


def _wait(probe: Probe) -> None:
    """Wait until the status is no longer that of a calibration."""
    moves.watch(probe, lambda: _status_now(probe) != _CALIBRATING, every_ns=500 * MS, limit_ns=_LIMIT_NS)


def _status(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    exchange = probe.ask(command)
    probe.reply(exchange)
    probe.wait(SECOND_NS)
    during = _status_now(probe)
    _wait(probe)
    probe.wait(2 * SECOND_NS)
    after = _status_now(probe)
    if (during, after) != (_CALIBRATING, _STOPPED):
        text = "the status does not tell of a calibration and of its end"
        raise refute(exchange, text, expected="6, then 1", got=f"{during}, then {after}")


def _answers(probe: Probe, command: Command) -> tuple[list[int], bool]:
    """Calibrate; return all statuses that were told, and whether the first came while the calibration had just begun."""
    since = len(probe.traffic)
    exchange = probe.ask(command, until=Until.TIMEOUT, timeout_ns=3 * SECOND_NS)
    under_way = _status_now(probe) == _CALIBRATING
    if exchange.silent and not under_way:
        raise Inconclusive("the calibration is not answered and does not begin")
    until_ns = probe.gate.now_ns() + _LIMIT_NS
    # Listened to, not asked, for as long as an end may still be told: a request could collide with it.
    while probe.gate.now_ns() < until_ns and not _told(probe, since, command) & {1, 2}:
        probe.wait(2 * SECOND_NS)
    _wait(probe)
    probe.wait(2 * SECOND_NS)
    told = [a.values["status"] for a in moves.told(probe.traffic[since:], command)]
    return told, under_way and not exchange.silent


def _told(probe: Probe, since: int, command: Command) -> set[int]:
    return {a.values["status"] for a in moves.told(probe.traffic[since:], command)}


def _expect(probe: Probe, command: Command, wanted: list[int]) -> None:
    motion.ready_to_move(probe)
    told, soon = _answers(probe, command)
    if told == [1] and soon and _AT_ONCE in probe.claim.quirks:
        probe.meets(_AT_ONCE)
    elif told != wanted:
        listed = [", ".join(map(str, each)) or "none" for each in (wanted, told)]
        text = "a calibration is answered otherwise"
        raise refute(probe.traffic[-1], text, expected=listed[0], got=listed[1])


def _replies(probe: Probe, command: Command) -> None:
    _expect(probe, command, [0, 1])


def _held(probe: Probe, command: Command) -> None:
    world.hold(probe)
    _expect(probe, command, [0, 2])
