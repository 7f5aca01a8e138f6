"""Restarting a drive: by its own command, or by cutting the power of an emulated one, and waiting until it answers again.

    restart(probe)        41: answered, then silent for a while, then there again
    power_cycle(probe)    emulated drives only

Rules kept here:
- How long a restart takes is not printed; real drives were seen to take two seconds. It is waited for ten.
- What does not come back raises Inconclusive.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analyzer.catalogue import Verb
from conformance.claim import Inconclusive
from conformance.claims.answers import plain_read
from conformance.motion.motion import MS, SECOND_NS
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: A restarting drive hears nothing for a while; asking at once would only make the first read be waited for in vain.
DEAF_NS = 300 * MS
LIMIT_NS = 10 * SECOND_NS


def restart(probe: Probe, *, address: int | None = None) -> Exchange:
    """Restart the drive and wait until it answers. Raises Inconclusive where it refuses or does not come back."""
    exchange = probe.do(Verb.RESTART) if address is None else probe.ask(Verb.RESTART, address=address)
    probe.wait(DEAF_NS)
    wait_for(probe, address=address)
    return exchange


def wait_for(probe: Probe, *, address: int | None = None, look_ns: int | None = None) -> int:
    """Wait until the drive answers a read, and return how long that took (ns).

    `look_ns`: how long each read is waited for; by default as long as any, for the drive may be moving by then.
    Raises Inconclusive after ten seconds.
    """
    read = plain_read(probe.dialect)
    begun_ns = probe.gate.now_ns()
    while True:
        exchange = probe.ask(read, address=address, timeout_ns=look_ns)
        if any(a.message.frame.checksum_ok and a.command is not None for a in exchange.answers):
            return probe.gate.now_ns() - begun_ns
        if probe.gate.now_ns() - begun_ns > LIMIT_NS:
            raise Inconclusive("the drive does not answer within ten seconds of a restart")
        if look_ns is not None:
            probe.wait(look_ns)


def power_cycle(probe: Probe) -> None:
    """Switch an emulated drive off and on."""
    drive = probe.drive
    if drive is None:
        raise Inconclusive("only an emulated drive's power can be cut from here")
    drive.power_cycle(probe.gate.now_ns())
    wait_for(probe)
