"""Faults of the line that a drive was tested on, as far as refuted claims show them.

Claims send wrong frames on purpose. So only findings about replies and about the line itself count here. Requests that are no
frames are left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.diagnosis.diagnose import cause_lines, of_traffic
from analyzer.diagnosis.reader import Reader
from analyzer.diagnosis.scene import Confidence
from analyzer.records import CanFrame, Chunk
from conformance.suite.record import VerdictRecord

#: Causes that no claim makes by itself.
_OF_THE_LINE = frozenset(
    ("wrong_baud", "inverted_lines", "wrong_parity", "lost_start", "leading_glitch", "trailing_glitch", "duplicate_address",
     "two_masters", "can_no_ack", "can_bus_off", "can_bit_errors", "can_wrong_bitrate")
)  # fmt: skip
#: A line that is bad spoils most of what fails; less is the drive's.
_LEAST_SHARE = 0.5
#: Records of a drive that are looked at, and the time between two claims.
_MOST = 1000
_PAUSE_NS = 1_000_000_000


def line_causes(records: Iterable[VerdictRecord]) -> Iterator[str]:
    """Yield what is wrong with the lines of the drives, for people."""
    refuted: dict[tuple[str, str], list[VerdictRecord]] = {}
    for record in records:
        if record.refuted and record.traffic:
            refuted.setdefault((record.target, record.dialect), []).append(record)
    for (target, name), own in refuted.items():
        found = of_traffic(_items(own), [dialects.get(name)])
        told = [
            each
            for each in found.causes
            if each.suspicion.cause in _OF_THE_LINE
            and each.suspicion.confidence is not Confidence.POSSIBLE
            and each.share >= _LEAST_SHARE
        ]
        if told:
            yield f"the line of {target}, as the failed claims show it:"
        for number, each in enumerate(told, 1):
            yield from cause_lines(number, each)


def _items(records: Iterable[VerdictRecord]) -> list[Chunk | CanFrame]:
    """Return the traffic of claims, one behind the other."""
    items: list[Chunk | CanFrame] = []
    now_ns = 0
    for record in records:
        if len(items) >= _MOST:
            break
        shift_ns = now_ns - min(each.t_ns for each in record.traffic)
        for each in record.traffic:
            role = Role.REQUEST if each.sent else Role.REPLY
            reader = Reader.of_bus("serial" if each.can_id is None else "can")
            if each.sent and reader.best(each.data, each.can_id, role) is None:
                continue
            t_ns = each.t_ns + shift_ns
            now_ns = max(now_ns, t_ns + _PAUSE_NS)
            if each.can_id is None:
                items.append(Chunk(t_ns, "bus", each.data, role, True))
            else:
                items.append(CanFrame(t_ns, "can", each.can_id, each.data, role, each.extended))
    return items
