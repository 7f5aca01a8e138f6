"""How languages, debuggers and tools print bytes: one row each, a request and its reply, with senders and times."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Role
from analyzer.records import CanFrame, Chunk
from analyzer.sources import read_text

REQUEST, REPLY = "FA 01 3A 35", "FB 01 3A 01 37"
#: What tells the sender, but no time.
UNTIMED = {
    "Python pairs": """('TX', b'\\xfa\\x01:5')\n('RX', b'\\xfb\\x01:\\x017')""",
    "Python hexlify": "tx b'fa013a35'\nrx b'fb013a0137'",
    "C array": "const uint8_t tx0[4] = {0xfa, 0x01, 0x3a, 0x35};\nconst uint8_t rx0[5] = {0xfb, 0x01, 0x3a, 0x01, 0x37};",
    "C call": (
        "HAL_UART_Transmit(&huart1, {0xFA, 0x01, 0x3A, 0x35}, 4, 100)\n"
        "HAL_UART_Receive(&huart1, {0xFB, 0x01, 0x3A, 0x01, 0x37}, 5, 100)"
    ),
    "named ports": "huart1 tx: FA 01 3A 35\nhuart1 rx: FB 01 3A 01 37",
    "gdb print": "(gdb) p/x tx_buf\n$1 = {0xfa, 0x1, 0x3a, 0x35}\n(gdb) p/x rx_buf\n$2 = {0xfb, 0x1, 0x3a, 0x1, 0x37}",
    "gdb memory": (
        "(gdb) x/4xb tx_buf\n0x20000100 <tx_buf>:\t0xfa\t0x01\t0x3a\t0x35\n"
        "(gdb) x/5xb rx_buf\n0x20000200 <rx_buf>:\t0xfb\t0x01\t0x3a\n0x20000203 <rx_buf+3>:\t0x01\t0x37"
    ),
    "Rust dbg": (
        "[src/main.rs:4] tx = [\n    250,\n    1,\n    58,\n    53,\n]\n"
        "[src/main.rs:5] rx = [\n    251,\n    1,\n    58,\n    1,\n    55,\n]"
    ),
    "Rust bytes": 'tx: b"\\xfa\\x01:5"\nrx: b"\\xfb\\x01:\\x017"',
    "Node array": "sent Uint8Array(4) [\n  250,   1,  58,\n   53\n]\nreceived Uint8Array(5) [\n  251,   1,  58,\n    1,  55\n]",
    "Qt": (
        "qt.modbus.lowlevel: (RTU client) Sent Serial ADU: 0xfa013a35\n"
        "qt.modbus.lowlevel: (RTU client) Received ADU: 0xfb013a0137"
    ),
    "IEC": "SEND B#16#FA B#16#01 B#16#3A B#16#35\nRECV B#16#FB B#16#01 B#16#3A B#16#01 B#16#37",
    "HTML": "--&gt; FA&nbsp;01&nbsp;3A&nbsp;35<br>\n&lt;-- FB&nbsp;01&nbsp;3A&nbsp;01&nbsp;37<br>",
    "xxd below marks": "sent:\n00000000: fa01 3a35            ..:5\nreceived:\n00000000: fb01 3a01 37         ..:.7",
    "places": "TX: 00000000  FA 01 3A 35\nRX: 00000000  FB 01 3A 01 37",
    "two columns": "TX\tRX\nFA 01 3A 35\t\n\tFB 01 3A 01 37",
    "Termite": "> fa 01 3a 35\nfb 01 3a 01 37",
    "a sign and then bytes": "> FA 01 3A 35\nFB 01 3A 01 37\n> FA 01 3A 35\nFB 01 3A 01 37",
    "French": "Émission : FA 01 3A 35\nRéception : FB 01 3A 01 37",
    "Spanish": "Envío: FA 01 3A 35\nRespuesta: FB 01 3A 01 37",
    "Italian": "Inviati: FA 01 3A 35\nRicevuti: FB 01 3A 01 37",
    "Portuguese": "Enviado: FA 01 3A 35\nRecebido: FB 01 3A 01 37",
    "Russian": "Запрос: FA 01 3A 35\nОтвет: FB 01 3A 01 37",
    "Chinese": "发送数据：FA 01 3A 35\n接收数据：FB 01 3A 01 37",
    "Chinese ends": "主机发送：FA 01 3A 35\n从机返回：FB 01 3A 01 37",
    "dotted": "TX fa.01.3a.35\nRX fb.01.3a.01.37",
    "the name of the logger": "servo: write fa013a35\nservo: read fb013a0137",
    "strace with a dump": (
        'write(3, "\\372\\1:5", 4) = 4\n | 00000  fa 01 3a 35                    ..:5             |\n'
        'read(3, "\\373\\1:\\0017", 64) = 5\n | 00000  fb 01 3a 01 37                 ..:.7            |'
    ),
}  # fmt: skip
#: What is read line by line, and not as sentences.
UNTIMED |= {
    "Go": "TX []byte{0xfa, 0x1, 0x3a, 0x35}\nRX []byte{0xfb, 0x1, 0x3a, 0x1, 0x37}",
    "Node list": "TX Uint8Array(4) [ 250, 1, 58, 53 ]\nRX Uint8Array(5) [ 251, 1, 58, 1, 55 ]",
    "Rust without zeros": "tx: [fa, 1, 3a, 35]\nrx: [fb, 1, 3a, 1, 37]",
    "LabVIEW": "write \\FA\\01\\3A\\35\nread \\FB\\01\\3A\\01\\37",
    "Qt string": 'write "\\xFA\\x1:5"\nread "\\xFB\\x1:\\x1""7"',
    "words behind": "REQUEST  FA 01 3A 35  CRC OK\nRESPONSE  FB 01 3A 01 37  CRC OK",
    "PLC array": "abTx : [16#FA, 16#01, 16#3A, 16#35]\nabRx : [16#FB, 16#01, 16#3A, 16#01, 16#37]",
    "bullets": "* Sent: `FA 01 3A 35`\n* Received: `FB 01 3A 01 37`",
    "BB code": "[code]\nTX: [b]FA 01 3A 35[/b]\nRX: [b]FB 01 3A 01 37[/b]\n[/code]",
    "numbered": "1. -> FA 01 3A 35\n2. <- FB 01 3A 01 37",
    "sign behind a logger": "DEBUG:umodbus:--> fa 01 3a 35\nDEBUG:umodbus:<-- fb 01 3a 01 37",
}
#: What tells the time, too.
TIMED = {
    "call behind a logger": (
        "2026-11-20 14:01:05,250 [DEBUG] bus.py:41 write(b'\\xfa\\x01:5')\n"
        "2026-11-20 14:01:05,254 [DEBUG] bus.py:52 read(b'\\xfb\\x01:\\x017')"
    ),
    "loguru": (
        "2026-11-20 14:01:05.250 | DEBUG    | drive.bus:send:42 - TX: FA 01 3A 35\n"
        "2026-11-20 14:01:05.254 | DEBUG    | drive.bus:recv:57 - RX: FB 01 3A 01 37"
    ),
    "ESP-IDF dump": "I (65250) TX: 0x3ffb04a0   fa 01 3a 35      |..:5|\nI (65254) RX: 0x3ffb04b0   fb 01 3a 01 37   |..:.7|",
    "label": "[14:01:05.250] <dbg> bus: modbus_tx_adu: fa 01 3a 35\n[14:01:05.254] <dbg> bus: modbus_rx_adu: fb 01 3a 01 37",
    "Tasmota": "14:01:05.250 DMP: TX FA013A35\n14:01:05.254 DMP: RX FB013A0137",
    "grep": "app.log:11:14:01:05.250 TX FA 01 3A 35\napp.log:12:14:01:05.254 RX FB 01 3A 01 37",
    "YAT": "(14:01:05.250) (<<) FAh 01h 3Ah 35h (4)\n(14:01:05.254) (>>) FBh 01h 3Ah 01h 37h (5)",
    "the name of the program": (
        "2026-11-20 14:01:05,250 - servo - DEBUG - TX fa 01 3a 35\n"
        "2026-11-20 14:01:05,254 - servo - DEBUG - RX fb 01 3a 01 37"
    ),
    "container": "servo-1  | 2026-11-20T14:01:05.250Z tx fa 01 3a 35\nservo-1  | 2026-11-20T14:01:05.254Z rx fb 01 3a 01 37",
    "Zephyr": (
        "[14:01:05.250,000] <dbg> servo: tx:\n        fa 01 3a 35          |..:5\n"
        "[14:01:05.254,000] <dbg> servo: rx:\n        fb 01 3a 01 37       |..:.7"
    ),
    "ESP-IDF": "I (65250) UART_TX: fa 01 3a 35 \nI (65254) UART_RX: fb 01 3a 01 37 ",
    "milliseconds": "[65250] TX (4): FA 01 3A 35\n[65254] RX (5): FB 01 3A 01 37",
    "milliseconds alone": "65250 TX FA 01 3A 35\n65254 RX FB 01 3A 01 37",
    "at": "@65.250 TX FA 01 3A 35\n@65.254 RX FB 01 3A 01 37",
    "since": "T+65.250s TX FA 01 3A 35\nT+65.254s RX FB 01 3A 01 37",
    "steps": "+  50 ms  TX  FA 01 3A 35\n+   4 ms  RX  FB 01 3A 01 37",
    "epoch": "1790000065,TX,FA 01 3A 35\n1790000066,RX,FB 01 3A 01 37",
    "logfmt": (
        'time=2026-11-20T14:01:05.250Z level=DEBUG msg=tx data="fa 01 3a 35"\n'
        'time=2026-11-20T14:01:05.254Z level=DEBUG msg=rx data="fb 01 3a 01 37"'
    ),
    "serial monitor": (
        "Write request, 1, 20.11.2026 14:01:05.250 +0.001, 4 bytes\n FA 01 3A 35\n"
        "Read request, 2, 20.11.2026 14:01:05.254 +0.001, 5 bytes\n FB 01 3A 01 37"
    ),
    "serial monitor with numbers": (
        "000001: Write Request (DOWN), 2026-11-20 14:01:05.2500000 +0.0150 \n\n FA 01 3A 35   ..:5\n\n"
        "000002: Read Request (UP), 2026-11-20 14:01:05.2540000 +0.0040 \n\n FB 01 3A 01 37   ..:.7"
    ),
    "IO Ninja": "14:01:05.250 > 0000  fa 01 3a 35            ..:5\n14:01:05.254 < 0000  fb 01 3a 01 37         ..:.7",
    "count in a cell": "14:01:05.250;SEND;4;16#FA 16#01 16#3A 16#35\n14:01:05.254;RECV;5;16#FB 16#01 16#3A 16#01 16#37",
    "count alone": "14:01:05.250 COM3 TX 04 FA 01 3A 35\n14:01:05.254 COM3 RX 5 FB 01 3A 01 37",
    "USB": "1\t65.250000\thost\t1.5.1\tUSB\t4\tfa013a35\n2\t65.254200\t1.5.1\thost\tUSB\t5\tfb013a0137",
    "a byte a cell": "Nr;Zeit;Richtung;Daten\n1;14:01:05.250;TX;FA;01;3A;35\n2;14:01:05.254;RX;FB;01;3A;01;37",
    "answers without a mark": "".join(
        f"14:01:0{n}.250 write fa013a35\n14:01:0{n}.254 data  fb013a0137\n14:01:0{n}.254 parse: done\n" for n in range(3)
    ),
    "answers that a library goes on with": "".join(
        f"14:01:0{n}.250 send: 0xfa 0x1 0x3a 0x35\n14:01:0{n}.254 Processing: 0xfb 0x1 0x3a 0x1 0x37\n" for n in range(3)
    ),
    "powers of ten": "Time,TX,RX\n6.525e+01,FA 01 3A 35,\n6.526e+01,,FB 01 3A 01 37",
}  # fmt: skip
CAN = {
    "Rust": "tx 001#3A 3B\nrx 001#3A 01 3C",
    "CANopen": "SEND COB-ID 16#1 LEN 2 DATA 16#3A 16#3B\nRECV COB-ID 16#1 LEN 3 DATA 16#3A 16#01 16#3C",
    "STM32": "CAN TX: StdId=0x001 DLC=2 Data=3A 3B\nCAN RX: StdId=0x001 DLC=3 Data=3A 01 3C",
    "Python": "send 0x1 bytearray(b':;')\nrecv 0x1 bytearray(b':\\x01<')",
    "identifier and bytes": "65.2500 TX 0x1 3a 3b\n65.2512 RX 0x1 3a 01 3c",
    "sentences": "I send ID 0x001 with 3A 3B\nand get back ID 0x001: 3A 01 3C",
    "Arduino": "Sending packet with id 0x1 and length 2\n3A 3B\nReceived packet with id 0x1 and length 3\n3A 1 3C",
    "GVRET": "65250000 - 1 S 0 2 3A 3B\n65251200 - 1 S 0 3 3A 01 3C",
    "short identifiers": "can0 1 [2] 3A 3B\ncan0 1 [3] 3A 01 3C",
    "strokes": "can0 | 0x001 | [2] | 3A 3B\ncan0 | 0x001 | [3] | 3A 01 3C",
    "HTML": "&nbsp;can0&nbsp; 001&nbsp;&nbsp; [2]&nbsp; 3A 3B<br>\n&nbsp;can0&nbsp; 001&nbsp;&nbsp; [3]&nbsp; 3A 01 3C<br>",
    "Kvaser": (
        "Time,Channel,ID,Flags,DLC,Data0,Data1,Data2\n65.25,1,1,0,2,58,59,\n"
        "65.26,1,1,0,3,58,1,60\n65.27,1,1,0,3,250,1,252"
    ),
    "CANTest": (
        "序号\t传输方向\t时间标识\t帧ID\t帧类型\t帧格式\t数据长度\t数据(HEX)\n"
        "0\t发送\t14:01:05.250\t0x00000001\t数据帧\t标准帧\t0x02\t3A 3B\n"
        "1\t接收\t14:01:05.251\t0x00000001\t数据帧\t标准帧\t0x03\t3A 01 3C"
    ),
    "CANTest, the kind of identifier below the other heading": (
        "序号,传输方向,时间标识,名称,帧ID,帧格式,帧类型,数据长度,数据(HEX)\n"
        "0,发送,14:01:05.250,,0x00000001,数据帧,扩展帧,2,3A 3B\n"
        "1,接收,14:01:05.251,,0x00000001,数据帧,标准帧,3,3A 01 3C"
    ),
    "CANalyzer": (
        "Time\tChn\tID\tName\tDir\tEvent Type\tDLC\tData\n"
        "65.25\tCAN 1\t1\t\tTx\tCAN Frame\t2\t3A 3B\n65.26\tCAN 1\t1\t\tRx\tCAN Frame\t3\t3A 01 3C"
    ),
}  # fmt: skip


@pytest.mark.parametrize("form", [*UNTIMED, *TIMED])
def test_a_request_and_its_reply(form: str) -> None:
    found = [each for each in read_text(UNTIMED.get(form) or TIMED[form]).traffic if isinstance(each, Chunk)]
    wanted = [(Role.REQUEST, REQUEST), (Role.REPLY, REPLY)] * (len(found) // 2)
    assert found
    assert [(each.direction, each.data.hex(" ").upper()) for each in found] == wanted
    assert len({each.port for each in found}) == 1
    assert form in UNTIMED or all(each.t_ns is not None for each in found)


@pytest.mark.parametrize("size", [1, 2, 4])
def test_an_event_of_node_brings_any_number_of_bytes(size: int) -> None:
    reply = bytes.fromhex(REPLY)
    parts = [reply[:size], reply[size:]]
    text = f"[ 303.8 ms] write <Buffer {REQUEST.lower()}>\n" + "".join(
        f"[ 3{n}4.4 ms] on('data') <Buffer {part.hex(' ')}>\n" for n, part in enumerate(parts, 1)
    )
    found = [each for each in read_text(text * 2).traffic if isinstance(each, Chunk)]
    assert [each.data for each in found if each.direction is Role.REPLY] == parts * 2
    assert all(each.t_ns is not None for each in found)


@pytest.mark.parametrize("form", CAN)
def test_can_frames(form: str) -> None:
    found = [each for each in read_text(CAN[form]).traffic if isinstance(each, CanFrame)]
    assert [(each.id, each.data.hex()) for each in found[:2]] == [(1, "3a3b"), (1, "3a013c")]
    assert [each.extended for each in found[:2]] == ["扩展帧" in CAN[form], False]


@pytest.mark.parametrize("numbers", ["4711 4711", "1001 1002", "2000 1000"])
def test_numbers_that_are_no_times(numbers: str) -> None:
    one, other = numbers.split()
    found = read_text(f"[{one}] TX: FA 01 3A 35\n[{other}] RX: FB 01 3A 01 37\n").traffic
    assert [each.t_ns for each in found] == [None, None]


@pytest.mark.parametrize(("column", "firm"), [("   ................", False), ("", True)])
def test_rows_with_their_characters_are_a_stream(column: str, firm: bool) -> None:
    stream = bytes.fromhex("1E 95 AC 08 08 B4 1E 3A A4 D6 1E D7 EC F8 AC 08") * 4
    rows = "".join(f"{stream[at : at + 16].hex(' ').upper()}{column}\n" for at in range(0, len(stream), 16))
    found = [each for each in read_text(rows.replace("1E 95", "EC F8", 1) + "EC F8   ..\n").traffic if isinstance(each, Chunk)]
    assert b"".join(each.data for each in found)[16:] == stream[16:] + b"\xec\xf8"
    assert {each.burst for each in found} == {firm}
