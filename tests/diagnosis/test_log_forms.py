"""The same troubles in the logs of many libraries and tools: the diagnosis does not depend on the format."""

from __future__ import annotations

import pytest

from tests.collect import rtu
from tests.diagnosis.test_pastes import diagnosed

ASK, REPLY, REFUSAL = rtu("11 03 00 6B 00 03"), rtu("11 03 06 02 2B 00 00 00 64"), rtu("11 83 02")
ASK_2, REPLY_2 = rtu("11 03 00 70 00 01"), rtu("11 03 02 01 F4")
CASES = {
    "clean": ([(">", ASK), ("<", REPLY), (">", ASK_2), ("<", REPLY_2)], None),
    "glitch": ([(">", ASK), ("<", b"\0" + REPLY), (">", ASK_2), ("<", b"\0" + REPLY_2)], "leading_glitch"),
    "echo": ([(">", ASK), ("<", ASK + REPLY), (">", ASK_2), ("<", ASK_2 + REPLY_2)], "echo"),
    "refused": ([(">", ASK), ("<", REFUSAL)], "wrong_register"),
    "cut": ([(">", ASK), ("<", REPLY[:6]), (">", ASK_2), ("<", REPLY_2[:4])], "reply_cut"),
}


def pairs(data, gap=" ", before="", small=False):
    return gap.join(f"{before}{byte:02x}" if small else f"{before}{byte:02X}" for byte in data)


#: What stands for a row: of the mark, the number of the row, and its bytes.
FORMS = {
    "python-session": lambda m, n, d: (
        f'>>> port.write(bytes.fromhex("{pairs(d, small=True)}"))\n{len(d)}'
        if m == ">"
        else f">>> port.read(64).hex(' ')\n'{pairs(d, small=True)}'"
    ),
    "python-session-of-lists": lambda m, n, d: (
        f"write({pairs(d, ', ', '0x')})" if m == ">" else f">>> list(port.read(64))\n{list(d)}"
    ),
    "minimalmodbus": lambda m, n, d: (
        f"MinimalModbus debug mode. Will write to instrument (expecting 11 bytes back): {pairs(d)} ({len(d)} bytes)"
        if m == ">"
        else f"MinimalModbus debug mode. Response from instrument: {pairs(d)} ({len(d)} bytes), roundtrip time: 20.1 ms."
    ),
    "minimalmodbus-1": lambda m, n, d: (
        f"MinimalModbus debug mode. Writing to instrument (expecting 11 bytes back): {repr(d)[1:]} ({pairs(d)})"
        if m == ">"
        else f"MinimalModbus debug mode. Response from instrument: {repr(d)[1:]} ({pairs(d)}) ({len(d)} bytes)"
    ),
    "pymodbus-2": lambda m, n, d: f"DEBUG:pymodbus.transaction:{'SEND' if m == '>' else 'RECV'}: {' '.join(map(hex, d))}",
    "pymodbus-3": lambda m, n, d: (
        f"2024-04-07 10:31:2{n},700 DEBUG logging:103 "
        f"{'send' if m == '>' else 'recv'}: {' '.join(map(hex, d))}{'' if m == '>' else ' old_data:  addr=None'}"
    ),
    "libmodbus": lambda m, n, d: (
        "".join(f"[{b:02X}]" for b in d) + "\nWaiting for a confirmation..." if m == ">" else "".join(f"<{b:02X}>" for b in d)
    ),
    "esphome": lambda m, n, d: f"[20:25:0{n}.868][D][uart_debug:114]: {m * 3} {pairs(d, ':')}",
    "esphome-bytes": lambda m, n, d: (
        f"[20:25:0{n}][V][modbus:199]: Modbus write: {pairs(d, '.')} ({len(d)})"
        if m == ">"
        else "\n".join(f"[20:25:0{n}][V][modbus:042]: Modbus received Byte  {b} (0X{b:x})" for b in d)
    ),
    "emodbus": lambda m, n, d: (
        f"[N] {'Request' if m == '>' else 'Raw buffer received'}: @3FFB33BC/{len(d)}:\n  | 0000: {pairs(d)}    |....|"
    ),
    "modbus-tk": lambda m, n, d: (
        f"2015-01-01 10:00:0{n},000\tDEBUG\tmodbus.execute\tMainThread\t{'->' if m == '>' else '<-'} {'-'.join(map(str, d))}"
    ),
    "node-modbus-serial": lambda m, n, d: (
        f"  modbus-serial {{ action: '{'send serial rtu' if m == '>' else 'receive serial rtu port'}',\n"
        f"  modbus-serial   data: <Buffer {pairs(d, small=True)}>,"
    ),
    "nmodbus": lambda m, n, d: f"INFO Modbus.IO.ModbusSerialTransport - {'TX' if m == '>' else 'RX'}: {', '.join(map(str, d))}",
    "goburrow": lambda m, n, d: (
        f"test: 2020/08/29 19:06:1{n} modbus: {'sending' if m == '>' else 'received'} {pairs(d, small=True)}"
    ),
    "modbus-poll": lambda m, n, d: f"{'Tx' if m == '>' else 'Rx'}:{n:06d}-{pairs(d)}",
    "modbus-tools": lambda m, n, d: f"14.05.2025 09:57:0{n}.113 'Device' {'Tx' if m == '>' else 'Rx'}: {pairs(d)} ",
    "buffers": lambda m, n, d: f"{'write' if m == '>' else 'resp'} <Buffer {pairs(d, small=True)}>",
    "sentences": lambda m, n, d: f"{'I send' if m == '>' else 'and the device answers'} {pairs(d)}{'' if m == '>' else '.'}",
    "blocks": lambda m, n, d: f"{'Request' if m == '>' else 'Response'}:\n{pairs(d)}\n",
    "table": lambda m, n, d: f"| {n} | {'TX' if m == '>' else 'RX'} | {pairs(d)} |",
    "recvd": lambda m, n, d: f"{'sent: ' if m == '>' else 'recvd:'} {d!r}",
    "braces": lambda m, n, d: f"{'Poll' if m == '>' else 'Response'}->{''.join(f'{{{b:02X}}}' for b in d)}",
    "digits": lambda m, n, d: f"{'Sent' if m == '>' else 'Received'}: {pairs(d, '')}",
    "strace": lambda m, n, d: (
        f'write(3, "{pairs(d, "", chr(92) + "x", small=True)}", {len(d)}) = {len(d)}'
        if m == ">"
        else f'read(3, "{pairs(d, "", chr(92) + "x", small=True)}", 256) = {len(d)}'
    ),
    "camel": lambda m, n, d: f"{'Write' if m == '>' else 'ReadFrame'}: {pairs(d, small=True)}",
    "j2mod": lambda m, n, d: (
        f"10:00:0{n} [main] DEBUG ModbusRTUTransport - {'Sent' if m == '>' else 'Read'} message: {pairs(d)}"
    ),
    "socat": lambda m, n, d: (
        f"{m} 2024/01/01 10:00:0{n}.000000  length={len(d)} from=0 to={len(d) - 1}\n {pairs(d, small=True)}"
    ),
    "docklight": lambda m, n, d: f"1/1/2024 10:00:0{n}.12 [{'TX' if m == '>' else 'RX'}] - {pairs(d)} ",
    "chinese": lambda m, n, d: f"[10:00:0{n}.123]{'发→◇' if m == '>' else '收←◆'}{pairs(d)} ",
    "arduino": lambda m, n, d: f"{'Sending' if m == '>' else 'Received'}: {' '.join(f'0x{b:X}' for b in d)}",
    "rust": lambda m, n, d: f"{'TX' if m == '>' else 'RX'}: [{pairs(d, ', ')}]",
    "lists": lambda m, n, d: f"{'Sending' if m == '>' else 'Device response'}: {list(d)}",
    "python": lambda m, n, d: f"{'sent' if m == '>' else 'received'} {d!r}",
    "json": lambda m, n, d: (
        f'{{"ts":{1700000000 + n}.5,"dir":"{"tx" if m == ">" else "rx"}","data":"{pairs(d, "", small=True)}"}}'
    ),
    "csv": lambda m, n, d: f"10:00:0{n}.100,{'TX' if m == '>' else 'RX'},{pairs(d)}",
    "port-monitor": lambda m, n, d: (
        f"{n + 1}\t10:00:0{n}\tpython.exe\t{'IRP_MJ_WRITE' if m == '>' else 'IRP_MJ_READ'}\tCOM3\tSUCCESS\t"
        f"Length {len(d)}: {pairs(d)} \t"
    ),
    "counted": lambda m, n, d: f"{'Request' if m == '>' else 'Response'} [{len(d)} bytes]: {pairs(d)}",
    "speakers": lambda m, n, d: f"{'Master -> Slave' if m == '>' else 'Slave -> Master'}: {pairs(d)}",
    "arrows": lambda m, n, d: f"{'PC → Drive' if m == '>' else 'Drive → PC'}: {pairs(d)}",
    "esp-idf": lambda m, n, d: f"I (1{n}00) {'MODBUS_TX' if m == '>' else 'MODBUS_RX'}: {pairs(d, small=True)}",
    "quoted": lambda m, n, d: f"> {'TX' if m == '>' else 'RX'}: {pairs(d)}",
    "bullets": lambda m, n, d: f"- {'Sent' if m == '>' else 'Got'}: `{pairs(d)}`",
    "numbered": lambda m, n, d: f"{n + 1}. {'request' if m == '>' else 'response'}: {pairs(d)}",
    "bold": lambda m, n, d: f"**{'TX' if m == '>' else 'RX'}:** {pairs(d)}",
    "german": lambda m, n, d: f"{'Gesendet' if m == '>' else 'Empfangen'}: {pairs(d)}",
    "h": lambda m, n, d: f"{'TX' if m == '>' else 'RX'}: {' '.join(f'{b:02X}h' for b in d)}",
    "0x": lambda m, n, d: f"{'TX' if m == '>' else 'RX'}: 0x{pairs(d, '')}",
    "dashes": lambda m, n, d: f"{'TX' if m == '>' else 'RX'}: {pairs(d, '-')}",
    "pipes": lambda m, n, d: f"{'TX' if m == '>' else 'RX'}|{pairs(d, '|')}|",
    "component": lambda m, n, d: (
        f"2024-01-01 10:00:0{n}.123 DEBUG (MainThread) [x.modbus] {'Sending' if m == '>' else 'Received'} frame: {pairs(d)}"
    ),
    "slashes": lambda m, n, d: f"{'I send' if m == '>' else 'and it answers'} {pairs(d, '', chr(92))}{'' if m == '>' else '.'}",
    "analyzer in a post": lambda m, n, d: (
        ("I looked at the wire:\n\nname,type,start_time,duration,data\n" if n == 0 else "")
        + "\n".join(
            f'"{"TX" if m == ">" else "RX"}","data",{0.1 * n + 0.001 * at:.4f},8.7e-05,0x{b:02X}' for at, b in enumerate(d)
        )
    ),
    "analyzer with strokes": lambda m, n, d: (
        ("What it has shown:\n\nname | type | start_time | duration | data\n" if n == 0 else "")
        + "\n".join(
            f"{'TX' if m == '>' else 'RX'} | data | {0.1 * n + 0.001 * at:.4f} | 8.7E-05 | 0x{b:02X}" for at, b in enumerate(d)
        )
    ),
    "typed by hand": lambda m, n, d: f"{'TX' if m == '>' else 'RX'}: {pairs(d).replace('0', 'O')}",
    "a dump below a number": lambda m, n, d: f"{'WRITE' if m == '>' else 'READ'} {len(d)}\n0000  {pairs(d)}  |{'.' * len(d)}|",
    "a logger named servo": lambda m, n, d: (
        f"[2025-07-08T10:20:0{n}Z DEBUG servo] {'tx' if m == '>' else 'rx'} [{pairs(d, ', ', '0x', small=True)}]"
    ),
    "a program named motor": lambda m, n, d: (
        f"{n}\t0.{n}0000000\tmotor.exe\tIRP_MJ_{'WRITE' if m == '>' else 'READ'}\tSerial0\t"
        f"SUCCESS\tLength {len(d)}: {pairs(d)} \t"
    ),
    "visa": lambda m, n, d: f"{'VISA Write' if m == '>' else 'VISA Read'}\t{pairs(d)}",
    "send hex": lambda m, n, d: f"[2025-07-08 10:20:0{n}.241] {'发送' if m == '>' else '接收'}HEX: {pairs(d)}",
    "esphome-dots": lambda m, n, d: (
        f"[20:25:0{n}.868][V][modbus:199]: Modbus {'write raw' if m == '>' else 'received'}: {pairs(d, '.')} ({len(d)})"
    ),
    "android": lambda m, n, d: f"D/Modbus  ( 1234): {'write' if m == '>' else 'read'} {len(d)} bytes: {pairs(d)}",
}


def shows(text, cause):
    """Prove that a text shows this cause first, or nothing wrong where it is None."""
    found = diagnosed(text)
    assert (found.causes[0].suspicion.cause if found.causes else None) == cause
    assert found.verdict == ("ok" if cause is None else "trouble")


def log(form, rows, at_once=1):
    """Return the rows in a form; so many have one time."""
    return "".join(f"{FORMS[form](mark, number // at_once, data)}\n" for number, (mark, data) in enumerate(rows))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("form", FORMS)
def test_a_trouble_in_a_log(form, case):
    rows, cause = CASES[case]
    shows(log(form, rows), cause)


CAN_CASES = {
    "clean": ([(">", 1, "30 31"), ("<", 1, "30 00 00 00 00 3A DD 48"), (">", 1, "32 33"), ("<", 1, "32 00 00 33")], None),
    "no check": ([(">", 1, "30"), (">", 1, "32")], "missing_checksum"),
    "another maker": ([(">", 0x141, "9A" + " 00" * 7), ("<", 0x141, "9A 32 00 0E 01 00 00 00")], "unsupported_dialect"),
}
#: What stands for a CAN frame: of the mark, its identifier and its bytes.
CAN_FORMS = {
    "candump": lambda m, i, d: f"can0  {i:03X}   [{len(d.split())}]  {d}\n",
    "bullets": lambda m, i, d: f"- `can0  {i:03X}   [{len(d.split())}]  {d}`\n",
    "stars": lambda m, i, d: f"* can0  {i:03X}   [{len(d.split())}]  {d}\n",
    "sentences": lambda m, i, d: (
        f"{'I send' if m == '>' else 'and the motor answers with'} can0  {i:03X}   [{len(d.split())}]  {d}"
        f"{' ' if m == '>' else '. '}"
    ),
    "ids": lambda m, i, d: f"ID: 0x{i:03X} DLC: {len(d.split())} Data: {d}\n",
    "german": lambda m, i, d: f"{'Gesendet' if m == '>' else 'Empfangen'}: ID {i:03X}  Daten {d}\n",
    "ids in sentences": lambda m, i, d: (
        f"{'I send' if m == '>' else 'and I get'} ID: 0x{i:03X}, DLC: {len(d.split())}, Data: {d}{' ' if m == '>' else '. '}"
    ),
    "pcan-view": lambda m, i, d: f"{i:03X}h  {len(d.split())}  {d}   100.2  17\n",
    "pcan-view with marks": lambda m, i, d: f"{'Tx' if m == '>' else 'Rx'}  {i:03X}h  {len(d.split())}  {d}  Cycle 100\n",
}


@pytest.mark.parametrize("case", CAN_CASES)
@pytest.mark.parametrize("form", CAN_FORMS)
def test_a_trouble_in_can_rows(form, case):
    rows, cause = CAN_CASES[case]
    shows("".join(CAN_FORMS[form](mark, number, data) for mark, number, data in rows), cause)


def test_the_name_of_a_host_on_all_lines_tells_no_sender():
    rows = [("host", "1.2.1", ASK), ("1.2.1", "host", REPLY), ("host", "1.2.1", ASK_2), ("1.2.1", "host", REPLY_2)]
    text = "".join(f"{n}  0.00{n}000  {one}  {other}  USB  Data: {pairs(d, '')}\n" for n, (one, other, d) in enumerate(rows))
    assert diagnosed(text).verdict == "ok"


def test_an_echo_that_a_library_reads_late_is_one():
    rows = ((">", ASK, 1), ("<", ASK + REPLY, 2), (">", ASK_2, 3), ("<", ASK_2 + REPLY_2, 4))
    text = "".join(f"[10:00:0{second}] {'TX' if mark == '>' else 'RX'}: {pairs(data)}\n" for mark, data, second in rows)
    assert diagnosed(text).causes[0].suspicion.cause == "echo"


def test_a_request_that_is_sent_again_later_is_no_echo():
    text = "".join(f"[10:00:0{second}] TX: {pairs(ASK)}\n" for second in range(1, 4))
    assert "echo" not in [each.suspicion.cause for each in diagnosed(text).causes]


@pytest.mark.parametrize(
    "marks", ["PC=>MOT MOT=>PC", "PC->MOTOR MOTOR->PC", "HOST>DRV DRV>HOST", "TCP>COM3 COM3>TCP", "h→m m→h", "host<-x x<-host"]
)
def test_an_arrow_between_two_names_tells_the_way_by_the_one_that_is_known(marks):
    one, other = marks.split()
    ask, answer = (one, other) if "<" not in marks else (other, one)
    rows = ((ask, "3E 9A 07 00 DF"), (answer, "3E 9A 07 07 E6 22 70 08 01 00 00 00 9B"), (ask, "3E 92 07 00 D7"),
            (answer, "3E 92 07 08 DF 10 02 00 00 00 00 00 00 12"))  # fmt: skip
    assert diagnosed("".join(f"11:02:0{n}.000  {mark}  {data}\n" for n, (mark, data) in enumerate(rows))).verdict == "ok"
    # Without its reply the request is one that nobody has answered: so it is read as the host's.
    assert diagnosed(f"{ask}: {pairs(ASK)}\n{answer}: {pairs(REPLY[:6])}\n").causes[0].suspicion.cause == "reply_cut"


def test_an_arrow_between_unknown_names_tells_the_way_by_who_reads_registers():
    text = f"A=>B {pairs(ASK)}\nB=>A {pairs(ASK + REPLY)}\nA=>B {pairs(ASK_2)}\nB=>A {pairs(ASK_2 + REPLY_2)}\n"
    assert diagnosed(text).causes[0].suspicion.cause == "echo"


def test_a_short_request_with_dots_is_no_version():
    asked, came = "FA.06.30.30 (4)", "FB.06.30.FF.FF.FF.FF.3F.73.DF (10)"
    text = f"[10:20:00][V][modbus:199]: Modbus write raw: {asked}\n[10:20:00][V][modbus:042]: Modbus received: {came}\n"
    assert diagnosed(text * 2).verdict == "ok"


def test_eight_digits_before_a_hash_are_an_identifier_of_29_bits():
    found = diagnosed("00000007#3E45\n00000007#343B\n00000007#F301FB\n").causes
    assert [each.suspicion.cause for each in found] == ["can_extended_id"]
