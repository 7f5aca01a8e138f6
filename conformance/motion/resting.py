"""Noise of a drive and its line, measured by reads alone on a shaft that rests."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analyzer.catalogue import Verb
from conformance.claim import Inconclusive
from conformance.motion import motion
from conformance.talk.noise import QUIET, Noise

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

_TIMES = 12
#: Bytes that a line shows while nothing sends, and how many of them at most.
_IDLE, _MOST_STRAY = b"\x00\xff", 2
#: A shaft that turns is not at rest, in rpm.
_RESTS = 5.0


def measure(probe: Probe) -> Noise:
    """Return the noise of a drive that rests; none where it turns or its reads do not work."""
    try:
        stray = _stray(probe)
        probe.noise = Noise(stray=stray)
        places = [motion.position(probe).value for _ in range(_TIMES)]
        speeds = [motion.speed(probe).value for _ in range(_TIMES)]
        loop = [_angle_error(probe) for _ in range(_TIMES)]
        volts = [motion.volts(probe) for _ in range(_TIMES)]
    except Inconclusive:
        return QUIET
    if max(map(abs, speeds)) > _RESTS:
        return Noise(stray=stray)
    return Noise(_half_span(places), max(loop), max(map(abs, speeds)), _half_span(volts), stray)


def _half_span(values: list[float]) -> float:
    return (max(values) - min(values)) / 2


def _angle_error(probe: Probe) -> float:
    """Return how far from its target the shaft says that it is, in degrees; 0 where nothing tells it."""
    command = probe.dialect.by_verb.get(Verb.READ_ANGLE_ERROR)
    if command is None:
        return 0.0
    field = command.reply_forms[0].layout.named["angle_error"]
    return abs(float(field.physical(probe.read(command, "angle_error"))))


def _stray(probe: Probe) -> bytes:
    """Return the bytes of an idle line that come before every reply."""
    if probe.dialect.bus == "can":
        return b""
    found: set[bytes] = set()
    for _ in range(_TIMES):
        exchange = probe.ask(motion.reads_position(probe.dialect), quiet_ns=0)
        answer = exchange.reply
        if answer is None:
            return b""
        found.add(exchange.received[: max(0, exchange.received.find(answer.data))])
    stray = found.pop() if len(found) == 1 else b""
    return stray if 0 < len(stray) <= _MOST_STRAY and not stray.strip(_IDLE) else b""
