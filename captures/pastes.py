"""What people paste: one kind a row, with an example and the frames that it holds.

The examples are written by hand, in the forms of the tools that they name. A frame is `TIME SENDER BYTES`: seconds (`-`
without), `>` the host, `<` the drive, `?` not told; a CAN frame is `ID#DATA`. Times of day are seconds since midnight.
"""

from __future__ import annotations

from typing import NamedTuple


class Paste(NamedTuple):
    """A kind of paste. `says`: what a note about it says, where the text alone does not tell."""

    name: str
    title: str
    text: str
    frames: tuple[str, ...]
    says: str = ""


def _paste(name: str, title: str, text: str, *frames: str, says: str = "") -> Paste:
    return Paste(name, title, text.lstrip("\n"), frames, says)


_READ = "FA 01 30 2B"
_READ_REPLY = "FB 01 30 00 00 00 01 20 00 4D"
_RUN = "FA 01 F6 01 40 02 34"
_RUN_REPLY = "FB 01 F6 01 F3"
_MODBUS = "01 04 00 32 00 01 90 05"
_MODBUS_REPLY = "01 04 02 01 40 B9 50"

#: Noon, and 2024-03-05 12:00:00 UTC, in seconds.
_NOON = "43200"
_DAY = "1709640000"

PASTES: tuple[Paste, ...] = (
    # --- terminal programs and serial monitors ---------------------------------------------------------------------
    _paste(
        "plain",
        "hex view of RealTerm, CoolTerm, HTerm, Termite",
        """
FA 01 30 2B
FB 01 30 00 00 00 01 20 00 4D
""",
        f"- ? {_READ}",
        f"- ? {_READ_REPLY}",
    ),
    _paste(
        "hex-stream",
        "Wireshark, Copy as Hex Stream",
        """
fa01302b
fb01300000000120004d
""",
        f"- ? {_READ}",
        f"- ? {_READ_REPLY}",
    ),
    _paste(
        "docklight",
        "Docklight",
        """
Docklight Log File (ASCII / HEX) - started 3/5/2024 12:00:00.000
3/5/2024 12:00:00.120 [TX] - FA 01 30 2B
3/5/2024 12:00:00.124 [RX] - FB 01 30 00 00 00 01 20 00 4D
""",
        f"{_DAY}.120 > {_READ}",
        f"{_DAY}.124 < {_READ_REPLY}",
        says="month first",
    ),
    _paste(
        "hercules",
        "Hercules",
        """
{FA}{01}{30}{2B}
{FB}{01}{30}{00}{00}{00}{01}{20}{00}{4D}
""",
        f"- ? {_READ}",
        f"- ? {_READ_REPLY}",
    ),
    _paste(
        "assistant",
        "serial assistant of the MKS manual",
        """
[2024-03-05 12:00:00.120]# SEND HEX>
FA 01 30 2B

[2024-03-05 12:00:00.124]# RECV HEX>
FB 01 30 00 00 00 01 20 00 4D
""",
        f"{_DAY}.120 > {_READ}",
        f"{_DAY}.124 < {_READ_REPLY}",
    ),
    _paste(
        "sscom",
        "SSCOM, XCOM",
        """
[12:00:00.120]发→◇FA 01 30 2B □
[12:00:00.124]收←◆FB 01 30 00 00 00 01 20 00 4D 
""",
        f"{_NOON}.120 > {_READ}",
        f"{_NOON}.124 < {_READ_REPLY}",
    ),
    _paste(
        "chinese",
        "serial assistants in Chinese words",
        """
[12:00:00.120] 发送: FA 01 30 2B
[12:00:00.124] 接收: FB 01 30 00 00 00 01 20 00 4D
""",
        f"{_NOON}.120 > {_READ}",
        f"{_NOON}.124 < {_READ_REPLY}",
    ),
    _paste(
        "port-monitor",
        "Serial Port Monitor",
        """
[25/03/2024 12:00:00] - Open port COM3 (C:\\Tools\\motor.exe)

[25/03/2024 12:00:00] Written data (COM3)
    fa 01 30 2b                                       ú.0+

[25/03/2024 12:00:01] Read data (COM3)
    fb 01 30 00 00 00 01 20 00 4d                     û.0.... .M
""",
        f"1711368000 > {_READ}",
        f"1711368001 < {_READ_REPLY}",
    ),
    _paste(
        "putty",
        "PuTTY log",
        """
=~=~=~=~=~=~=~=~=~=~=~= PuTTY log 2024.03.05 12:00:00 =~=~=~=~=~=~=~=~=~=~=~=
motor ready
TX FA 01 30 2B
RX FB 01 30 00 00 00 01 20 00 4D
""",
        f"- > {_READ}",
        f"- < {_READ_REPLY}",
    ),
    _paste(
        "arduino",
        "Arduino serial monitor with times, bytes printed by `print(x, HEX)`",
        """
12:00:00.120 -> FA 1 30 2B 
12:00:00.124 -> FB 1 30 0 0 0 1 20 0 4D 
12:00:00.200 -> FA 1 30 2B 
""",
        f"{_NOON}.120 ? {_READ}",
        f"{_NOON}.124 ? {_READ_REPLY}",
        f"{_NOON}.200 ? {_READ}",
        says="the '->'",
    ),
    _paste(
        "arduino-words",
        "Arduino serial monitor, a program's own words",
        """
12:00:00.120 -> Sent: FA 1 30 2B
12:00:00.124 -> receive:   10: FB 1 30 0 0 0 1 20 0 4D
12:00:01.124 -> receive:   1: FF
""",
        f"{_NOON}.120 > {_READ}",
        f"{_NOON}.124 < {_READ_REPLY}",
        "43201.124 < FF",
    ),
    _paste(
        "byte-a-line",
        "one byte a line, `println(x, HEX)`",
        """
FA
1
30
2B
FB
1
F6
1
F3
""",
        f"- ? {_READ} {_RUN_REPLY}",
        says="one byte a line",
    ),
    _paste(
        "esphome",
        "ESPHome, uart debug",
        """
[12:00:00][D][uart_debug:114]: >>> FA:01:30:2B
[12:00:01][D][uart_debug:114]: <<< FB:01:30:00:00:00:01:20:00:4D
[12:00:01][I][app:100]: ESPHome version 2024.2.0
""",
        f"{_NOON} > {_READ}",
        f"43201 < {_READ_REPLY}",
    ),
    _paste(
        "esphome-string",
        "ESPHome, uart debug as strings",
        r"""
[12:00:00.120][D][uart_debug:158]: >>> "\x01\x04\x002\x00\x01\x90\x05"
[12:00:00.124][D][uart_debug:158]: <<< "\x01\x04\x02\x01@\xB9P"
""",
        f"{_NOON}.120 > {_MODBUS}",
        f"{_NOON}.124 < {_MODBUS_REPLY}",
    ),
    _paste(
        "esp-idf",
        "ESP-IDF log",
        """
I (1120) rs485: TX: 0xfa 0x01 0x30 0x2b
I (1124) rs485: RX: 0xfb 0x01 0x30 0x00 0x00 0x00 0x01 0x20 0x00 0x4d
""",
        f"1.12 > {_READ}",
        f"1.124 < {_READ_REPLY}",
    ),
    # --- Modbus tools and libraries --------------------------------------------------------------------------------
    _paste(
        "modbus-poll",
        "Modbus Poll, traffic window",
        """
Tx:000123-01 04 00 32 00 01 90 05
Rx:000124-01 04 02 01 40 B9 50
""",
        f"- > {_MODBUS}",
        f"- < {_MODBUS_REPLY}",
    ),
    _paste(
        "qmodmaster",
        "QModMaster, bus monitor",
        """
[RTU]>Tx > 12:00:00:120 - 01  04  00  32  00  01  90  05  
[RTU]>Rx > 12:00:00:124 - 01  04  02  01  40  B9  50  
""",
        f"{_NOON}.120 > {_MODBUS}",
        f"{_NOON}.124 < {_MODBUS_REPLY}",
    ),
    _paste(
        "mbpoll",
        "mbpoll -v, libmodbus debug",
        """
Opening /dev/ttyUSB0 at 38400 bauds (N, 8, 1)
-- Polling slave 1... Ctrl-C to stop)
[01][04][00][32][00][01][90][05]
Waiting for a confirmation...
<01><04><02><01><40><B9><50>
[51]:   320
""",
        f"- > {_MODBUS}",
        f"- < {_MODBUS_REPLY}",
    ),
    _paste(
        "pymodbus",
        "pymodbus debug log",
        """
2024-03-05 12:00:00,120 DEBUG logging:103 send: 0x1 0x4 0x0 0x32 0x0 0x1 0x90 0x5
2024-03-05 12:00:00,124 DEBUG logging:103 recv: 0x1 0x4 0x2 0x1 0x40 0xb9 0x50 old_data:  addr=None
2024-03-05 12:00:00,124 DEBUG logging:103 Processing: 0x1 0x4 0x2 0x1 0x40 0xb9 0x50
""",
        f"{_DAY}.120 > {_MODBUS}",
        f"{_DAY}.124 < {_MODBUS_REPLY}",
    ),
    _paste(
        "home-assistant",
        "Home Assistant log",
        """
2024-03-05 12:00:00.120 DEBUG (MainThread) [pymodbus.logging] SEND: 0x1 0x4 0x0 0x32 0x0 0x1 0x90 0x5
2024-03-05 12:00:00.124 DEBUG (MainThread) [pymodbus.logging] RECV: 0x1 0x4 0x2 0x1 0x40 0xb9 0x50
2024-03-05 12:00:00.130 DEBUG (MainThread) [pymodbus.logging] Frame advanced, resetting header!!
""",
        f"{_DAY}.120 > {_MODBUS}",
        f"{_DAY}.124 < {_MODBUS_REPLY}",
    ),
    _paste(
        "minimalmodbus",
        "MinimalModbus debug mode",
        """
MinimalModbus debug mode. Will write to instrument (expecting 7 bytes back): 01 04 00 32 00 01 90 05 (8 bytes)
MinimalModbus debug mode. Clearing serial buffers for port /dev/ttyUSB0
MinimalModbus debug mode. Response from instrument: 01 04 02 01 40 B9 50 (7 bytes), roundtrip time: 4.1 ms. Timeout for reading: 50.0 ms.
""",
        f"- > {_MODBUS}",
        f"- < {_MODBUS_REPLY}",
    ),
    _paste(
        "minimalmodbus-old",
        "MinimalModbus before version 2",
        r"""
MinimalModbus debug mode. Writing to instrument (expecting 7 bytes back): '\x01\x04\x002\x00\x01\x90\x05' (01 04 00 32 00 01 90 05)
MinimalModbus debug mode. Response from instrument: '\x01\x04\x02\x01@\xb9P' (01 04 02 01 40 B9 50) (7 bytes), roundtrip time: 4.1 ms.
""",
        f"- > {_MODBUS}",
        f"- < {_MODBUS_REPLY}",
    ),
    # --- programs --------------------------------------------------------------------------------------------------
    _paste(
        "python-log",
        "Python logging of bytes",
        r"""
INFO:root:Write b'\xfa\x010+'
INFO:root:Read b'\xfb\x010\x00\x00\x00\x01 \x00M'
INFO:root:Read b''
""",
        f"- > {_READ}",
        f"- < {_READ_REPLY}",
    ),
    _paste(
        "python-code",
        "Python session",
        r"""
>>> ser.write(bytes([0xFA, 0x01, 0x30, 0x2B]))
4
>>> ser.read(10)
b'\xfb\x010\x00\x00\x00\x01 \x00M'
>>> ser.write(b'\xfa\x01\xf6\x01@\x024')
7
""",
        f"- > {_READ}",
        f"- < {_READ_REPLY}",
        f"- > {_RUN}",
    ),
    _paste(
        "hex-list",
        "lists of hex strings",
        """
tx ['0xfa', '0x1', '0x30', '0x2b']
rx ['0xfb', '0x1', '0x30', '0x0', '0x0', '0x0', '0x1', '0x20', '0x0', '0x4d']
""",
        f"- > {_READ}",
        f"- < {_READ_REPLY}",
    ),
    _paste(
        "decimal",
        "decimal bytes",
        """
250 1 48 43
251 1 48 0 0 0 1 32 0 77
1 4 0 50 0 1
""",
        f"- ? {_READ}",
        f"- ? {_READ_REPLY}",
        "- ? 01 04 00 32 00 01",
        says="decimal",
    ),
    _paste(
        "decimal-list",
        "lists of decimal numbers (Python, Rust, Go)",
        """
TX: [250, 1, 48, 43]
RX: [251, 1, 48, 0, 0, 0, 1, 32, 0, 77]
RX: [1]
""",
        f"- > {_READ}",
        f"- < {_READ_REPLY}",
        "- < 01",
        says="decimal",
    ),
    _paste(
        "java",
        "Java, signed bytes",
        """
send [-6, 1, 48, 43]
recv [-5, 1, 48, 0, 0, 0, 1, 32, 0, 77]
""",
        f"- > {_READ}",
        f"- < {_READ_REPLY}",
        says="decimal",
    ),
    _paste(
        "c-array",
        "C arrays",
        """
uint8_t readEncoder[] = {0xFA, 0x01, 0x30, 0x2B};
const uint8_t run[7] = { 0xFA, 0x01, 0xF6, 0x01, 0x40, 0x02, 0x34 }; // 320 rpm
""",
        f"- ? {_READ}",
        f"- ? {_RUN}",
    ),
    _paste(
        "node-buffer",
        "Node.js and Node-RED, printed buffers",
        """
5 Mar 12:00:00 - [info] [debug:out] sent <Buffer fa 01 30 2b>
5 Mar 12:00:01 - [info] [debug:in] received <Buffer fb 01 30 00 00 00 01 20 00 4d>
""",
        f"{_NOON} > {_READ}",
        f"43201 < {_READ_REPLY}",
    ),
    _paste(
        "node-json",
        "Node-RED, buffers as JSON",
        """
{"topic":"tx","payload":{"type":"Buffer","data":[250,1,48,43]},"timestamp":1709640000120}
{"topic":"rx","payload":{"type":"Buffer","data":[251,1,48,0,0,0,1,32,0,77]},"timestamp":1709640000124}
""",
        f"{_DAY}.120 > {_READ}",
        f"{_DAY}.124 < {_READ_REPLY}",
    ),
    _paste(
        "json",
        "JSON lines",
        """
{"time": 0.12, "dir": "tx", "data": "FA 01 30 2B"}
{"time": 0.124, "dir": "rx", "data": "fb01300000000120004d"}
""",
        f"0.12 > {_READ}",
        f"0.124 < {_READ_REPLY}",
    ),
    _paste(
        "csv",
        "a CSV of one's own",
        """
time_ms,direction,bytes
120,TX,FA 01 30 2B
124,RX,FB 01 30 00 00 00 01 20 00 4D
""",
        f"0.12 > {_READ}",
        f"0.124 < {_READ_REPLY}",
    ),
    _paste(
        "ros",
        "ROS log",
        """
[INFO] [1709640000.120000000] [servo]: TX: FA 01 30 2B
[INFO] [1709640000.124000000] [servo]: RX: FB 01 30 00 00 00 01 20 00 4D
""",
        f"{_DAY}.120 > {_READ}",
        f"{_DAY}.124 < {_READ_REPLY}",
    ),
    _paste(
        "syslog",
        "syslog and journalctl",
        """
Mar  5 12:00:00 pi motor[812]: sent FA 01 30 2B
Mar  5 12:00:01 pi motor[812]: received FB 01 30 00 00 00 01 20 00 4D
""",
        f"{_NOON} > {_READ}",
        f"43201 < {_READ_REPLY}",
    ),
    # --- listeners and dumps ---------------------------------------------------------------------------------------
    _paste(
        "socat",
        "socat -x -v",
        """
> 2024/03/05 12:00:00.120000000  length=4 from=0 to=3
 fa 01 30 2b
--
< 2024/03/05 12:00:00.124000000  length=10 from=0 to=9
 fb 01 30 00 00 00 01 20 00 4d
--
""",
        f"{_DAY}.120 > {_READ}",
        f"{_DAY}.124 < {_READ_REPLY}",
    ),
    _paste(
        "strace",
        "strace -xx",
        r"""
write(3, "\xfa\x01\x30\x2b", 4)         = 4
read(3, "\xfb\x01\x30\x00\x00\x00\x01\x20\x00\x4d", 64) = 10
""",
        f"- > {_READ}",
        f"- < {_READ_REPLY}",
    ),
    _paste(
        "jpnevulator",
        "jpnevulator",
        """
2024-03-05 12:00:00.120000: ttyUSB0
FA 01 30 2B
2024-03-05 12:00:00.124000: ttyUSB0
FB 01 30 00 00 00 01 20 00 4D
""",
        f"{_DAY}.120 ? {_READ}",
        f"{_DAY}.124 ? {_READ_REPLY}",
    ),
    _paste(
        "spy",
        "pyserial's spy://",
        """
000000.120 TX   0000  FA 01 30 2B                                       ..0+
000000.124 RX   0000  FB 01 30 00 00 00 01 20  00 4D                    ..0.... .M
""",
        f"0.12 > {_READ}",
        f"0.124 < {_READ_REPLY}",
    ),
    _paste(
        "hexdump",
        "hexdump -C",
        """
00000000  fa 01 30 2b fb 01 30 00  00 00 01 20 00 4d        |..0+..0.... .M|
0000000e
""",
        f"- ? {_READ} {_READ_REPLY}",
    ),
    _paste(
        "xxd",
        "xxd",
        """
00000000: fa01 302b fb01 3000 0000 0120 004d       ..0+..0.... .M
""",
        f"- ? {_READ} {_READ_REPLY}",
    ),
    _paste(
        "tshark",
        "tshark -x, Wireshark's packet bytes",
        """
0000  fa 01 30 2b                                       ..0+

0000  fb 01 30 00 00 00 01 20 00 4d                     ..0.... .M
""",
        f"- ? {_READ}",
        f"- ? {_READ_REPLY}",
    ),
    _paste(
        "saleae",
        "Saleae Logic, exported table",
        """
Time [s],Value,Parity Error,Framing Error
0.120000000,0xFA,,
0.120260417,0x01,,
0.120520833,0x30,,
0.120781250,0x2B,,
""",
        "0.12 ? FA",
        "0.120260417 ? 01",
        "0.120520833 ? 30",
        "0.120781250 ? 2B",
    ),
    _paste(
        "pulseview",
        "PulseView and sigrok-cli annotations",
        """
0-208 uart-1: FA
260-468 uart-1: 01
521-729 uart-1: 30
781-989 uart-1: 2B
""",
        "- ? FA",
        "- ? 01",
        "- ? 30",
        "- ? 2B",
    ),
    # --- CAN -------------------------------------------------------------------------------------------------------
    _paste(
        "candump",
        "candump on the screen",
        """
 (000.120000)  can0  001   [5]  F6 01 40 02 3A
 (000.124000)  can0  001   [3]  F6 01 F8
""",
        "0.12 ? 001#F60140023A",
        "0.124 ? 001#F601F8",
    ),
    _paste(
        "candump-log",
        "candump -l, python-can's logger",
        """
(1709640000.120000) can0 001#F60140023A T
(1709640000.124000) can0 001#F601F8 R
""",
        f"{_DAY}.12 > 001#F60140023A",
        f"{_DAY}.124 ? 001#F601F8",
    ),
    _paste(
        "cansend",
        "cansend, as typed",
        """
$ cansend can0 001#F60140023A
$ cansend can0 001#F6.80.00.00.77
$ ip -details link show can0
""",
        "- > 001#F60140023A",
        "- > 001#F680000077",
    ),
    _paste(
        "cansniffer",
        "cansniffer",
        """
00|ms    | -- ID -- | data ...                     < can0 # l=20 h=100 t=500 slots=2 >
00004 |      001 | F6 01 F8                 ...
00120 |      002 | 31 00 00 00 00 01 2C 60  1.....,`
""",
        "- ? 001#F601F8",
        "- ? 002#3100000000012C60",
    ),
    _paste(
        "python-can",
        "python-can, print(message)",
        """
Timestamp: 1709640000.120000        ID: 0001    S Tx                DL:  5    f6 01 40 02 3a              Channel: can0
Timestamp: 1709640000.124000        ID: 0001    S Rx                DL:  3    f6 01 f8                    Channel: can0
Timestamp: 1709640000.130000    ID: 12345678    X Rx                DL:  1    ff                          Channel: can0
""",
        f"{_DAY}.12 > 001#F60140023A",
        f"{_DAY}.124 ? 001#F601F8",
        f"{_DAY}.13 ? 12345678#FF",
    ),
    _paste(
        "python-can-csv",
        "python-can's CSV",
        """
timestamp,arbitration_id,extended,remote,error,dlc,data
1709640000.12,0x1,0,0,0,5,9gFAAjo=
1709640000.124,0x1,0,0,0,3,9gH4
""",
        f"{_DAY}.12 ? 001#F60140023A",
        f"{_DAY}.124 ? 001#F601F8",
    ),
    _paste(
        "id-data",
        "a program's own ID and Data",
        """
Sent     ID: 0x01 Data: F6 01 40 02 3A
Received ID: 0x01 Data: F6 01 F8
""",
        "- > 001#F60140023A",
        "- ? 001#F601F8",
    ),
    _paste(
        "python-can-repr",
        "python-can, the message as Python shows it",
        """
can.Message(timestamp=1709640000.124, arbitration_id=0x1, is_extended_id=False, channel='can0', dlc=3, data=[0xf6, 0x1, 0xf8])
""",
        f"{_DAY}.124 ? 001#F601F8",
    ),
    _paste(
        "mcp-can",
        "Arduino MCP_CAN",
        """
Standard ID: 0x001       DLC: 3  Data: 0xF6 0x01 0xF8
Extended ID: 0x12345678  DLC: 1  Data: 0xFF
""",
        "- ? 001#F601F8",
        "- ? 12345678#FF",
    ),
    _paste(
        "seeed-can",
        "Arduino, Seeed's CAN library: identifier, bytes on the next line",
        """
-----------------------------
Get data from ID: 0x1
F6\t1\tF8\t
""",
        "- ? 001#F601F8",
    ),
    _paste(
        "arduino-can",
        "Arduino canread: identifier, length, data",
        """
------- CAN Read ----------
ID  DLC   DATA
1 5 F6 1 40 2 3A 
1 3 F6 1 F8 
""",
        "- ? 001#F60140023A",
        "- ? 001#F601F8",
    ),
    _paste(
        "can-three-digits",
        "identifier and data",
        """
001 F6 01 40 02 3A
001 F6 01 F8
""",
        "- ? 001#F60140023A",
        "- ? 001#F601F8",
    ),
    _paste(
        "slcan",
        "slcan, CANable",
        """
S6
O
t0015F60140023A
t0013F601F8
T123456781FF
""",
        "- ? 001#F60140023A",
        "- ? 001#F601F8",
        "- ? 12345678#FF",
    ),
    _paste(
        "slcan-times",
        "slcan with times",
        """
t0015F60140023A0078
t0013F601F8007C
""",
        "0.12 ? 001#F60140023A",
        "0.124 ? 001#F601F8",
    ),
    _paste(
        "savvycan",
        "SavvyCAN CSV (GVRET)",
        """
Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
120000,00000001,false,Tx,0,5,F6,01,40,02,3A,,,
124000,00000001,false,Rx,0,3,F6,01,F8,,,,,
130000,12345678,true,Rx,0,1,FF,,,,,,,
""",
        "0.12 > 001#F60140023A",
        "0.124 ? 001#F601F8",
        "0.13 ? 12345678#FF",
    ),
    _paste(
        "usb-can-tool",
        "USB-CAN Tool (CANalyst-II)",
        """
序号,系统时间,时间标识,CAN通道,传输方向,ID号,帧类型,帧格式,长度,数据
0,12:00:00.120,无,ch1,发送,0x0001,数据帧,标准帧,0x05,x| F6 01 40 02 3A 
1,12:00:00.124,0x1F4A2,ch1,接收,0x0001,数据帧,标准帧,0x03,x| F6 01 F8 
""",
        f"{_NOON}.12 > 001#F60140023A",
        f"{_NOON}.124 ? 001#F601F8",
    ),
    _paste(
        "busmaster",
        "BUSMASTER log",
        """
***BUSMASTER Ver 3.2.2***
***PROTOCOL CAN***
***START DATE AND TIME 5:3:2024 12:0:0:0***
***HEX***
***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***
12:00:00:1200 Tx 1 0x001 s 5 F6 01 40 02 3A 
12:00:00:1240 Rx 1 0x001 s 3 F6 01 F8 
12:00:00:1300 Rx 1 0x12345678 x 1 FF 
""",
        f"{_NOON}.12 > 001#F60140023A",
        f"{_NOON}.124 ? 001#F601F8",
        f"{_NOON}.13 ? 12345678#FF",
    ),
    _paste(
        "canking",
        "Kvaser CanKing",
        """
Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir
 0    00000001         5  F6  01  40  02  3A                    0.120000 T
 0    00000001         3  F6  01  F8                            0.124000 R
""",
        "0.12 > 001#F60140023A",
        "0.124 ? 001#F601F8",
    ),
    _paste(
        "trc",
        "PCAN-View trace",
        """
;$FILEVERSION=1.1
;$STARTTIME=45356.5
;
     1)       120.0  Tx         0001  5  F6 01 40 02 3A 
     2)       124.0  Rx         0001  3  F6 01 F8 
""",
        f"{_DAY}.12 > 001#F60140023A",
        f"{_DAY}.124 ? 001#F601F8",
    ),
    _paste(
        "asc",
        "Vector ASC",
        """
date Tue Mar 5 12:00:00 2024
base hex  timestamps absolute
   0.120000 1  1               Tx   d 5 F6 01 40 02 3A
   0.124000 1  1               Rx   d 3 F6 01 F8
""",
        f"{_DAY}.12 > 001#F60140023A",
        f"{_DAY}.124 ? 001#F601F8",
    ),
    # --- posts -----------------------------------------------------------------------------------------------------
    _paste(
        "quoted",
        "quotation of an e-mail or a post",
        """
> On Tuesday you wrote:
> FA 01 30 2B
> FB 01 30 00 00 00 01 20 00 4D
""",
        f"- ? {_READ}",
        f"- ? {_READ_REPLY}",
        says="quotation",
    ),
    _paste(
        "fenced",
        "Markdown: a fence, with arrows",
        """
This is what I see:
```
-> FA 01 30 2B
<- FB 01 30 00 00 00 01 20 00 4D
```
""",
        f"- > {_READ}",
        f"- < {_READ_REPLY}",
    ),
    _paste(
        "markdown-table",
        "Markdown table",
        """
| time | dir | bytes | meaning |
|------|-----|-------|---------|
| 0.120 | TX | `FA 01 30 2B` | read the encoder |
| 0.124 | RX | `FB 01 30 00 00 00 01 20 00 4D` | |
""",
        f"0.12 > {_READ}",
        f"0.124 < {_READ_REPLY}",
    ),
    _paste(
        "prose",
        "a forum post",
        """
Hi, I have a SERVO42D on RS485. If I send FA 01 30 2B it answers with FB 01 30 00 00 00 01 20 00 4D, all fine.
But when I write "fa 01 f6 01 40 02 34" it returns `FB01F601F3` and does not move for 20 30 seconds.
Any idea?
""",
        f"- > {_READ}",
        f"- < {_READ_REPLY}",
        f"- > {_RUN}",
        f"- < {_RUN_REPLY}",
        says="line 1, columns 43, 71",
    ),
    _paste(
        "prose-lines",
        "a post with frames on lines of their own",
        """
when i try to read the motor status:
01 04 00 32 00 01 90 05
returns:
01 04 02 01 40 B9 50

please advise how to proceed
""",
        f"- > {_MODBUS}",
        f"- < {_MODBUS_REPLY}",
    ),
)


def listing() -> str:
    """Return the list of kinds as it stands in the README: how many, and each with the example of its table row."""
    rows = [f"{len(PASTES)} kinds of pastes are read (`pastes.py`, a row each, with the frames that it must give):", ""]
    for paste in PASTES:
        rows += [f"- {paste.title}", "", *(f"      {line}" for line in paste.text.rstrip("\n").split("\n")), ""]
    return "\n".join(rows).replace("      \n", "\n")


if __name__ == "__main__":
    print(listing())
