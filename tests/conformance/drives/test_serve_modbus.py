"""Other people's Modbus masters against the Modbus drive behind a pseudo-terminal."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator

import pytest

from tests.conformance.drives.served import on_pty

WORK_MODE, SPEED, POSITION, ENABLED = 0x82, 0x32, 0x31, 0xF3


@pytest.fixture
def path() -> Iterator[str]:
    with on_pty("mks-modbus@1,work_mode=sr_vfoc", "mks-modbus@2,work_mode=sr_vfoc") as terminal:
        yield terminal


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")
def test_mbpoll(path: str) -> None:
    def mbpoll(*words: str) -> str:
        line = ["mbpoll", "-m", "rtu", "-b", "38400", "-P", "none", "-0", "-1", "-o", "1", *words]
        return subprocess.run(line, capture_output=True, text=True, timeout=20, check=True).stdout

    for address in ("1", "2"):
        read = mbpoll("-a", address, "-t", "3:hex", "-r", str(POSITION), "-c", "3", path)
        assert re.findall(r"\[\d+\]:\s+(0x[0-9A-F]+)", read) == ["0x0000"] * 3
        written = mbpoll("-a", address, "-t", "4", "-r", str(WORK_MODE), path, "5")
        assert "Written 1 references." in written
    with pytest.raises(subprocess.CalledProcessError):
        mbpoll("-a", "3", "-t", "3", "-r", str(SPEED), "-c", "1", path)


def test_pymodbus(path: str) -> None:
    client_module = pytest.importorskip("pymodbus.client")
    with client_module.ModbusSerialClient(path, baudrate=38400, timeout=1, retries=0) as client:
        for address in (1, 2):
            read = client.read_input_registers(POSITION, count=3, device_id=address)
            assert not read.isError(), read
            assert read.registers == [0, 0, 0]
            assert not client.write_register(WORK_MODE, 5, device_id=address).isError()
            # Speed run by function 10h: direction and acceleration, speed.
            assert not client.write_registers(0xF6, [0x0002, 100], device_id=address).isError()
            assert not client.write_registers(0xF6, [0x0002, 0], device_id=address).isError()
            missing = client.read_input_registers(0x0001, count=1, device_id=address)
            assert missing.isError()
            assert missing.exception_code == 2
            assert client.read_holding_registers(SPEED, count=1, device_id=address).exception_code == 1


def test_minimalmodbus(path: str) -> None:
    minimalmodbus = pytest.importorskip("minimalmodbus")
    for address in (1, 2):
        drive = minimalmodbus.Instrument(path, address, close_port_after_each_call=True)
        drive.serial.baudrate = 38400
        drive.serial.timeout = 1
        assert drive.read_register(SPEED, functioncode=4, signed=True) == 0
        assert drive.read_registers(POSITION, 3, functioncode=4) == [0, 0, 0]
        drive.write_register(WORK_MODE, 5, functioncode=6)
        drive.write_register(ENABLED, 1, functioncode=6)
        with pytest.raises(minimalmodbus.ModbusException):
            drive.read_register(0x0001, functioncode=4)
