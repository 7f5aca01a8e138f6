"""What to look at when a scan found nothing, or something odd: hints for whoever stands before the machine."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from conformance.tools.scan import Report

_SERIAL_SILENCE = (
    "wiring: is the drive powered, A to A and B to B, and a common ground? Makers name A and B differently: swap them once",
    "address and rate: the drive's menu shows them (MKS: UartAddr, UartBaud); --addresses and --rates widen the search",
    "mode: an MKS drive answers native frames or Modbus, as its Mb_RTU says, never both; both were asked"
    " unless --dialects said otherwise",
    "adapter: has it RS485, not RS232 or TTL, and does it switch its direction by itself?",
    "another program on the same port, or a second host on the bus, takes the answers away",
)
_CAN_SILENCE = (
    "wiring: is the drive powered, H to H and L to L, and a common ground?",
    "termination: 120 ohm at both ends of the bus (60 ohm between H and L with the power off)",
    "bit rate and ID: the drive's menu shows them (CanRate, CanID); a bus at the wrong rate is silent",
    "bus state: ip -details link show can0 says ERROR-PASSIVE or BUS-OFF where nobody acknowledges",
)


def hints(report: Report) -> list[str]:
    """Return what to look at, the likeliest first; empty where drives answered and nothing is odd."""
    from conformance.tools.scan import Look

    told: list[str] = []
    looks = Counter(h.look for h in report.heard)
    if report.stopped:
        told.append("end the other host, or look at what is said: servotap record ENDPOINT; --busy asks all the same")
        return told
    if report.echoes:
        told.append("the adapter hands back what it sends (its receiver stays on): that was left out")
    crowded = Counter((f.dialect.bus, f.address, f.speed) for f in report.found)
    for (_, address, _), count in crowded.items():
        names = sorted({f.dialect.name for f in report.found if f.address == address})
        if count > 1:
            told.append(f"address {address} answers in {' and '.join(names)}: two drives have one address")
    odd = [f for f in report.found if f.wrong]
    told += [f"{f.name}: {f.wrong}: two drives of one address, or a poor line (termination, ground)" for f in odd]
    if looks[Look.LOW] and not report.found:
        told.append("the line was heard low for long: A and B are swapped, or there is no bias (termination, pull-up)")
    if looks[Look.WRONG_RATE] and not report.found:
        told.append("bytes came that are no frames: a drive at another rate, two drives of one address, or a poor line")
    if looks[Look.OTHER_DIALECT]:
        told.append("frames of another dialect came: name it with --dialects, or leave that out")
    if looks[Look.REQUEST]:
        told.append("another host sends on this bus: the answers may have been to it")
    if not report.found:
        told += _CAN_SILENCE if report.kind == "can" else _SERIAL_SILENCE
    return told
