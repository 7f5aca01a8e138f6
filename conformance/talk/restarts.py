"""Restarting a drive, by its own command or by cutting the power of an emulated one, and waiting until it answers again.

Rules kept here:
- No manual says how long a restart takes; real drives were seen to take two seconds. Ten seconds are waited for.
- A drive that does not come back raises Inconclusive.
- A drive that keeps a zero for power-on goes back to it first, and tells so: what comes behind a restart waits for the end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analyzer.catalogue import Verb
from analyzer.protocols.mks_shared import ZeroStatus
from conformance.claim import Inconclusive
from conformance.talk import settings
from conformance.talk.acceptance import is_there
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

_SECOND_NS = 1_000_000_000
#: A restarting drive hears nothing for a while; a read at once would only be waited for in vain.
DEAF_NS = 250_000_000
LIMIT_NS = 10 * _SECOND_NS


#: How long the way back to a kept zero may take: less than a turn, at 30 rpm at the slowest. Between two looks at it.
BACK_NS, _LOOK_NS = 5 * _SECOND_NS, 20_000_000


def restart(probe: Probe, *, arrives: bool = True) -> Exchange:
    """Restart the drive and wait until it answers. Raises Inconclusive where it refuses or does not come back.

    `arrives`: wait for the end of the way back to a kept zero, too.
    """
    exchange = probe.do(Verb.RESTART)
    wait_for_answer(probe, arrives=arrives)
    return exchange


def power_cycle(probe: Probe) -> None:
    """Switch an emulated drive off and on, and wait until it answers. Raises Inconclusive for a real one."""
    if probe.drive is None:
        raise Inconclusive("only an emulated drive's power can be cut from here")
    probe.drive.power_cycle(probe.gate.now_ns())
    wait_for_answer(probe, deaf_ns=0)


def wait_for_answer(
    probe: Probe, *addresses: int, deaf_ns: int = DEAF_NS, limit_ns: int = LIMIT_NS, arrives: bool = True
) -> None:
    """Wait until a drive that restarts answers, at its address or one of these. Raises Inconclusive where it does not.

    `arrives`: as `restart` takes it.
    """
    begun_ns = probe.gate.now_ns()
    probe.wait(deaf_ns)
    while probe.gate.now_ns() - begun_ns <= limit_ns:
        for address in addresses or (probe.address,):
            if is_there(probe, address):
                if arrives:
                    wait_for_arrival(probe, address)
                return
    raise Inconclusive(f"the drive does not answer within {limit_ns // _SECOND_NS} s of a restart")


def wait_for_arrival(probe: Probe, address: int) -> None:
    """Wait while a drive says that it is on the way back to a kept zero."""
    read = probe.dialect.by_verb.get(Verb.READ_ZERO_STATUS)
    until_ns = probe.gate.now_ns() + BACK_NS
    while read is not None and probe.gate.now_ns() < until_ns:
        answer = probe.ask(read, address=address, quiet_ns=0).reply
        if answer is None or answer.values.get("status") != ZeroStatus.GOING:
            return
        probe.wait(_LOOK_NS)


def need_axis_lock(probe: Probe) -> None:
    """Raise Inconclusive where a drive is set to let its shaft go at power-on: a kept run turns nothing then."""
    command = probe.dialect.by_verb.get(Verb.SET_AXIS_LOCK)
    if command is not None and (settings.read_back(probe, command)[0] or {}).get("axis_lock") == 0:
        raise Inconclusive("the drive lets its shaft go at power-on: set axis_lock to 1")
