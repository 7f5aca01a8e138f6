"""The fixtures that other people's tests get from the plugin."""

from __future__ import annotations

import serial

from analyzer.records import CanFrame


def test_a_program_opens_the_port_of_drives(servo_port):
    with serial.Serial(servo_port("mks-rs485@1", "mks-rs485@2"), 38400, timeout=5) as port:
        port.write(bytes.fromhex("FA 02 32 2E"))
        assert port.read(6) == bytes.fromhex("FB 02 32 00 00 2F")


def test_a_line_in_virtual_time(servo_line):
    line = servo_line("mks-can@1")
    line.write(CanFrame(None, "can", 1, bytes.fromhex("32 33")))
    answer = line.receive(1_000_000_000)
    assert answer.data == bytes.fromhex("32 00 00 33")
    assert line.now_ns() < 10_000_000
