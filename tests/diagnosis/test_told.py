"""Pastes in which the words count: lists that were never sent, makers, reports of libraries, consoles, late replies."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from analyzer.cli import main
from analyzer.link import modbus_crc

LIST = """const char stop[] = {0x3E, 0x80, 0x05, 0x00, 0xC3};
const char still[] = {0x3E, 0x81, 0x05, 0x00, 0xC4};
void send_all() { write(fd, stop, 5); }
"""
AGAIN = "".join(f"[10:00:0{n}][D][uart_debug:114]: <<< 11:01:00:10:00:01:FE:9F\n" for n in range(3))
ONCE = "[10:00:00][D][uart_debug:114]: <<< 11:01:00:10:00:01:FE:9F\n"
LATE = """DEBUG:send: 0x5 0x3 0x0 0x0 0x0 0x2 0xc5 0x8f
DEBUG:send: 0x4 0x3 0x0 0x0 0x0 0x1 0x84 0x5f
DEBUG:recv: 0x5 0x3 0x4 0x0 0x1f 0x0 0x20 0x8f 0xed
DEBUG:recv: 0x4 0x3 0x2 0x0 0x1 0xb5 0x84
"""


SAID = "ValueError: {}\n\nvalue = instrument.read_registers(2012, 2, 3)\nthis code has been working for a year\n"
LIBRARY = "if I run this\n\n6 1 16 FF FF\n\nI get this error\nRequest result: {}\n"
TCP = "Tx: 00 01 00 00 00 06 01 03 00 00 00 01\nRx: 00 01 00 00 00 {} {}\n"


LATE_TCP = "Tx: 00 10 00 00 00 06 01 03 00 00 00 01\nRx: 00 0F 00 00 00 05 01 03 02 00 17 00 10 00 00 00 05 01 03 02 00 18\n"
COUNTED_TCP = "Tx: 00 01 00 00 00 06 01 03 00 00 00 01\nRx: 00 01 00 00 00 0A 01 03 02 00 17\n"


EMODBUS = """[D] Sent packet: @3FFB3700/6:
  | 0000: 05 04 00 10 00 02                                 |......          |
[N] Raw buffer received: @3FFB3711/{}:
  | 0000: {}
[D] Received packet: @3FFB8308/1:
  | 0000: E5                                                |.               |
"""
BUFFER = "byte q[] = {0x02, 0x03, 0x00, 0x10, 0x00, 0x02, 0xC5, 0xFD};\n"
LAST = "looking for 9 bytes, received {}\nLast request: 05 03 00 10 00 02 C4 4A\nCRC Error in received frame: {} bytes: 05\n"
TABLE = "| 0 | {} | Slave | of the unit |\n| 1 | {} | Function | |\n| 2-3 | 00 05 | Register | |\n| 4-5 | 00 01 | Count | |\n"


def value(frame: str, words: str) -> str:
    """Return a reply to a read, and words about its value."""
    body = bytes.fromhex(frame)
    return f"Rx: {(body + modbus_crc(body).to_bytes(2, 'little')).hex(' ')}\n{words}\n"


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (LIST, None),
        (f"{LIST}// the motor does not answer\n", "no_reply"),
        # Declarations alone.
        ("byte go[] = {0x3E, 0x81, 0x03, 0x00, 0xC2};\nbyte off[] = {0x3E, 0x80, 0x03, 0x00, 0xC1};\n", None),
        ("byte go[] = {0xE1, 0xF6, 0x00, 0xD7};\nvoid out() { n = strlen(go); port.write(go, n); }\n", "text_mode"),
        ("byte go[] = {0xE1, 0xF6, 0x00, 0xD7};\nvoid f() { n = strlen(ssid); put(go, 4); }\n", "unsupported_dialect"),
        ("".join(f"modbus: response transaction id {n} doesn't match request {n + 1}\n" for n in range(3)), "late_reply"),
        (
            "[00][07][00][00][00][06][01][05][00][01][FF][00]\nWaiting for a confirmation...\n"
            "<00><07><00><00><00><04><01><31><32>\n"
            "Message length not corresponding to the computed length (9 != 12)\n",
            "wrong_length",
        ),
        (
            "".join(
                f"[12:00:01][W][modbus:155]: Modbus CRC Check failed! {n}A12!=3C{n}F {n}1.F9.52.3F.7C (5)\n"
                for n in range(1, 5)
            ),
            "split_frame",
        ),
        (
            "[12:00:01][W][modbus:155]: Modbus CRC Check failed! 1A12!=3C1F 68.17.3B.43.69.E2.C5.40 (8)\n"
            "[12:00:01][W][modbus:155]: Modbus CRC Check failed! 2A12!=3C2F 21.F9.52.3F.7C (5)\n"
            "[12:00:01][W][modbus:155]: Modbus CRC Check failed! 3A12!=3C3F 31.F9.52.3F.7C (5)\n",
            "split_frame",
        ),
        ("My unit is silent.\nError: Response address 0 is different from request address 7\n", "wrong_address"),
        ("My motor does not move.\nThe interface gets stuck in the ERROR-PASSIVE state.\n", "can_no_ack"),
        ("notes on the arm\n  cansend can0 001#3132\n", None),
        (AGAIN, "no_reply"),
        # A library that takes a sound frame for a shorter one compares bytes of its middle; other bytes are damaged.
        (f"Modbus CRC Check failed! {modbus_crc(bytes.fromhex('110100')):X}!=10\n{ONCE}", "no_reply"),
        (f"Modbus CRC Check failed! {modbus_crc(bytes.fromhex('110101')):X}!=10\n{ONCE}", "reply_cut"),
        # What a line makes by itself stands in the place of each check; a byte of each is missing.
        ("CRC Check failed! C03E!=FF\nCRC Check failed! D041!=FE00\nCRC Check failed! A031!=FE\n", "leading_glitch"),
        ("CRC Check failed! C03E!=3E\nCRC Check failed! D041!=41\nCRC Check failed! A031!=31\n", "reply_cut"),
        # Bytes that are said come with an edge before and behind them; others come.
        ("the reply is 07 03 04 57 73 7A and the master receives FF 07 03 04 57 73 7A 00\n", "leading_glitch"),
        # A log that prints requests without their CRC, and counts it; one that does not count it.
        ("request: [11][03][00][C0][00][01]\ntty: written 8 bytes\ntty: response timeout\n", "no_reply"),
        ("request: [11][03][00][C0][00][01]\ntty: written 6 bytes\ntty: response timeout\n", "missing_checksum"),
        ("Set response timeout to 500 ms\nTX: 11 03 00 C0 00 01 86 A6\nRX: 11 03 02 00 04 78 44\n", None),
        ("response timeout: 500\ntx_err=3 rx_err=0\nTX: 11 03 00 C0 00 01 86 A6\nRX: 11 03 02 00 04 78 44\n", None),
        (LATE, "late_reply"),
        ("Tx 11 03 00 10 00 02 C7 5E\nRx 6C 6F 67 69 6E 3A 20", "unsupported_dialect"),
        ("Tx 7E 02 33 00 FD 0D\nRx 7E 02 33 01 55 A7 0D", "unsupported_dialect"),
        ("Tx DD A5 03 00 FF FD 77\nRx DD 03 00 01 20 FF DF 77", "unsupported_dialect"),
        ("$ candump can0\n  can0  003   [8]  FF FF FF FF FF FF FF FC\n", "unsupported_dialect"),
        (
            SAID.format(r"Wrong functioncode: 4 instead of 3. The response is: '\x01\x04\x04\x00\x00\x00\x00û\x84'"),
            "late_reply",
        ),
        (SAID.format(r"Wrong functioncode: 3 instead of 16. The response is: '\x01\x03\x00\x00\x00\x10D\x06'"), "two_masters"),
        (
            SAID.format(r"Wrong slave address: 2 instead of 1. The response is: '\x02\x03\x00\x00\x00\x02\xc4\x38'"),
            "two_masters",
        ),
        (LIBRARY.format("0x1"), "wrong_function"),
        (LIBRARY.format("0x02"), "wrong_register"),
        (LIBRARY.format("0x3"), "value_out_of_range"),
        (LIBRARY.format("0xE4"), "no_reply"),
        ("No answer of the ODrive:\n0x029 [8] 00 00 00 00 00 00 00 00\n", "unsupported_dialect"),
        # Names of a program are no state of a controller.
        ("if (state & STF_ERR) count++;\nuint8_t on[] = {0xFA, 0x01, 0xF3, 0x01, 0xEF};\n", None),
        # What a library goes on with it has printed before.
        (
            "send: 0x11 0x3 0x0 0x6d 0x0 0x1 0x17 0x47\nrecv: 0x11 0x3 0x2 0x0 0x1a 0xf8 0x4c old_data:  addr=None\n"
            "Processing: 0x11 0x3 0x2 0x0 0x1a 0xf8 0x4c\n",
            None,
        ),
        # An error that a library reports stands behind what the bytes show.
        ("> 11 03 00 6D 00 01\n> 11 03 00 6D 00 01\nCRC check failed: expected 0x1A2B, got 0xFF13", "missing_checksum"),
        # Words alone.
        ("Modbus exception 2: Illegal data address\nreading register 40051", "wrong_register"),
        ("SlaveException: ...\nException Code: 2 - The data address is not an allowable address", "wrong_register"),
        ("ExceptionResponse(131, 3, IllegalFunction)", "wrong_function"),
        ("Illegal data value (exception code 3) on write_register(0x82, 9)", "value_out_of_range"),
        ("01 ILLEGAL FUNCTION\n02 ILLEGAL DATA ADDRESS\n03 ILLEGAL DATA VALUE", None),
        ("Modbus Error: [Invalid Message] No response received, expected at least 2 bytes (0 received)", "no_reply"),
        ("ERROR Connection timed out: select\n", "no_reply"),
        ("Data length error, expected 9 got 1", "reply_cut"),
        ("CRC check failed: expected 0x1A2B, got 0xFF13", "noise"),
        ("CRC error, expected 0xC4B0 but got 0xB0C4", "crc_swapped"),
        ("Modbus CRC Check failed! C071!=00\nModbus CRC Check failed! C071!=8900", "reply_cut"),
        ("read_float(0) gives 4.2e-41", "wrong_byte_order"),
        # Values of sound replies, and what they should be.
        (value("01 03 02 09 1A", "It shows 2330 but the display says 233.0 V"), "unit_or_sign"),
        (value("01 03 02 09 1A", "raw 2330 is 233.0 V"), None),
        (value("01 04 02 0B B8", "the speed is 10 times too high"), "unit_or_sign"),
        (value("01 03 02 FF 38", "I get 65336 but expected -20.0"), "unit_or_sign"),
        (value("01 03 02 00 17", "it prints 5888 instead of 23"), "wrong_byte_order"),
        (value("01 04 04 66 66 43 69", "I get 2.72e+23 instead of 233.4"), "wrong_byte_order"),
        (value("01 03 04 00 64 00 00", "The register is a uint16, and I get 6553600 instead of 100"), "wrong_register"),
        (value("01 03 02 00 01", "The energy is a 32 bit value, so 1 is wrong"), "wrong_register"),
        # What a program sends.
        ('ser.write("FA 01 30 2B".encode())  # always empty', "text_mode"),
        ('In Python I use port.write("0xFA, 0x02, 0x31, 0x2D"), and get nothing.', "text_mode"),
        ('Serial.println("0xFA 0x02 0x31 0x2D"); // on the screen\n', None),
        ("port.write(Buffer.from('FA01302B', 'hex')) // no answer", "no_reply"),
        ("<Buffer 30 31 30 33 30 30 30 30 30 30 30 31 38 34 30 41>\nmotor does not react", "text_mode"),
        ("byte data[3] = {0xF3, 0x01};\nCAN.sendMsgBuf(0x01, 0, 2, data);\n// does not enable", "missing_checksum"),
        ("byte d[2] = {0x31, 0x32};\nCAN0.sendMsgBuf(0x01, 1, 2, d); // no reply", "can_extended_id"),
        ("CAN.beginPacket(1);\nCAN.write(0xF3);\nCAN.write(0x01);\nCAN.write(0xF4);\nCAN.endPacket();", "wrong_checksum_rule"),
        ("m.can_id = 1;\nm.can_dlc = 2;\nm.data[0] = 0xF3;\nm.data[1] = 1;\nmcp.sendMessage(&m);", "missing_checksum"),
        (
            "h.StdId = 0x01;\nuint8_t d[5] = {0xF6, 0x01, 0x40, 0x02};\nh.DLC = 4;\nHAL_CAN_AddTxMessage(&c, &h, d, &b);",
            "missing_checksum",
        ),
        # A table with a column of requests and one of replies.
        ("name | sent | received\nspeed | 001#3233 | 001#32006497\nenable | 001#F301F5 | 001#F301F5\n", None),
        # Byte by byte, also into an array that is declared alone; what is known at run time only tells nothing.
        ("byte b[8];\nb[0] = 0xF3;\nb[1] = 0x01;\nCAN.sendMsgBuf(0x01, 0, 2, b);\n// does not enable", "missing_checksum"),
        ("byte b[8];\nb[0] = 0xF3; b[1] = 0x01; b[2] = 0xF5;\nCAN.sendMsgBuf(0x01, 0, 3, b);", None),
        ("bus.beginPacket(1);\nbus.write(0xF3);\nbus.write(0x01);\nbus.endPacket();\n// no answer", "missing_checksum"),
        ("byte on[3] = {0xF3, 0x01, 0xF5};\nCAN0.sendMsgBuf(0x01, 0, 3, on);", None),
        (
            "uint8_t a[] = {0x01, 0x04, 0x00, 0x32, 0x00, 0x01, 0x90, 0x05};\nuint8_t b[] = {0xFA, 0x01, 0xF3, 0x01, 0xEF};",
            None,
        ),
        (
            "byte READ_IT[] = {0xFA, 0x01, 0x31, 0x2C};\nbyte on[] = {0xFA, 0x01, 0xF3, 0x01, 0xEF};\nvoid go() { put(on); }",
            None,
        ),
        ("byte[] cmd = {(byte)0xFA, 0x01, (byte)0xF3, 0x01};\nport.writeBytes(cmd);\n// nothing happens", "missing_checksum"),
        ("channel.send({ id: 0x01, data: Buffer.from([0xF3, 0x01]) }) // does not react", "missing_checksum"),
        # On CAN.
        ("can0  601   [8]  40 41 60 00 00 00 00 00\ncan0  581   [8]  4B 41 60 00 50 02 00 00", "unsupported_dialect"),
        ("can0  701   [1]  7F\ncan0  701   [1]  7F", "unsupported_dialect"),
        ("can0  001   [3]  8C 00 8D\n no more answers after that", "respond_off"),
        ("can0  001   [4]  8C 01 01 8F\ncan0  001   [3]  8C 01 8E", None),
        # Modbus TCP that works, and one that refuses.
        (TCP.format("05", "01 03 02 00 17"), None),
        (TCP.format("03", "01 83 02"), "wrong_register"),
        (LATE_TCP, "late_reply"),
        (COUNTED_TCP, "wrong_length"),
        # Examples of a document.
        ("Request: `01 03 00 6B 00 03 74 17`\nResponse: `01 03 06 02 2B 00 00 00 64 05 7A`\nException: `01 83 02 C0 F1`", None),
        # Another number of registers than was asked for.
        ("> 01 03 07 EE 00 02 A5 4A\n< 01 03 0C 43 3F 00 00 20 4C 49 54 48 49 55 4D D0 05", "wrong_length"),
        # Frames of a program whose numbers are computed, or known at run time only.
        (
            "f.can_id = 0x140 + 2;\nf.can_dlc = 8;\nf.data[0] = 0xA1;\nf.data[5] = (iq >> 8) & 0xff;\nf.data[7] = 0;\n"
            "write(s, &f, sizeof(f));\n",
            "unsupported_dialect",
        ),
        (
            "bus.send(can.Message(arbitration_id=0x140 + n, data=[0xA2, 0, 0, 0, low, high, 0, 0], is_extended_id=False))\n",
            "unsupported_dialect",
        ),
        ("bus.send(can.Message(arbitration_id=axis, data=[0xF3, 0x01, 0xF5], is_extended_id=False))\n", "no_reply"),
        ("bus.send(can.Message(arbitration_id=axis, data=[0xF3, 0x01, 0xF4], is_extended_id=False))\n", "wrong_checksum_rule"),
        (
            "An RMD X8 turns and turns.\nm.can_id = 0x7FF;\nm.can_dlc = 4;\nm.data[0] = (1 >> 8) & 0xFF;\n"
            "m.data[1] = 1;\nm.data[3] = 1;\n"
            "port.send(PORT::TXB1, &m);\n",
            "unsupported_dialect",
        ),
        # A list with 0x here and there; decimal numbers behind a letter.
        ("ser.write(bytes([0x01, 3, 0, 0, 0, 10, 0xCD, 0xC5]))\nb'' came\n", "crc_swapped"),
        ("W 1 3 0 0 0 1 132 10\nR 1 3 2 0 23 248 74\nW 1 3 0 0 0 1 10 132\n", "crc_swapped"),
        # Tables with a cell of bytes and one of their name, and names before their bytes; no measured values.
        (f"It is silent.\n{TABLE.format('01', '03')}| 6-7 | 0B 94 | CRC | |\n", "crc_swapped"),
        ("Unit 01\nFunction code: 03\nStart: 00 05\nCount = 00 01\nCRC Hi 0B\nCRC Lo 94\nno reply\n", "crc_swapped"),
        # A library that logs bare requests: bytes of the reply tell more than its code.
        (EMODBUS.format(4, "05 04 04 12"), "reply_cut"),
        (EMODBUS.format(1, "00"), "reply_cut"),
        (LAST.format(0, 1), "no_reply"),
        (LAST.format(4, 4), "reply_cut"),
        # What a program sends no line has damaged.
        ('send("FA 02 F3 01 F0");\nsend("FA 02 F6 00 C8 05 BF");\nsend("FA 02 F6 00 00 05 FD");\n', "wrong_checksum_rule"),
        # Digits that go out as letters; what is printed to the console does not.
        (BUFFER + "rs.print(q[i], HEX); while (rs.available()) Serial.println(rs.read(), HEX);\n// silent\n", "text_mode"),
        (BUFFER + "rs.write(q, 8); Serial.print(q[i], HEX); while (rs.available()) rs.read();\n// silent\n", "no_reply"),
        # One byte a line, each with a remark.
        (
            "Modbus write: 11.03.00.10.00.02.C7.5E (8)\n"
            + "".join(f"[10:00:01][V][modbus:042]: Modbus received Byte  {b} (0X{b:x})  == of it\n" for b in b"\x11\x03\x04\0"),
            "reply_cut",
        ),
        # Stray bytes hide a refusal; a write of any register is answered by itself; who asks for objects speaks CANopen.
        ("TX: 07 03 00 20 00 01 85 A6\nRX: FF 07 83 02 20 F0 00\n", "leading_glitch"),
        ("TX: 01 06 20 00 00 12 02 07\nRX: 01 06 20 00 00 12 02 07\n" * 2, None),
        ("TX: 05 10 00 10 00 02 04 00 01 02 44 B7\nRX: 05 10 00 10 00 02 40 49\n", "wrong_length"),
        (
            "cansend can0 60C#4000100000000000\n" + "can0 18C [2] 00 00\ncan0 28C [8] 00 00 00 00 00 00 00 00\n" * 3,
            "unsupported_dialect",
        ),
        # A device that forgets the CRC of its own replies.
        ("Received: 01 03 00 00 00 01 84 0A\nSent: 01 03 02 00 17\nThe master says timeout", "missing_checksum"),
    ],
)
def test_a_paste_with_its_words(text: str, cause: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "paste"
    path.write_text(text)
    assert main(["diagnose", str(path), "--json"]) == (cause is not None)
    found = json.loads(capsys.readouterr().out)["causes"]
    assert [each["cause"] for each in found[:1]] == ([cause] if cause else [])


@pytest.mark.parametrize(
    ("words", "cause"),
    [
        ("set_speed({speed})  # deg/s", "unit_or_sign"),
        ("it turns 100 times slower than I ask", "unit_or_sign"),
        # In words as in bytes.
        ("set_speed({speed})  # 0.01 deg/s", None),
        ("it turns 10 times slower than a turn", None),
    ],
)
def test_a_number_that_is_sent_without_its_scale(words, cause, causes_of):
    bodies = [speed.to_bytes(4, "little") for speed in (360, 90)]
    frames = [f"3E A2 01 04 E5 {body.hex(' ')} {sum(body) & 0xFF:02X}" for body in bodies]
    log = "".join(f"{words.format(speed=speed)}\n> {frame}\n" for speed, frame in zip((360, 90), frames, strict=True))
    assert causes_of(log + "it answers")[:1] == ([cause] if cause else [])


def test_words_add_nothing_to_what_the_bytes_show(causes_of):
    log = "[01][03][01][00][00][01][85][F6]\nWaiting for a confirmation...\n<00><01><03><02><6D><60><94><FC>\n"
    assert causes_of(log + "ERROR CRC received 94FC != CRC calculated B0E7\n") == ["leading_glitch"]


GROUP = "cfg FA 01 8D 50 D8 => FB 01 8D 01 8A\n" + "".join(
    f"group FA 50 {rest} => TimeoutError\n" for rest in ("F3 01 3E", "F7 41", "F3 00 3D")
)
SENT = ("F301F4", "F601400239", "F7F7")
CAN_GROUP = "".join(f"({n}.1) can0 000#{data}\nrecv(timeout=1.0) -> None\n" for n, data in enumerate(SENT))
CAN_GROUP += "(4.4) can0 001#F1F2\n(4.401) can0 001#F101F3\n"


@pytest.mark.parametrize("log", [GROUP, CAN_GROUP])
def test_the_name_of_an_error_or_none_says_that_a_host_waits(log, causes_of):
    assert causes_of(log)[:1] == ["broadcast_no_reply"]


def test_reads_out_of_step_below_the_program_that_asks(causes_of):
    rows = "".join(f"{n:02X} {n + 0x64:02X} {(0x2D + 2 * n + 0x64) & 0xFF:02X} FB 01 31 00 00 00 00\n" for n in range(12))
    assert causes_of('while True: ser.write(bytes.fromhex("FA01312C")); print(ser.read(10).hex(" "))\n\n' + rows) == [
        "read_misaligned"
    ]


@pytest.mark.parametrize(
    ("said", "cause"), [("timeout after 200 ms", "late_reply"), ("timeout after 0.5 s", None), ("wait", None)]
)
def test_replies_that_come_behind_the_words_that_give_them_up(said, cause, causes_of):
    asked = (
        ("FA 01 31 2C", "FB 01 31 00 00 00 00 00 00 2D"),
        ("FA 01 F1 EC", "FB 01 F1 01 EE"),
        ("FA 01 3A 35", "FB 01 3A 01 37"),
    )
    log = "".join(
        f"05.11.26 17:45:0{n}.000;TX;{sent}\n05.11.26 17:45:0{n}.200;--;{said}\n05.11.26 17:45:0{n}.243;RX;{came}\n"
        for n, (sent, came) in enumerate(asked)
    )
    assert causes_of(log) == ([cause] if cause else [])
