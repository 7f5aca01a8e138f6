"""Pastes of traffic that is well, or that is no capture: nothing is accused."""

from __future__ import annotations

import json

import pytest

from analyzer.cli import main
from analyzer.sources.prose import quotations
from tests.diagnosis.test_pastes import checked

#: By what they are: posts, logs of programs, frames of other makers.
HEALTHY = {
    "a host that asks which parameters a drive has": "  can0  001   [3]  00 82 83\n  can0  001   [3]  82 05 88\n"
    "  can0  001   [3]  00 80 81\n  can0  001   [4]  80 FF FF 7F\n",
    "times of a library beside floats": "".join(
        f"2025-07-08 10:20:0{n}.28{n} DEBUG [pymodbus.logging] {what}\n"
        for n, what in enumerate(
            (
                "send: 0x3 0x4 0x0 0x31 0x0 0x3 0xe0 0x26",
                "recv: 0x3 0x4 0x6 0x0 0x0 0x0 0x0 0x12 0x40 0x74 0xa3 extra data:  addr=None",
                "Processing: 0x3 0x4 0x6 0x0 0x0 0x0 0x0 0x12 0x40 0x74 0xa3",
            )
        )
    ),
    "headings between dashes": "".join(
        f"--- sent ---\nFA 02 3A 36\n--- received ---\nFB 02 3A 01 38\n--- sent ---\nFA 00 F6 00 4{n} 02 3{n + 2}\n"
        for n in range(3)
    ),
    "a question about one frame": 'Can the bytes be shown? I would like "11 06 00 01 00 03 9A 9B", even if nothing answers.',
    "a frame of a document": "Request: `01 03 00 6B 00 03 74 17`\n\nThe silent interval is 3.5 characters.",
    "a log of a server that is cut": "2020-03-23 08:32:31,295 DEBUG ModbusRTUTransport - Request: 01 03 00 00 00 05 85 C9\n"
    "2020-03-23 08:32:31,296 DEBUG FastByteArrayInputStream - count=6 pos=0",
    "bytes of a frame explained in bullets": "Send Hex Data 01 03 00 00 00 02 C4 0B\n\n- 01 - Slave\n- 03 - Read\n- 00\n"
    "- 00\n- 00\n",
    "letters that are digits for who sent": "".join(
        f"10:00:0{n}.000 B 02 04 00 32 00 01 90 36\n10:00:0{n}.010 E 02 04 02 00 0{n} {crc}\n"
        for n, crc in enumerate(("FD 30", "3C F0", "7C F1"))
    ),
    "a letter that is a digit for the drive": "".join(
        f"0.{n}00 M FA 02 31 2D\n0.{n}04 F FB 02 31 00 00 00 00 00 0{n} {0x2E + n:02X}\n" for n in range(4)
    ),
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
    "a sensor whose registers are round the other way": "SEND: 05 03 0A 00 00 03 07 97\n"
    "GET: 05 03 06 41 42 43 31 32 33 75 95\nSEND: 05 03 08 00 00 02 C7 EF\n"
    "GET: 05 03 04 01 04 02 02 7F 6F\nSEND: 05 03 21 00 00 01 8F B2\nGET: 05 03 02 14 00 46 84",
    "a server whose reply stands before its check": "Response:01 03 04 00 01 00 02\nSent: 01 03 04 00 01 00 02 2A 32",
    "a request that a server prints twice": "Parsing frame: 07 04 00 10 00 01 30 69\n"
    "<Frame (request): 07 04 00 10 00 01 30 69>\nIf I switch it off, nothing changes and I get the same.",
    "decimal and hexadecimal lines": "It should be:\n02 03 02 00 05 3C 47\nand it is:\n02 03 00 05 00 01 148 56",
    "a server for Modbus TCP": "ModbusServerTCP.h: Response:\n00 01 00 00 00 07 01 03 04 02 03 04 05\n"
    "00 02 00 00 00 07 01 03 04 02 03 04 05",
    "a library that compares the wrong bytes": "RX:02 05 00 03 FF 00 7C 09\nbuf <Buffer 02 05 00 03 00 01>\n"
    "Error: crc mismatch",
    "frames of another maker with zeros": "".join(
        f"[10:00:00.{n}00][D][controller]: received 05.60.{n}0.00.00.00.00.00.00.00.00.{n}6.B0 (13)\n" for n in (4, 8)
    ),
    "frames of one command of another maker": "".join(
        f"unknown: 71 6C D1 03 - A3 51 - 21 09 07 04 0C 0A {n:02X} 4{n} 3F\n    --- 1{n} 46\n" for n in (1, 2, 3)
    ),
    "frames with a head and a tail": "".join(f"RX: 02 FF 30 31 32 3{n} 03\n" for n in range(4)),
    "an adapter for cars": "".join(f">010{n}\n7E80341{n:02X}0D\n\n" for n in range(8)),
    "Modbus TCP that begins with a reply": "RECV: 0x0 0x18 0x0 0x0 0x0 0x5 0x1 0x3 0x2 0x0 0x1\n"
    "SEND: 0x0 0x19 0x0 0x0 0x0 0x6 0x1 0x3 0x10 0x23 0x0 0x1",
    "marks behind the name of a logger": "DEBUG:modbus_tk:-> 00-01-00-00-00-06-01-04-fa-01-00-01\n"
    "DEBUG:modbus_tk:<- 00-01-00-00-00-05-01-04-02-00-2a",
    "a float that was read rightly": "9608 is asked for: 01 04 04 43 60 25 88 F4 E8 --> 224.146606445, but nothing is shown.",
    "one number that would be rounder the other way": "TX: FA 02 F4 0B A7 F0 F0 45 7A FA 3B\n"
    "RX: FB 02 F4 01 F2\nRX: FB 02 F4 02 F3",
    "one number of three bytes that would be short the other way": "can0  002   [8]  F5 06 46 57 ED FC FF 82\n"
    "can0  002   [3]  F5 01 F8\ncan0  002   [3]  F5 02 F9\n",
    "a library that joins the parts of a reply": "send: 0x7 0x3 0x0 0x10 0x0 0x2 0xc5 0xa8\n"
    "recv: 0x7 0x3 0x4 0x1 0x2c\nProcessing: 0x7 0x3 0x4 0x1 0x2c\nFrame - not ready\nrecv: 0x3 0x8 0x5d 0x30\n"
    "Processing: 0x3 0x8 0x5d 0x30\nFrame - not ready\nGetting Frame - 0x3 0x4 0x1 0x2c 0x3 0x8\n"
    "Factory Response[ReadHoldingRegistersResponse: 3]",
    "a maker that confirms by the same bytes": "[10:00:01.000]TX: 86 FF FF BE\n[10:00:01.008]RX: 06 C3 00 D5\n"
    "[10:00:02.000]TX: 06 C3 00 D5\n[10:00:02.012]RX: 06 C3 00 D5\n",
    "an array of C whose sum comes later": "#include <SoftwareSerial.h>\nuint8_t tx[] = {0xFA, 0x04, 0xF3, 0x00, 0x00};\n"
    "void go(){ tx[4]=sum8(tx,4); Serial2.write(tx,5); }\nuint8_t ask[3] = {0xFA, 0x04, 0x32};\n",
    "constants of Python by the name of what they do": "import serial\nREAD = bytes([0xFA, 0x05, 0x30])\n"
    "def put(p, b): p.write(b + bytes([sum(b) & 0xFF]))\nput(serial.Serial('COM4'), READ)\n",
    "a test of a program": 'def test_sum_of_a_stop():\n    """Manual: FA 03 F7 CRC"""\n'
    '    assert low(bytes.fromhex("FA 03 F7")) == 0xF4\n',
    "the head of a frame, to which a function adds": 'def speed(value):\n    head = bytes.fromhex("3E A2 05 04 E9")\n'
    "    data = int(value).to_bytes(4, 'little')\n    return head + data + bytes([sum(data) & 0xFF])\n",
    "a line of JavaScript": "const ask = Buffer.from('fa02f300','hex'); port.write(Buffer.concat([ask, sum(ask)]));\n",
    "a line of C": "void f(){ uint8_t a[] = {0x02,0x06,0x00,0xF3,0x00,0x00}; uint16_t c = crc(a,6); put(a,c); }\n",
    "a recording of a wire that ends with a request": "Time [s],Value,Parity Error,Framing Error\n"
    + "".join(f"1.{n}00000,0x{byte:02X},,\n" for n, byte in enumerate(bytes.fromhex(checked("02 03 10 00 00 04")))),
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
        # A search that no drive answers.
        ("id 2: -> fa 02 30 2c ... timeout\nid 3: -> fa 03 30 2d ... timeout\nid 4: -> fa 04 30 2e ... timeout\n", "no_reply"),
        (
            "".join(f"{n}.0 TX {checked(f'{a:02X} 04 00 32 00 01')}\n{n}.4 no answer\n" for n, a in enumerate((3, 4, 5, 6))),
            "no_reply",
        ),
        # A program, with a log of it, or with a question.
        ("port.write(ask);\n" + "TX: FA 05 30\n" * 3, "missing_checksum"),
        ("uint8_t tx[] = {0xFA, 0x05, 0x30};\nSerial.write(tx, 3);\nWhy does nothing come back?", "missing_checksum"),
    ],
)
def test_what_is_missed_is_told(text, cause, tmp_path, capsys):
    assert verdict(text, tmp_path, capsys)[1][:1] == [cause]


def test_counters_that_fall_show_that_frames_get_through(tmp_path, capsys):
    log = "".join(
        f" (1.0{n}0000)  can0  20000088   [8]  00 00 04 00 00 00 {96 - 8 * n:02X} 00   ERRORFRAME\n" for n in range(5)
    )
    assert verdict(log, tmp_path, capsys)[1][:1] == ["can_bit_errors"]


def test_two_dialects_in_a_short_capture(tmp_path, capsys):
    log = "TX: FA 01 30 2B\n" * 2 + "TX: 01 04 00 32 00 01 90 05\nRX: 01 04 02 01 40 B9 50\n"
    assert verdict(log, tmp_path, capsys)[1][:1] == ["wrong_dialect"]


def test_bytes_behind_their_index(tmp_path, capsys):
    came = "".join(f"byte {n}: 0x{byte:02X}\n" for n, byte in enumerate(bytes.fromhex("010304000100022A32")))
    assert verdict(f"Sending: 01 03 00 00 00 02 C4 0B\n{came}", tmp_path, capsys) == ("ok", [])


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


@pytest.mark.parametrize(("ask", "causes"), [("Why do I get it in 3 buffers?", ["split_frame"]), ("It works well.", [])])
def test_one_byte_a_read_is_a_split_where_words_ask_about_it(ask, causes, tmp_path, capsys):
    log = "".join(f"<Buffer {byte:02x}>\n" for byte in bytes.fromhex("01 04 02 00 11 79 3C"))
    assert verdict(f"{ask}\nport.write(Buffer.from('0104003200019005','hex'))\n{log}", tmp_path, capsys)[1] == causes


def test_frames_of_another_maker_are_named_and_are_no_echo_of_each_other(tmp_path, capsys):
    log = "send A5 40 90 08 00 00 00 00 00 00 00 00 7D\nrecv A5 01 90 08 02 0A 00 00 75 30 02 F4 E5\n"
    assert verdict(log, tmp_path, capsys)[1] == ["unsupported_dialect"]


TCP = "SEND: 0x0 0x5 0x0 0x0 0x0 0x6 0x2 0x3 0x1 0x8 0x0 0x1\nRECV: 0x0 0x5 0x0 0x0 0x0 0x5 0x2 0x3 0x2 0x0 0x7\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('AT+CREG?\n+CREG: 2,1,"00FA","02C6B3D2",7\n\nOK\n', "no frame of a known dialect came: 1 stretch of bytes"),
        (TCP * 2, "no frame of a known dialect came: 4 stretches of bytes"),
        (
            "// an example\nuint8_t a[] = {0xFA, 0x02, 0x31, 0x2D};\nuint8_t b[] = {0xFA, 0x02, 0xF3, 0x00, 0x00};\n",
            "stand in a text",
        ),
        (
            "recv: 0x7 0x3 0x2 0x0 0x13 0x71 0x89\n"
            "send: 0x7 0x3 0x0 0x6b 0x0 0x1 0xf5 0xb0\nrecv: 0x7 0x3 0x2 0x0 0x13 0x71 0x89\n",
            "of no command of these drives; 1 thing among them",
        ),
        # The drives' own frames.
        ("> FA 01 30 2B\n< FB 01 30 00 00 00 00 20 00 4C\n< FB 01 77\n", "1 thing went wrong"),
    ],
)
def test_what_is_not_of_the_drives_is_not_told_as_wrong(text, said, tmp_path, capsys):
    path = tmp_path / "paste.txt"
    path.write_text(text, "utf-8")
    assert main(["diagnose", str(path)]) == 0
    assert said in capsys.readouterr().out


LEFT_OUT = (
    "[D] Sent packet: @3FFB3944/6:\n  | 0000: 02 04 00 06 00 02\n[D] Raw buffer received: @3FFB39A0/9:\n"
    "  | 0000: 02 04 04 3F DE B8 52 {}\n"
)


def test_a_unit_that_answers_has_seen_the_crc_that_a_log_leaves_out(tmp_path, capsys):
    assert verdict(LEFT_OUT.format("57 57") * 3, tmp_path, capsys) == ("ok", [])
    unanswered = "".join(line for line in LEFT_OUT.splitlines(keepends=True) if "0000: 02 04 04" not in line)
    assert "missing_checksum" in verdict(unanswered * 3, tmp_path, capsys)[1]
