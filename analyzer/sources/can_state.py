"""The state of a CAN controller in text: what `ip -details -statistics link show`, the kernel and programs say of it.

    can state ERROR-PASSIVE (berr-counter tx 128 rx 0) restart-ms 0          ip
    [ 6609.448256] mttcan c310000.mttcan can0: entered error warning state   the kernel
    write: No buffer space available                                         a program that sends
    tx_err=128 rx_err=0                                                      a library, of its counters

Each becomes an error frame with SocketCAN's classes, as an adapter that reports errors sends it. A controller that is active
and has never been off the bus is none. Frames of candump or in words between them are read as well.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from analyzer.records import CanFrame, Comment
from analyzer.sources import can_text, candump
from analyzer.sources.lines import Lines, head_lines
from analyzer.sources.source import Source
from analyzer.sources.stamps import ANY
from analyzer.sources.times import number_ns

_CONTROLLER, _PROTOCOL, _NO_ACK, _BUS_OFF, _BUS_ERROR = 0x04, 0x08, 0x20, 0x40, 0x80
#: What ip calls the states, with the class and the second byte of the error frame, for a sender and for a receiver.
_STATES = {"ERROR-WARNING": (_CONTROLLER, 0x08, 0x04), "ERROR-PASSIVE": (_CONTROLLER, 0x20, 0x10), "BUS-OFF": (_BUS_OFF, 0, 0)}
_IP = re.compile(
    rf"\bcan\s+(?:<[\w,-]*>\s+)?state\s+(?P<state>ERROR-ACTIVE|STOPPED|SLEEPING|{'|'.join(_STATES)})\b"
    r"(?:\s+\(berr-counter tx (?P<sent>\d+) rx (?P<received>\d+)\))?"
)
_COUNTS = re.compile(r"\s*re-started\s+bus-errors\s+arbit-lost\s+error-warn\s+error-pass\s+bus-off\s*")
_SIX = re.compile(r"(?:\s*\d+){5}\s+(\d+)\s*")
#: A state that is not said to be none: `bus_off: 0`.
_OFF = r"(?<![^\W_])bus[- _]?off\b(?!\s?[=:]\s?(?:0|no|false)\b)(?!.*(?:recover|restart))"
#: The name of an interface with what a driver says of it; the first that fits counts. What ESP-IDF logs is no program.
_DRIVER = r"(?:\b(?:sl)?can\d+:?\s.*|^(?!.*(?:[;{}&#]|=(?!\d)|=0\b|//|\b(?:if|case)\b)).*\btwai\w*\b.*)"
_FLAGS = r"\b(?:FLT_CONF|(?:ACK|CRC|STF|STUFF|FRM|FORM|BIT[01])_?ERR(?:OR)?)\b"
#: A line that tells a state by flags, and is none of a program.
_STATED, _NO_CODE = r"^(?=.*\b(?:state|status|flags?|errors?|FLT_CONF)\b)[^;{}()=&#]*", r"\b[^;{}()=&#]*$"
_SAID: tuple[tuple[re.Pattern[str], int, str], ...] = tuple(
    (re.compile(pattern, re.IGNORECASE), number, data)
    for pattern, number, data in (
        (rf"{_DRIVER}{_OFF}", _BUS_OFF, ""),
        # The number of ESP-IDF's state, and what firmware alerts.
        (r"^(?!.*[;{}&#]).*\btwai\w*\b.*\bstate\s?[=:]\s?2\b", _BUS_OFF, ""),
        (rf"^(?!.*[;{{}}&#\"'])(?!.*\b(?:if|case)\b).*\b(?:alerts?|state|status)\s?[=:]\s*(?:\w+_)?{_OFF}", _BUS_OFF, ""),
        (rf"{_DRIVER}(?<![^\W_])error[-_ ]passive\b(?!\s*->)", _CONTROLLER, "00 30"),
        (rf"{_DRIVER}\berror[-_ ]warning\b(?!\s*->)", _CONTROLLER, "00 0C"),
        (rf"{_DRIVER}\bbit ?1 error\b", _PROTOCOL | _BUS_ERROR, "00 00 10"),
        (rf"{_DRIVER}\bbit ?0 error\b", _PROTOCOL | _BUS_ERROR, "00 00 08"),
        (rf"{_DRIVER}\bstuff(?:ing)? error\b", _PROTOCOL | _BUS_ERROR, "00 00 04"),
        (rf"{_DRIVER}\b(?:form|format|crc) error\b", _PROTOCOL | _BUS_ERROR, "00 00 02"),
        (rf"{_DRIVER}\back(?:nowledge\w*)? ?error\b", _NO_ACK | _BUS_ERROR, ""),
        (rf"{_DRIVER}\bcan bus error\b", _BUS_ERROR, ""),
        # What programs for an ESP32, and firmware of adapters, print.
        (r"^[^;\"']*\berror has occurred on the bus\b", _BUS_ERROR, ""),
        (r"^[^;\"']*\bcontroller (?:has become|is|entered) (?:the )?error[- ]passive\b", _CONTROLLER, "00 30"),
        (r"^[^;\"']*(?:\bcontroller (?:has become|is|went|entered) |\()(?:the )?bus[- ]off\b", _BUS_OFF, ""),
        (r"\bNo buffer space available\b", _CONTROLLER, "00 02"),
        # What firmware calls its flags, the state last.
        (rf"{_STATED}{_FLAGS}.*\bbus[- _]?off{_NO_CODE}", _BUS_OFF, ""),
        (rf"{_STATED}\b(?:STF|STUFF)_?ERR(?:OR)?{_NO_CODE}", _PROTOCOL | _BUS_ERROR, "00 00 04"),
        (rf"{_STATED}\b(?:FRM|FORM)_?ERR(?:OR)?{_NO_CODE}", _PROTOCOL | _BUS_ERROR, "00 00 02"),
        (rf"{_STATED}\bBIT1_?ERR(?:OR)?{_NO_CODE}", _PROTOCOL | _BUS_ERROR, "00 00 10"),
        (rf"{_STATED}\bBIT0_?ERR(?:OR)?{_NO_CODE}", _PROTOCOL | _BUS_ERROR, "00 00 08"),
    )
)
#: The counters of errors, as programs print them; the other may stand in the next line.
_COUNTERS = re.compile(
    r"\b(?:(?:t[xd]|transmit)[\s_-]?err(?:or)?s?(?:[\s_-]?(?:counter|count|cnt))?|TEC)\W{1,3}(?P<sent>\d{1,3})\b"
    r"(?:\W{1,4}(?:(?:rx|receive)\w*(?:[\s_-]?err(?:or)?s?)?(?:[\s_-]?(?:counter|count|cnt))?|REC)\W{1,3}(?P<received>\d{1,3})\b)?"
    r"|\brd[\s_-]?err(?:or)?\W{1,3}(?P<alone>\d{1,3})\b",
    re.IGNORECASE,
)
_WARNING, _PASSIVE = 96, 128
#: What candump says below an error frame, as far as that frame itself is not there.
_EXPLAINED = tuple(
    (re.compile(pattern), number, data)
    for pattern, number, data in (
        (r"^\s*no-acknowledgement-on-tx\b", _NO_ACK, ""),
        (r"^\s*protocol-violation\{\{[^}]*\bbit-stuffing-error\b", _PROTOCOL, "00 00 04"),
        (r"^\s*protocol-violation\{\{[^}]*\bframe-format-error\b", _PROTOCOL, "00 00 02"),
        (r"^\s*bus-off\s*$", _BUS_OFF, ""),
    )
)
_KERNEL_TIME = re.compile(r"\[\s*(\d{1,9}\.\d{1,9})\]")
_TIMED = re.compile(rf"\s*[\[(]?\s*(?:{ANY})(?![\w.])")
_LONGEST_LINE = 1000
_SAMPLE_LINES = 400
_LARGEST_BYTE = 0xFF


def score(head: bytes) -> float:
    """Say how sure it is that this text tells the state of a controller, 0..1."""
    lines = [line for line in head_lines(head)[:_SAMPLE_LINES] if len(line) <= _LONGEST_LINE]
    explained = _explained(lines)
    if not any(_IP.search(line) or _said(line, explained) is not None or _counted(line) is not None for line in lines):
        return 0.0
    # A word on the controller may stand in a capture of any format, as a comment; it takes no times from it, and no bytes.
    frames = [line for line in lines if _frame(line) is not None]
    return 0.96 if frames and not any(_TIMED.match(line) for line in frames) else 0.54


def read(source: Source) -> Iterator[CanFrame | Comment]:
    """Read the lines one by one."""
    if not score(source.head):
        source.problem("expected lines of ip, the kernel or a program on the state of a CAN controller, got none")
        return iter(())
    source.note("the state of a CAN controller is told in words: each such line is read as an error frame")
    return _records(source)


def _records(source: Source) -> Iterator[CanFrame | Comment]:
    lines = Lines(source)
    explained = _explained(head_lines(source.head)[:_SAMPLE_LINES])
    counts = off = False
    for text in lines:
        found = _IP.search(text) if len(text) <= _LONGEST_LINE else None
        frame = _state(found) if found is not None else _said(text, explained) if len(text) <= _LONGEST_LINE else None
        if found is not None:
            off = found["state"] == "BUS-OFF"
        elif counts and not off and (six := _SIX.fullmatch(text)) is not None and int(six[1]):
            frame = _error(_BUS_OFF, b"")
        elif frame is None and len(text) <= _LONGEST_LINE:
            frame = _counted(text)
        counts = _COUNTS.fullmatch(text) is not None
        if frame is None:
            frame = _frame(text)
        if frame is None:
            if text.strip():
                yield source.comment(None, text)
            continue
        time = _KERNEL_TIME.search(text) if frame.error else None
        yield CanFrame(
            number_ns(time[1]) if time is not None else frame.t_ns, source.port(frame.port or None), frame.id, frame.data,
            frame.direction, frame.extended, frame.remote, frame.error, frame.fd,
        )  # fmt: skip


def _state(found: re.Match[str]) -> CanFrame | None:
    """Return the error frame of a state, with the counters of errors."""
    if found["state"] not in _STATES:
        return None
    number, sending, receiving = _STATES[found["state"]]
    sent, received = (min(int(found[name] or 0), _LARGEST_BYTE) for name in ("sent", "received"))
    kind = sending if sent > received else receiving if received > sent else sending | receiving
    return _error(number, bytes((0, kind, 0, 0, 0, 0, sent, received)))


def _counted(text: str) -> CanFrame | None:
    """Return the error frame of counters that a program prints, where one of them is high."""
    found = _COUNTERS.search(text)
    sent = min(int(found["sent"] or 0), _LARGEST_BYTE) if found else 0
    received = min(int(found["received"] or found["alone"] or 0), _LARGEST_BYTE) if found else 0
    if max(sent, received) < _WARNING:
        return None
    kind = (0x20 if sent >= _PASSIVE else 0x08) if sent >= received else (0x10 if received >= _PASSIVE else 0x04)
    return _error(_CONTROLLER, bytes((0, kind, 0, 0, 0, 0, sent, received)))


def _explained(lines: Sequence[str]) -> bool:
    """Say whether candump's words on an error frame stand without that frame."""
    if not any(said.search(line) for line in lines for said, _, _ in _EXPLAINED):
        return False
    return not any(frame.error for line in lines if (frame := _frame(line)) is not None)


def _said(text: str, explained: bool) -> CanFrame | None:
    """Return the error frame of what a driver or a program says; `explained`: or of candump's words."""
    table = _SAID + _EXPLAINED * explained
    return next((_error(number, bytes.fromhex(data)) for said, number, data in table if said.search(text)), None)


def _error(number: int, data: bytes) -> CanFrame:
    return CanFrame(None, "", number, data.ljust(8, b"\0"), error=True)


def _frame(text: str) -> CanFrame | None:
    """Return the frame of a line that candump or a program prints."""
    return candump.frame_of(text) or can_text.frame_of(text)
