"""What binary captures begin with. A beginning is looked at before the module of its format is loaded.

pcap and pcapng say by it in which order the bytes of their numbers stand, and pcap in which unit the fractions of its times.
"""

from __future__ import annotations

MCAP = b"\x89MCAP0\r\n"
BLF = b"LOGG"
MF4 = (b"MDF     ", b"UnFinMF ")
#: Beginning -> byte order, nanoseconds of the fraction's unit.
PCAP = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
#: The beginning of a section, and what stands at its byte 8 -> byte order.
PCAPNG = b"\x0a\x0d\x0d\x0a"
PCAPNG_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}


def of_pcapng(head: bytes) -> bool:
    """Say whether a section of pcapng begins so."""
    return head.startswith(PCAPNG) and head[8:12] in PCAPNG_ORDERS


def begins(format: str, head: bytes) -> bool | None:
    """Say whether a capture of a format begins so; None where no few bytes tell."""
    if format == "pcapng":
        return of_pcapng(head)
    beginnings = _BEGINNINGS.get(format)
    return None if beginnings is None else head.startswith(beginnings)


_BEGINNINGS = {"mcap": (MCAP,), "pcap": tuple(PCAP), "blf": (BLF,), "mf4": MF4}
