"""Pastes of traffic that is well, or that is no capture: nothing is accused."""

from __future__ import annotations

import json

import pytest

from analyzer.cli import main
from analyzer.sources.prose import quotations

#: By what they are: posts, logs of programs, frames of other makers.
HEALTHY = {
    "a question about one frame": 'Can the bytes be shown? I would like "11 06 00 01 00 03 9A 9B", even if nothing answers.',
    "a frame of a document": "Request: `01 03 00 6B 00 03 74 17`\n\nThe silent interval is 3.5 characters.",
    "a log of a server that is cut": "2020-03-23 08:32:31,295 DEBUG ModbusRTUTransport - Request: 01 03 00 00 00 05 85 C9\n"
    "2020-03-23 08:32:31,296 DEBUG FastByteArrayInputStream - count=6 pos=0",
    "bytes of a frame explained in bullets": "Send Hex Data 01 03 00 00 00 02 C4 0B\n\n- 01 - Slave\n- 03 - Read\n- 00\n"
    "- 00\n- 00\n",
    "words of two letters before bytes": "I send FA 01 32 2D and it will be FB 01 32 00 00 2E\n"
    "I send FA 01 32 2D and it will be FB 01 32 00 01 2F",
    "a library that loses a reply": "[10:00:01.000] TX: 01 03 00 00 00 01 84 0A\n[10:00:01.020] RX: 01 03 02 00 05 78 47\n"
    "[10:00:02.500] Error: No response received (timeout)",
    "labels that touch their bytes": "[DEBUG] request frame:01 03 00 00 00 02 C4 0B\n"
    "[DEBUG] response frame:01 03 04 00 01 00 02 2A 32",
    "a log of a server, with its replies before their check": "slave: Received: 01 03 00 00 00 02 C4 0B\n"
    "slave: Response: 01 03 04 00 01 00 02\nslave: Sent: 01 03 04 00 01 00 02 2A 32",
    "a program that prints a message and then its frame": "Message: 01 03 00 00 00 0A\nSent frame: 01 03 00 00 00 0A C5 CD\n"
    "Message: 01 03 04 00 01 00 02\nReceived frame: 01 03 04 00 01 00 02 2A 32",
    "a reply in two reads, the first of three bytes": "[10:00:00][D][uart_debug:114]: >>> 01:03:00:00:00:04:44:09\n"
    "[10:00:00][D][uart_debug:114]: <<< 01:03:08\n"
    "[10:00:00][D][uart_debug:114]: <<< 00:01:00:02:00:03:00:04:0D:14",
    "frames with a head and a tail": "".join(f"RX: 02 FF 30 31 32 3{n} 03\n" for n in range(4)),
    "an adapter for cars": "".join(f">010{n}\n7E80341{n:02X}0D\n\n" for n in range(8)),
    "exchanges of another maker": "TX: A0 A0 00 01 21 01\nRX: A0 A0 00 02 21 02 03\n" * 4,
}


def verdict(text, tmp_path, capsys):
    path = tmp_path / "paste.txt"
    path.write_text(text, "utf-8")
    main(["diagnose", "--json", str(path)])
    found = json.loads(capsys.readouterr().out)
    return found["verdict"], [cause["cause"] for cause in found["causes"]]


@pytest.mark.parametrize("text", HEALTHY.values(), ids=HEALTHY.keys())
def test_what_is_well_is_not_accused(text, tmp_path, capsys):
    assert verdict(text, tmp_path, capsys)[1] == []


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("I send 01 03 00 00 00 05 85 C9 and nothing comes back.", "no_reply"),
        ("TX: 01 03 00 00 00 05 85 C9", "no_reply"),
        ("TX: 01 03 00 00 00 01 84 0A\nError: No response received (timeout)", "no_reply"),
        ("> 01 03 00 00 00 0A\n> 01 03 00 00 00 0A", "missing_checksum"),
    ],
)
def test_what_is_missed_is_told(text, cause, tmp_path, capsys):
    assert verdict(text, tmp_path, capsys)[1][:1] == [cause]


def test_a_log_of_a_server_is_read_from_the_other_side(tmp_path, capsys):
    log = "Received: 01 03 00 00 00 02 C4 0B\nSent: 01 03 04 00 01 00 02 2A 32\n" * 2
    assert verdict(log, tmp_path, capsys) == ("ok", [])


@pytest.mark.parametrize(
    ("line", "data"),
    [
        ("the frame:01 03 00 00 00 02 C4 0B", "01 03 00 00 00 02 c4 0b"),
        ("it will be FB 01 32 00 00 2E", "fb 01 32 00 00 2e"),
        # In small letters nothing tells a word from a byte.
        ("it sends be fb 01 32 00 00 2e", "be fb 01 32 00 00 2e"),
        ("the card ab:cd:01:02:03:04", ""),
        ("Writing (expecting 7 bytes back): FA 01 32 2D", "fa 01 32 2d"),
        ("expected FB 01 32 00 00 2E", ""),
    ],
)
def test_where_bytes_begin_in_a_sentence(line, data):
    assert [each.data.hex(" ") for each in quotations(line)] == [data][: bool(data)]
