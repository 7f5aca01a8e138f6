"""What people paste, from the text to the cause: logs of libraries, posts, tables of programs."""

from __future__ import annotations

import pytest

from analyzer import dialects as registry
from analyzer.catalogue import Role
from analyzer.diagnosis.diagnose import diagnosis, of_traffic
from analyzer.diagnosis.scene import Confidence
from analyzer.diagnosis.watch import Watch
from analyzer.link import modbus_crc
from analyzer.pipeline import Pipeline
from analyzer.records import CanFrame, Comment
from analyzer.sources import read_text

ESPHOME = "".join(f"[10:00:01][V][modbus:042]: Modbus received Byte  {b} (0X{b:x})\n" for b in bytes.fromhex("110304000041EE"))
EMODBUS = """[D] {}| ModbusClientRTU.cpp  [ 253] handleConnection: Request sent.
[D] Sent packet: @3FFB3700/6:
  | 0000: 05 04 00 10 00 02                                 |......          |
[D] 2071| RTUutils.cpp         [ 437] receive: C/[D] {} packet: @3FFB8308/1:
  | 0000: {}
"""
TURNED = "Tx: 01 03 00 00 00 01 84 0A\nRx: 4A 01 03 02 00 17 F8\n"


def diagnosed(text):
    traffic = read_text(text).traffic
    kind = "can" if any(isinstance(item, CanFrame) for item in traffic) else "serial"
    return of_traffic(traffic, [d for d in registry.every() if d.bus == kind])


def checked(text):
    data = bytes.fromhex(text)
    return (data + modbus_crc(data).to_bytes(2, "little")).hex(" ").upper()


STREAM = bytes.fromhex("01 03 00 00 00 0A C5 CD") * 5


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        # One byte a line; a reply that misses its end.
        ("[10:00:00][V][modbus:199]: Modbus write: 11.03.00.10.00.02.C7.5E (8)\n" + ESPHOME, "reply_cut"),
        # The same bytes by two layers of a program are sent once; damaged, they come back.
        (
            "[10:00:00][V][modbus:222]: Modbus write: 11.03.00.10.00.02.C7.5E (8)\n"
            "[10:00:00][D][uart_debug:114]: >>> 11:03:00:10:00:02:C7:5E\n"
            "[10:00:00][D][uart_debug:114]: <<< 51:F3:00:10:C0:02:D7:7E\n",
            "echo",
        ),
        (EMODBUS.format(2040, "Received", "E0"), "no_reply"),
        (EMODBUS.format(2040, "Raw buffer received", "05 04 00 10 00 02 71 8A 05 04 04 00 00 00 07 FF 86"), "echo"),
        # A reply that is a request without its end.
        (r"Checksum error in rtu mode. The response is: '\x05\x04\x00\x10\x00\x01\x31'", "echo"),
        ("Expected 9 bytes, got 8.\nRECV: 0x11 0x3 0x4 0x0 0x0 0x0 0x41 0x2b", "reply_cut"),
        ("SEND: 0x11 0x3 0x0 0x10 0x0 0x2 0xc7 0x5e\nRECV: 0xff 0xfd 0xff 0xbf", "noise"),
        ("[11][03][00][10][00][02][C7][5E]\nWaiting for a confirmation...\n<00><00><00><00><00><00>\n", "wrong_baud"),
        ("sent: 11 01 00 10 00 01 FE 9F\nreceived: 11 01 00 00 **00 01**", "wrong_length"),
        ("A message like `0x2 0x5 0x0 0x3 0xff 0x0 0x0 0x0` is not taken by the server.", "wrong_checksum"),
        ("> 02 10 00 01 00 02 04 00 0A 01 02 FF FF", "wrong_checksum"),
        # A count of six for three bytes of data.
        ("req: `11 10 0010 0003 06 010203 A87F`\nres: nothing", "wrong_length"),
        ('I write "e1 3a" (the sum is added) and get "01 07" or "01 e1"', "unsupported_dialect"),
        (
            "Request:  can0  142   [8]  30 00 00 00 00 00 00 00\nResponse: can0  142   [8]  30 00 11 22 33 44 55 66",
            "unsupported_dialect",
        ),
        # A program; python-can takes 29 bits where nothing else is said.
        ("bus.send(can.Message(arbitration_id=0x01, data=[0xF3, 1], is_extended_id=False))", "missing_checksum"),
        (
            "msg = can.Message(\n    arbitration_id=1,\n    data=[0x30, 0x31],\n)\nbus.send(msg)\n"
            "bus.send(can.Message(arbitration_id=1, data=[50, 51]))",
            "can_extended_id",
        ),
        ("ch.write(0x141, bytes([0x92, 0, 0, 0, 0, 0, 0, 0]))", "unsupported_dialect"),
        # Reads that are turned, and those that begin within a frame.
        (TURNED * 2, "read_misaligned"),
        ("".join(f"rx: {STREAM[at : at + 8].hex(' ')}\n" for at in (5, 13, 21)), "read_misaligned"),
        ("01 30 2B FA\n" * 4, "read_misaligned"),
        # One address alone makes the CRC fit.
        ("got 03 02 00 17 f8 4a from the drive", "lost_start"),
        ("rx: 03 00 6b 00 03 74 17\nrx: 03 00 6b 00 03 74 17\n", "lost_start"),
        # Half a CRC, and exceptions without one.
        ("I send 01 04 00 30 00 03 b0", "missing_checksum"),
        ("Tx: 01 03 00 64 00 01 c5 d5\nRx: 01 83 02", "reply_cut"),
        (r"The response is: '\x01\x03\x02\x00'", "reply_cut"),
        # What a second host asks and gets.
        (
            "Tx: 01 03 00 00 00 02 C4 0B\nRx: 01 04 00 31 00 02 20 04 01 03 04 00 01 00 02 2A 32",
            "two_masters",
        ),
        # LK has two sums.
        ("motor.send: 3E A2 01 04 10 27 00 00 1C", "wrong_checksum_rule"),
        ("send 3E A2 01 04 10 27 00 00 37", "wrong_checksum_rule"),
        ("> 3E A2 01 04 2C A0 8C 00 00 2C", "wrong_checksum_rule"),
        # An echo, in any dialect; sums of an older motor; a request that is a byte short.
        ("> E0 30 10\n< E0 30 10 E0 00 00 00 00 00 2A 0A", "echo"),
        ("TX: E0 36 16\nRX: E0 36 16 E0 01 02 03 04 EA\nTX: E0 3A 1A\nRX: E0 3A 1A E0 01 E1", "echo"),
        ("sent FF FF 01 02 01 FB, received FF FF 01 02 01 FB FF FF 01 02 00 FC", "echo"),
        ("data = bytearray([0xE0, 0xF7, 0xE8])\nsend(data)\ndata = bytearray([0xE0, 0xF3, 0x01, 0xE8])\n", "wrong_checksum"),
        ("> E0 30 11\n> E0 F6 10 00", "wrong_checksum"),
        ("ser.write(bytes([0xE0, 0xF3, 0x01]))\nser.write(bytes([0xE0, 0x33]))", "missing_checksum"),
        ("TX: E1 3A\nTX: E1 F3 01\nTX: E1 F7\nno response at all", "missing_checksum"),
        ("I send FA 01 F6 00 64 55 and nothing happens", "wrong_length"),
        ("TX: FA 01 F6 00 64 5B  # 100rpm\nRX: FB 01 F6 01 F9\nTX: FA 01 30 2B\nRX: FB 01 30 00 00 40 00 CC", "wrong_length"),
        # What other services answer.
        ("RECV: 0x46 0x49 0x4e 0x53 0x0 0x0 0x0 0x10", "unsupported_dialect"),
        ("recv: 03 00 00 0B 06 D0 00 01 00 02 00", "unsupported_dialect"),
        # Buffers of Node, of any length.
        ("{ '0': <Buffer 01> }\n{ '0': <Buffer 84 01 82 c0> }\nerr: 'crcMismatch'", "wrong_function"),
        ("data <Buffer 02>\ndata <Buffer 83 02 30 f1>\nError: Timed out", "wrong_register"),
        # What a server has kept, and joins.
        (
            "[ DEBUG] recv: 0xfe 0x4 0x0 0x19 0x0 0x1 0xf4 0x2 old_data: 0xfe 0x4 0x0 0x3 0x0 0x1 0xd5 0xc5 0x0 addr=None\n"
            "[ DEBUG] Processing: 0xfe 0x4 0x0 0x3 0x0 0x1 0xd5 0xc5 0x0 0xfe 0x4 0x0 0x19 0x0 0x1 0xf4 0x2\n",
            "trailing_glitch",
        ),
        ("rx: 11 03 00 10 00 02 C7 5E 00 11 03 00 12 00 02 66 9E\n", "leading_glitch"),
        # A long reply that the console has wrapped.
        (
            "[02][03][00][01][00][7D][D4][18]\nWaiting for a confirmation...\n<02><03><FA>" + 3 * ("<00>" * 45 + "\n"),
            "reply_cut",
        ),
        # Too many bytes for a frame; an identifier of which the low bits alone go out.
        ("cansend can0 141#8800000000000000\ncansend can0 141#A4007800504600000000\n", "wrong_length"),
        ("cansend can0 001#F60140023A00000000\n", "wrong_length"),
        ("$ cansend vcan0 123#112233445566778899AA\nWrong CAN-frame format!\n", "wrong_length"),
        (
            "var msg = { id: 403105268, data: new Buffer([ 0, 0xFA, 0, 0x32 ]) };\nchannel.send(msg);\n\n"
            "can0  5F4   [4]  00 FA 00 32\ncan0  18FF50E5   [2]  01 06\n",
            "can_extended_id",
        ),
        (
            "bus.send(can.Message(arbitration_id=0x1806E5F4, data=[1, 2], is_extended_id=False))\n  can1  5F4   [2]  01 02\n",
            "can_extended_id",
        ),
        ("It prints `CanErrorFrame { 00000088#0000040000000000 }` with nothing connected.", "can_wrong_bitrate"),
        # A device that swaps the CRC of its replies; two writes whose checks fit no known rule.
        ("Tx: 05 04 00 10 00 02 71 8A\nRx: 05 04 04 00 00 00 07 86 FF\n", "crc_swapped"),
        ("I tried these:\n\n11 06 0003 0010 7AC4\n\nand then\n\n11 06 0004 0020 4F7B\n", "wrong_checksum"),
        # A read of nothing; requests to units that the host did not ask.
        (f"> {checked('02 04')}\n", "wrong_length"),
        (
            "".join(f"Rx: {checked(f'{unit:02X} 45 00 00 00 20 00 00')}\n" for unit in (3, 4))
            + "".join(f"Tx: {checked(f'{unit:02X} 45 00 00 00 20 00 00')}\n" for unit in (1, 2)),
            "two_masters",
        ),
        # What calls a function tells who sent.
        ("[open]\n" + "[port.write] <Buffer 00 03 00 05 00 01 95 da>\n" * 2, "broadcast_no_reply"),
        # Identifiers of programs; what an adapter keeps of frames; what a program takes.
        ("m = can.Message(arbitration_id=0x1F00, data=bytes([1] * 2), is_extended_id=False)\n", "can_extended_id"),
        (
            "m = can.Message(arbitration_id=0x1ABCDEF0, data=[0x55] * 3, is_extended_id=True)\n  can2  6F0   [3]  55 55 55\n",
            "can_extended_id",
        ),
        ("ffffffff88000020080000000000040000000000\n" * 2, "can_wrong_bitrate"),
        ("TX:1#F3010203A1\n", "wrong_length"),
        # Cells of a table below each other; a request that never comes whole; the same bytes, and those that a port leaves.
        ("Read it so:\n11\n04\n00 02\n00 01\n90 5B\nand no reply comes\n", "wrong_checksum"),
        (f"It shows {('11 04 00 02 00 01 ' + checked('11 04 00 02 00 01')[18:20] + ' ') * 3}and stops", "missing_checksum"),
        ("scope: AB 01 13 02 55 07 00 08 13 C1\nport: AB 01 02 55 07 00 08 C1\n", "text_mode"),
        # What firmware, and candump without its frames, say of a controller.
        ("state: STUFF_ERROR, FORM_ERROR, FLT_CONF: Bus off\n" * 2, "can_bus_off"),
        ("FlexCAN: STF_ERR, FLT_CONF: Error Passive\nFlexCAN: FRM_ERR, FLT_CONF: Error Passive\n", "can_wrong_bitrate"),
        ("no-acknowledgement-on-tx\nerror-counter-tx-rx{{96}{0}}\nno-acknowledgement-on-tx\n", "can_no_ack"),
        # Counters of a controller, as libraries print them.
        ("Sending...\nMSG tx_err=128 rx_err=0\nSending...\nMSG tx_err=128 rx_err=0\n", "can_no_ack"),
        ("TX err cnt = 136 RX err cnt = 0\n", "can_no_ack"),
        # A stray byte, for which the host misses the last of a reply, with and without what was asked.
        ("TX: 11 04 00 00 00 02 73 5B\nRX: 1D 11 04 04 43 6C 3E E8 2F\n", "leading_glitch"),
        ("RX: 00 11 04 04 43 6C 3E E8 2F\n", "leading_glitch"),
    ],
)  # fmt: skip
def test_a_paste(text, cause):
    found = diagnosed(text)
    assert found.causes
    assert found.causes[0].suspicion.cause == cause, found


def test_a_long_read_answered_by_a_count_of_two_bytes():
    assert diagnosed("01 03 00 02 17 81 2b 9a\n01 03 00 02 17 81 2b\n").verdict == "trouble"


def test_a_search_for_drives_is_no_trouble():
    text = (
        "".join(f"> FA {a:02X} 31 {(0xFA + a + 0x31) & 0xFF:02X}\n" for a in range(2, 9))
        + "> FA 01 31 2C\n< FB 01 31 00 00 00 00 00 00 2D\n"
    )
    assert of_traffic(read_text(text).traffic, [d for d in registry.every() if d.name == "mks-rs485"]).verdict == "ok"


def test_a_number_of_a_logger_is_no_byte():
    text = "2020-07-31 16:33:39,109 MainThread  DEBUG    client  :35   Write to a register\n> 11 03 00 10 00 02 C7 5E\n"
    assert [item.data.hex() for item in read_text(text).traffic] == ["110300100002c75e"]


def test_requests_that_are_sent_again_are_no_echo():
    sent = "".join(f"[10:00:0{s}][D][uart_debug:114]: >>> 11:03:00:10:00:02:C7:5E\n" for s in (1, 1, 1, 1))
    found = of_traffic(read_text(sent).traffic, [d for d in registry.every() if d.name == "mks-modbus"])
    assert "echo" not in [each.suspicion.cause for each in found.causes]


@pytest.mark.parametrize("shown_again", [False, True])
def test_a_reply_that_goes_on_in_the_next_reads_is_not_cut(shown_again):
    reply = bytes.fromhex("0403081122334455667788")
    reply += modbus_crc(reply).to_bytes(2, "little")
    text = "send: 0x4 0x3 0x62 0x75 0x0 0x4 0x4a 0x3e\n"
    for part in (reply[:5], reply[5:12], reply[12:]):
        said = " ".join(f"0x{byte:x}" for byte in part)
        text += f"recv: {said}\n" + f"Processing: {said}\nFrame - not ready\n" * shown_again
    found = of_traffic(read_text(text).traffic, [d for d in registry.every() if d.bus == "serial"])
    assert "reply_cut" not in [each.suspicion.cause for each in found.causes]


@pytest.mark.parametrize(
    ("sent", "received"),
    [
        ("Передача: {}", "Приём: {}"),
        ("Wysłano: {}", "Odebrano: {}"),
        ("Gönderilen: {}", "Alınan: {}"),
        ("Verzonden: {}", "Ontvangen: {}"),
        ("Odesláno: {}", "Přijato: {}"),
        ("송신: {}", "수신: {}"),
        ("发出: {}", "收到: {}"),
    ],
)
def test_who_sent_is_told_in_any_language(sent, received):
    text = f"{sent.format('01 04 00 30 00 03 B0 04')}\n{received.format('01 84 02 C2 C1')}\n"
    assert [item.direction for item in read_text(text).traffic] == [Role.REQUEST, Role.REPLY]


@pytest.mark.parametrize(
    "rows",
    [
        "  0.001  can0  TX  0x001  2  30 31\n  0.002  can0  RX  0x001  8  30 00 00 00 01 20 00 52\n",
        "   1     0.0  TX  001h   2   30 31\n   2     1.0  RX  001h   8   30 00 00 00 01 20 00 52\n",
        "TX ID=0x001 DLC=2 [30 31]\nRX ID=0x001 DLC=8 [30 00 00 00 01 20 00 52]\n",
    ],
)
def test_rows_of_can_monitors(rows):
    assert [item.data.hex() for item in read_text(rows).traffic] == ["3031", "3000000001200052"]
    assert diagnosed(rows).verdict == "ok"


def test_a_list_of_a_program_for_another_drive_is_no_accusation():
    text = "byte cal[] = {0xE1, 0x80, 0x00, 0x61}; // write first\nbyte get[] = {0xE1, 0x30, 0x11};\n"
    watch, dialects = Watch(), [d for d in registry.every() if d.bus == "serial"]
    pipeline = Pipeline(dialects, [watch])
    watch.comment(Comment(None, "", "byte cal[]"))
    for item in read_text(text).traffic:
        watch.take(item)
        pipeline.feed(item)
    pipeline.close()
    (found,) = diagnosis(watch, dialects).causes
    assert (found.suspicion.cause, found.suspicion.confidence) == ("unsupported_dialect", Confidence.POSSIBLE)


def asked_and_answered(request, reply):
    return [
        f"[10:00:00][V][modbus:199]: Modbus write: {request.hex('.').upper()} ({len(request)})\n"
        f"[10:00:00][D][uart_debug:114]: <<< {reply.hex(':').upper()}\n",
        f"[RTU]>Tx > 10:00:01:123 - {request.hex(' ').upper()} \n[RTU]>Rx > 10:00:01:190 - {reply.hex(' ').upper()} \n",
        f"Tx:000000-{request.hex(' ').upper()}\nRx:000001-{reply.hex(' ').upper()}\n",
        f"2026/05/01 10:00:00 modbus: send {request.hex(' ')}\n2026/05/01 10:00:00 modbus: recv {reply.hex(' ')}\n",
        f"10:00:00.123 DEBUG (MainThread) [pymodbus.logging] send: {' '.join(map(hex, request))}\n"
        f"10:00:00.173 DEBUG (MainThread) [pymodbus.logging] recv: {' '.join(map(hex, reply))}\n",
        f"{''.join(f'[{b:02X}]' for b in request)}\nWaiting for a confirmation...\n{''.join(f'<{b:02X}>' for b in reply)}\n",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "text",
    ["".join(parts) for parts in zip(
        asked_and_answered(bytes.fromhex("010300000002C40B"), bytes.fromhex("010304 00E6021A 9B6F")),
        asked_and_answered(bytes.fromhex("010400100001300F"), bytes.fromhex("010402012CB97D")),
        asked_and_answered(bytes.fromhex("0106000500649820"), bytes.fromhex("0106000500649820")),
        strict=True,
    )],
    ids=["ESPHome", "QModMaster", "Modbus Poll", "Go", "pymodbus", "mbpoll"],
)  # fmt: skip
def test_sound_exchanges_of_other_devices_are_not_accused(text):
    assert not diagnosed(text).causes


def in_brackets(data, brackets):
    return "".join(f"{brackets[0]}{byte:02X}{brackets[1]}" for byte in data) + "\n"


def test_a_device_that_logs_its_own_replies_is_not_accused():
    asked, replied = bytes.fromhex(checked("11 04 00 10 00 01")), bytes.fromhex(checked("11 04 02 12 34"))
    log = "Waiting for an indication...\n" + in_brackets(asked, "<>") + in_brackets(replied, "[]")
    assert not diagnosed(log * 3).causes
    # A whole reply is no request that is too short, also where no request is shown.
    assert not diagnosed(f"Tx: {replied.hex(' ')}\n").causes
    assert diagnosed(f"Tx: {checked('11 04 00 12 34')}\n").causes[0].suspicion.cause == "wrong_length"


@pytest.mark.parametrize(("reply", "cause"), [("11 83", "firmware_quirk"), ("11 83 02", "wrong_register")])
def test_an_exception_without_its_code(reply, cause):
    log = f"Tx: {checked('11 03 00 10 00 01')}\nRx: {checked(reply)}\n"
    assert diagnosed(log).causes[0].suspicion.cause == cause


def test_an_answer_to_a_remote_request_is_no_command():
    asked = " (2024-01-01 10:00:00.000000)  can0  TX - -  002   [0]  remote request\n"
    answered = " (2024-01-01 10:00:00.000400)  can0  RX - -  002   [2]  00 02\n"
    frames = [item for item in read_text(asked + asked + answered).traffic if isinstance(item, CanFrame)]
    assert [(frame.remote, frame.data) for frame in frames] == [(True, b""), (True, b""), (False, b"\x00\x02")]
    assert not diagnosed(asked + asked + answered).causes


def test_records_of_named_fields():
    """Its last field is a number of the logger, and no byte."""
    asked, replied = checked("0B 03 20 06 00 02"), checked("0B 03 04 40 9B F8 A1")
    text = "".join(
        f"DATE=2024-01-01T10:00:0{second}.100;ERR=NO;FRAME={data.replace(' ', '-').lower()};SLAVE=11\n"
        for second, data in enumerate((asked, replied))
    )
    assert [chunk.data.hex(" ").upper() for chunk in read_text(text).traffic] == [asked, replied]
    assert not diagnosed(text).causes
    assert not read_text("DATE=2024-01-01T10:00:01;ERR=NO;SLAVE=11\nSTATE=10;COUNT=12 13 14;SLAVE=11\n").traffic


@pytest.mark.parametrize(("clock", "cause"), [("10:00:30.000", "leading_glitch"), ("10:00:00.040", "trailing_glitch")])
def test_a_glitch_belongs_to_the_frame_that_is_near_in_time(clock, cause):
    asked, replied = checked("11 03 00 10 00 01"), checked("11 03 02 00 17")
    log = f"10:00:00.000 Tx: {asked}\n10:00:00.030 Rx: {replied}\n{clock} Rx: FE\n"
    log += f"10:00:30.015 Tx: {asked}\n10:00:30.045 Rx: {replied}\n"
    assert diagnosed(log).causes[0].suspicion.cause == cause


@pytest.mark.parametrize(("size", "causes"), [(7, []), (5, ["reply_cut"])])
def test_bytes_that_are_logged_in_binary(size, causes):
    asked, replied = bytes.fromhex(checked("11 03 00 10 00 01")), bytes.fromhex(checked("11 03 02 00 17"))[:size]
    log = "".join(
        f"[10:00:0{second}][VV][uart_esp8266:111]:     {verb} 0b{byte:08b} (0x{byte:02X})\n"
        for second, verb, data in ((1, "Wrote", asked), (2, "Read", replied))
        for byte in data
    )
    assert b"".join(chunk.data for chunk in read_text(log).traffic) == asked + replied
    assert [each.suspicion.cause for each in diagnosed(log).causes] == causes
    # Glued to one line they are not read as the last of them alone.
    assert all(len(chunk.data) != 1 for chunk in read_text(log.replace("\n", "")).traffic)
