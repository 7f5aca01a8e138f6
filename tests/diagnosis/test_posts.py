"""Posts of people, from the text to the cause, with other numbers than theirs; and the same without the trouble."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Role
from analyzer.records import Chunk
from analyzer.sources import open_source
from tests.diagnosis.test_pastes import checked

ASKED, REPLIED = checked("11 03 00 10 00 02"), checked("11 03 04 3C A6 43 6A")
LAYERS = "".join(
    f"`[10:00:06][VV][uart_esp32:125]:     Read 0b{byte:08b} (0x{byte:02X})`\n"
    f"`[10:00:06][V][modbus:058]: Modbus received Byte  {byte} (0X{byte:x})`\n"
    for byte in bytes.fromhex(checked("11 84 02"))
)

IDF = "E (7221) TWAI1 Master: TWAI Error Detected (0x10):\nE (7221) TWAI1 Master:  - ACK Error\n"
ASKED_TWICE = "10:00:18.940 Serial Send: {}\n10:00:{} Serial Send: {}\n10:00:19.{} Serial Received: {}\n"


#: An exception between two bytes of a glitch; a reply that comes in four reads.
GLITCHED = bytes.fromhex(f"00 {checked('02 81 01')} 00")
REPLY = bytes.fromhex(checked("02 06 C3 60 00 21"))
GIVEN_UP = "ERROR : Request timed out after 3 sec\n"
PARTS = REPLY[:2], REPLY[2:4], REPLY[4:7], REPLY[7:]


def buffer(data):
    """Return bytes as JSON has a Buffer of Node."""
    return f'{{"type":"Buffer","data":{list(data)}}}'.replace(", ", ",")


def bracketed(text):
    return "".join(f"[{byte}]" for byte in text.split())


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        # Request and reply in one read: words call it the response, or the program shows what it has sent.
        (f"It does not work.\nResponse with the code below: {ASKED} {REPLIED};", "echo"),
        (f"uint8_t request[] = {{0x11, 0x03, 0x00, 0x10, 0x00, 0x02}};\nResponse: {ASKED} {REPLIED}", "echo"),
        # BACnet answers where Modbus is asked.
        ("TX = 55 03 3F FF 00 01\nRX = 55 FF 01 .....\nI am expecting 03 in the second one.", "unsupported_dialect"),
        ("TX = 55 03 3F FF 00 01\nRX = 55 FF 00 10 05 00 00 8C", "unsupported_dialect"),
        # The events of a serial port are what was received, however few bytes each has.
        ("".join(f"[10:00:0{n}.1] write {ASKED}\n[10:00:0{n}.2] data event: 11 03\n[10:00:0{n}.203] data event: {REPLIED[6:]}\n"
                 "[10:00:00.300] ERROR frame dropped\n" for n in range(3)), "split_frame"),
        # What ESP-IDF logs of a bus without another node.
        (IDF * 3 + "I (7221) TWAI1 Master: state changed: error_active -> error_warning\n", "can_no_ack"),
        # An identifier of 36 bits, of which 11 go out.
        (
            "CAN0.sendMsgBuf(0x810EC4040, 8, data4);\nI get\n"
            "Standard ID: 0x040       DLC: 8  Data: 0x47 0x36 0x52 0x53 0x31 0x45 0x34 0x33\n",
            "can_extended_id",
        ),
        # Requests that do not wait for the reply to the one before.
        (
            ASKED_TWICE.format(
                checked("04 03 01 00 00 09"), "19.054", checked("04 03 10 0A 00 02"), "136", checked("04 03 04 00 01 AB 00")
            ),
            "too_fast",
        ),
        (
            f"1-Rx:{checked('01 06 00 0A 01 31')} {checked('01 06 00 0A 01 32')}\n"
            f"2-Rx:{checked('01 06 00 0A 01 33')} {checked('01 06 00 0A 01 34')}\n",
            "too_fast",
        ),
        # Bytes of two layers of a program, each line as a piece of code.
        (LAYERS + "`[10:00:06][W][modbus:108]: Modbus error function code: 0x84 exception: 2`\n", "wrong_register"),
        # A library logs neither address nor CRC of what it sends, and no address of what it gets.
        (
            "Modbus poll:\nTx: 0F 03 07 04 00 01 C5 91\nRx: 0F 03 02 03 CD 10 E0\nIn the debug of the ESP32, which fails:\n"
            "3 7 4 0 1\n83 3 60 F2\nRequest result: 0x3\n",
            "value_out_of_range",
        ),
        (f"Data length errors, no data. With another tool:\nTx: {ASKED}\nRx: {REPLIED}\n", "split_frame"),
        # Half a reply of Modbus TCP, as an item of a list.
        ("The message is split in two piece:\n-0x0 0x1 0x0 0x0 0x0 0x7 0x3 0x3 0x4 0x0 0x0 0x3 -> ignored\n", "split_frame"),
        (
            "ERROR: request ask for id=1 but got id=0, Skipping. >>>>> send: 0x0 0x19 0x0 0x0 0x0 0x6 0x1 0x6 0x0 0x1f 0x0 0x1 "
            ">>>>> recv: 0x0 0x19 0x0 0x0 0x0 0x6 0x0 0x0 0x0 0x0 0x0 0x0 extra data:",
            "wrong_address",
        ),
        # The request of another master, which could be the head of a reply of Modbus TCP.
        (
            "master.write_string(0, 'abc')\nInvalidResponseError: Wrong functioncode: 3 instead of 16. "
            r"The response is: '\x01\x03\x00\x00\x00\x16\xc4\x04'" "\n",
            "two_masters",
        ),
        # One line of candump among many words.
        ("What is wrong?\n" * 30 + "```\ncan0  001   [4]  F6 01 40 02\n```\n", "missing_checksum"),
        # A write to all gives an address, and the unit answers from it.
        (
            f"{bracketed(checked('00 06 00 20 00 07'))}\nWaiting for a confirmation...\n"
            f"{bracketed(checked('07 06 00 00 00 07')).replace('[', '<').replace(']', '>')}\n",
            "address_changed",
        ),
        # Counters of errors as mbed prints them, beside frames of others.
        (
            "# of rd error : 0\nMessage received: id 0x17C, dlc 1 [01, ]\n# of rd error : 255\n"
            "Message received: id 0x17C, dlc 1 [02, ]\n# of tderr : 136\n# of rd error : 255\n",
            "can_bit_errors",
        ),
        # A master of CANopen that has more nodes than the one it asks.
        (
            "can2  3B3   [8]  **D9 D6 00 00** 00 00 00 00\ncan2  1B4   [3]  60 92 00\ncan2  1B5   [3]  60 92 00\n"
            "can2  3B5   [8]  61 CD FE FF 00 00 00 00\ncan2  5B6   [8]  43 00 18 01 B6 01 00 00\n"
            "can2  636   [8]  40 00 18 01 00 00 00 00`\n",
            "unsupported_dialect",
        ),
        # A program prints each byte it receives, without zeros, by the name of its function.
        ("".join(f"[ {n}][D][utils.cpp:274] receive(): {byte:x}\n" for n, byte in enumerate(GLITCHED)), "leading_glitch"),
        ("".join(f"receive(): {byte:x}\n" for byte in GLITCHED), "leading_glitch"),
        # A library gives up on the parts of a reply, which Node prints as JSON.
        ("".join(f"DEBUG : received data {buffer(part)}\n" for part in PARTS) + GIVEN_UP, "split_frame"),
        # Frames of CAN in a sentence, each with what it is.
        ("The ID is changed:\n0x143  20 05 00 00 02 00 00 00    request to the old one\n"
         "0x242  20 05 00 00 02 00 00 00    answer of the new one\n", "unsupported_dialect"),
    ],
)  # fmt: skip
def test_a_post(text, cause, causes_of):
    assert causes_of(text)[0] == cause


@pytest.mark.parametrize(
    "text",
    [
        # A listener receives both.
        f"received: {ASKED} {REPLIED}\nreceived: {ASKED} {REPLIED}\n",
        # The reply to the first comes before the second.
        "".join(f"10:00:1{n}.940 Send: {ASKED}\n10:00:1{n}.960 Received: {REPLIED}\n" for n in range(3)),
        # Two units, of which the first is silent.
        f"{checked('01 06 00 0A 01 31')} {checked('01 06 00 0A 01 31')}\n" * 3,
        # A program that speaks of errors has none.
        "if (alerts & TWAI_ALERT_BUS_ERROR) Serial.println(\"TWAI: ACK error, error_passive\");\ncan0  123   [2]  01 02\n",
        # Parts that a library joins; numbers that are no bytes; a function that counts.
        "".join(f"DEBUG : received data {buffer(part)}\n" for part in PARTS) + "DEBUG : Request done\n",
        f"> {ASKED}\n< {REPLIED}\nDEBUG : received data {buffer([300, 6])}\nERROR : Request timed out after 3 sec\n",
        f"> {ASKED}\nreceive(): 9\n< {REPLIED}\n" * 2,
    ],
)  # fmt: skip
def test_a_post_without_it(text, causes_of):
    assert {"echo", "too_fast", "can_no_ack", "split_frame", "leading_glitch", "trailing_glitch"}.isdisjoint(causes_of(text))


@pytest.mark.parametrize(
    "text",
    [
        # A byte a line, between its time and who sent it.
        "".join(
            f"{(n * 40 + at) / 10000:.6f}\t0x{byte:02X}\t{who}\n"
            for n, (who, data) in enumerate((("HOST", ASKED), ("MOTOR", REPLIED)) * 3)
            for at, byte in enumerate(bytes.fromhex(data))
        ),
        # A table in German, with an arrow for the direction.
        '"No.";"Zeit";"Richtung";"Daten"\n'
        + "".join(
            f'"{n}";"14:02:0{n},100";"{side}";"{data.replace(" ", "-")}"\n'
            for n, (side, data) in enumerate((("PC->", ASKED), ("->PC", REPLIED)) * 3)
        ),
    ],
)
def test_who_sent_stands_behind_the_bytes_or_at_an_arrow(text, tmp_path):
    path = tmp_path / "post.txt"
    path.write_text(text)
    with open_source(path) as source:
        chunks = [item for item in source if isinstance(item, Chunk)]
    sides = {role: b"".join(c.data for c in chunks if c.direction is role).hex(" ").upper() for role in Role}
    assert sides == {Role.REQUEST: " ".join([ASKED] * 3), Role.REPLY: " ".join([REPLIED] * 3)} | {
        role: "" for role in Role if role not in (Role.REQUEST, Role.REPLY)
    }


def test_the_head_of_bacnet_has_a_check(causes_of):
    """The standard's own example: a token from 5 to 10h has the check 8C."""
    heard = "TX: 55 03 3F FF 00 01\nRX: 55 FF 00 10 05 00 00 {}"
    assert [causes_of(heard.format(check))[0] for check in ("8C", "8D")] == ["unsupported_dialect", "missing_checksum"]


def test_the_rest_of_a_reply_may_come_in_the_read_behind(causes_of):
    """Bytes are lost between the two reads, so that no CRC tells; a log of one read alone shows no second."""
    log = "".join(
        f"[{n}261] Size: [7], Content: [01 03 3E 00 7{n} 02 7B ]\n[{n}291] Size: [4], Content: [{rest} 0D A8 ]\n"
        for n, rest in ((1, "71 D0"), (2, "F9 53"), (3, "C2 60"))
    )
    alone = "".join(line for line in log.splitlines(keepends=True) if "Size: [7]" in line)
    assert causes_of(log)[:2] == ["reply_cut", "split_frame"]
    assert "split_frame" not in causes_of(alone)
