"""Serial ports and CAN interfaces, read from trees of files as the kernel makes them."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from analyzer.cli import ports
from analyzer.live.adapters import can_interfaces, detected, serial_adapters
from analyzer.live.endpoint import parse


class Tree:
    """A machine's /sys, /dev and /proc below a folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for folder in ("sys/class/tty", "sys/class/net", "dev", "proc"):
            (root / folder).mkdir(parents=True)

    def write(self, place: str, text: str = "") -> None:
        path = self.root / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")

    def link(self, place: str, to: str) -> None:
        path = self.root / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.symlink_to(os.path.relpath(self.root / to, path.parent))

    def driver(self, device: str, name: str) -> None:
        (self.root / f"sys/bus/drivers/{name}").mkdir(parents=True, exist_ok=True)
        self.link(f"{device}/driver", f"sys/bus/drivers/{name}")

    def usb(self, place: str, numbers: str, **about: str) -> str:
        device = f"sys/devices/pci0/usb1/{place}"
        vendor, _, product = numbers.partition(":")
        self.write(f"{device}/idVendor", vendor)
        self.write(f"{device}/idProduct", product)
        for name, text in about.items():
            self.write(f"{device}/{name}", text)
        return device

    def tty(self, name: str, device: str, driver: str, latency: str = "") -> None:
        """A port below its USB interface, as usb-serial drivers make it (ttyUSB) or CDC does (ttyACM)."""
        interface = f"{device}/{os.path.basename(device)}:1.0"
        below = f"{interface}/{name}" if name.startswith("ttyUSB") else interface
        if latency:
            self.write(f"{below}/latency_timer", latency)
        (self.root / below / "tty" / name).mkdir(parents=True, exist_ok=True)
        self.driver(below, driver)
        self.link(f"{below}/tty/{name}/device", below)
        self.link(f"sys/class/tty/{name}", f"{below}/tty/{name}")
        self.write(f"dev/{name}")

    def can(self, name: str, state: str = "up") -> None:
        entry = f"sys/class/net/{name}"
        self.write(f"{entry}/type", "280")
        self.write(f"{entry}/operstate", state)


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    return Tree(tmp_path)


def hub(tree: Tree) -> None:
    """An adapter behind a hub."""
    tree.usb("1-1", "1d6b:0002")
    ftdi = tree.usb("1-1/1-1.4", "0403:6001", manufacturer="FTDI", product="FT232R USB UART", serial="A50285BI")
    tree.tty("ttyUSB0", ftdi, "ftdi_sio", "16")
    tree.link("dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0", "dev/ttyUSB0")


def test_an_ftdi_adapter(tree: Tree) -> None:
    hub(tree)
    (found,) = serial_adapters(tree.root)
    assert (found.path, found.chip, found.driver) == ("/dev/ttyUSB0", "FTDI FT232R", "ftdi_sio")
    assert (found.vendor_id, found.product_id, found.number) == (0x0403, 0x6001, "A50285BI")
    assert (found.maker, found.product) == ("FTDI", "FT232R USB UART")
    assert found.by_id == "/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0"
    assert found.latency_ms == 16
    assert found.endpoint == "serial:,serial=A50285BI,baud=auto"
    assert parse(found.endpoint).adapter == "A50285BI"
    text = "\n".join(ports.report([found], []))
    assert "timer at 16 ms" in text
    assert "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer" in text
    assert 'ATTR{latency_timer}="1"' in text


def test_a_timer_of_1_ms_needs_no_advice(tree: Tree) -> None:
    tree.tty("ttyUSB0", tree.usb("1-1", "0403:6014", serial="X"), "ftdi_sio", "1")
    text = "\n".join(ports.report(serial_adapters(tree.root), []))
    assert "latency     timer at 1 ms" in text
    assert "sudo tee" not in text


def test_adapters_without_a_number_or_with_the_same_one_are_named_by_their_link(tree: Tree) -> None:
    tree.tty("ttyUSB0", tree.usb("1-1", "1a86:7523", product="USB Serial"), "ch341")
    tree.tty("ttyUSB1", tree.usb("1-2", "10c4:ea60", serial="0001"), "cp210x")
    tree.tty("ttyUSB2", tree.usb("1-3", "10c4:ea60", serial="0001"), "cp210x")
    tree.link("dev/serial/by-id/usb-1a86_USB_Serial-if00-port0", "dev/ttyUSB0")
    tree.link("dev/serial/by-id/usb-SiLabs_0001-if00-port0", "dev/ttyUSB1")
    found = serial_adapters(tree.root)
    assert [a.chip for a in found] == ["WCH CH340", *["Silicon Labs CP210x (CP2102, CP2104)"] * 2]
    assert [a.endpoint for a in found] == [
        "serial:/dev/serial/by-id/usb-1a86_USB_Serial-if00-port0,baud=auto",
        "serial:/dev/serial/by-id/usb-SiLabs_0001-if00-port0,baud=auto",
        "serial:/dev/ttyUSB2,baud=auto",
    ]
    assert all(a.latency_ms is None for a in found)
    assert "number 0001 (not the only one that has it)" in "\n".join(ports.report(found, []))


def test_a_number_that_a_shell_would_take_apart_is_not_used(tree: Tree) -> None:
    tree.tty("ttyUSB0", tree.usb("1-1", "0403:6001", serial="A B;C"), "ftdi_sio")
    assert serial_adapters(tree.root)[0].endpoint == "serial:/dev/ttyUSB0,baud=auto"


def test_an_slcan_adapter_is_given_as_can(tree: Tree) -> None:
    tree.tty("ttyACM0", tree.usb("1-1", "16d0:117e", serial="00A"), "cdc_acm")
    (found,) = serial_adapters(tree.root)
    assert found.endpoint == "can:slcan:/dev/ttyACM0,bitrate=500000"
    assert parse(found.endpoint).interface == ("slcan", "/dev/ttyACM0")


def test_built_in_ports_only_where_there_is_one(tree: Tree) -> None:
    for name, kind in (("ttyS0", "4"), ("ttyS1", "0")):
        tree.write(f"sys/devices/platform/serial8250/tty/{name}/type", kind)
        tree.driver(f"sys/devices/platform/serial8250/{name}", "serial8250")
        tree.link(f"sys/devices/platform/serial8250/tty/{name}/device", f"sys/devices/platform/serial8250/{name}")
        tree.link(f"sys/class/tty/{name}", f"sys/devices/platform/serial8250/tty/{name}")
    tree.write("sys/class/tty/tty0/dev", "4:0")
    tree.write("dev/ttyS0")
    tree.tty("ttyUSB10", tree.usb("1-1", "0403:6001"), "ftdi_sio")
    tree.tty("ttyUSB9", tree.usb("1-2", "abcd:1234"), "new_driver")
    found = serial_adapters(tree.root)
    assert [(a.path, a.chip) for a in found] == [
        ("/dev/ttyUSB9", "USB adapter abcd:1234"),
        ("/dev/ttyUSB10", "FTDI FT232R"),
        ("/dev/ttyS0", "built-in port (8250)"),
    ]


def test_who_holds_a_port_open(tree: Tree) -> None:
    hub(tree)
    (tree.root / "proc/77/fd").mkdir(parents=True)
    (tree.root / "proc/77/fd/3").symlink_to("/dev/ttyUSB0")
    (tree.root / "proc/77/fd/4").symlink_to("socket:[123]")
    tree.write("proc/77/comm", "octoprint")
    (tree.root / "proc/78").mkdir()
    (found,) = serial_adapters(tree.root)
    assert found.holders == ("octoprint (process 77)",)
    assert "open by     octoprint (process 77)" in "\n".join(ports.report([found], []))


def test_a_port_that_may_not_be_read_says_how_to_get_there(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    hub(tree)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    (found,) = serial_adapters(tree.root)
    assert not found.openable
    assert "permission  none" in "\n".join(ports.report([found], []))
    from dataclasses import replace

    text = "\n".join(ports.report([replace(found, group="dialout")], []))
    assert "sudo usermod -a -G dialout $USER, then log in again" in text


LINKS = """[{"ifname":"lo","flags":["UP"]},
 {"ifname":"can0","flags":["NOARP","UP","LOWER_UP","ECHO"],"operstate":"UP","link_type":"can",
  "linkinfo":{"info_kind":"can","info_data":{"ctrlmode":["LISTEN-ONLY","BERR-REPORTING"],"state":"ERROR-PASSIVE",
   "berr_counter":{"tx":0,"rx":135},"restart_ms":100,"bittiming":{"bitrate":250000,"sample_point":"0.875"}},
   "info_xstats":{"restarts":0,"bus_error":2,"arbitration_lost":0,"error_warning":1,"error_passive":1,"bus_off":0}}},
 {"ifname":"can1","flags":["NOARP","ECHO"],"operstate":"DOWN",
  "linkinfo":{"info_kind":"can","info_data":{"state":"STOPPED","berr_counter":{"tx":0,"rx":0}}}},
 {"ifname":"vcan0","flags":["NOARP","UP"],"operstate":"UNKNOWN","linkinfo":{"info_kind":"vcan"}}]"""


def test_socketcan_interfaces(tree: Tree) -> None:
    tree.write("sys/class/net/lo/type", "772")
    for name in ("can0", "can1", "vcan0"):
        tree.can(name)
    usb = tree.usb("1-9", "1d50:606f", product="candleLight", serial="0042")
    tree.driver(f"{usb}/1-9:1.0", "gs_usb")
    tree.link("sys/class/net/can0/device", f"{usb}/1-9:1.0")
    can0, can1, vcan0 = can_interfaces(tree.root, LINKS)
    assert (can0.endpoint, can0.kind, can0.driver, can0.adapter) == (
        "can:socketcan:can0,bitrate=250000", "can", "gs_usb", "candleLight 0042",
    )  # fmt: skip
    assert (can0.up, can0.state, can0.bitrate, can0.listen_only) == (True, "ERROR-PASSIVE", 250_000, True)
    assert can0.counters == {"tx_errors": 0, "rx_errors": 135, "bus_error": 2, "error_warning": 1, "error_passive": 1}
    assert (can1.up, can1.state, can1.listen_only) == (False, "STOPPED", False)
    assert (vcan0.up, vcan0.listen_only, vcan0.endpoint) == (True, None, "can:socketcan:vcan0")
    text = "\n".join(ports.report([], [can0, can1, vcan0]))
    assert "sudo ip link set can1 up type can bitrate 500000 listen-only on" in text
    assert "rx_errors 135" in text


@pytest.mark.parametrize("text", ["", "not json", "[]", "{}", "[1]"])
def test_without_ip_sysfs_tells_what_it_knows(tree: Tree, text: str) -> None:
    tree.can("can0", "down")
    (found,) = can_interfaces(tree.root, text)
    assert (found.name, found.up, found.bitrate, found.listen_only) == ("can0", False, None, None)


def test_what_python_can_detects() -> None:
    found = detected(
        [
            {"interface": "pcan", "channel": "PCAN_USBBUS1", "supports_fd": True},
            {"interface": "kvaser", "channel": 0, "serial": "a b"},
            {"interface": "none"},
        ]
    )
    assert [i.endpoint for i in found] == ["can:pcan:PCAN_USBBUS1,supports_fd=True", "can:kvaser:0"]


def test_nothing_found_says_what_to_check() -> None:
    text = "\n".join(ports.report([], [], "not all answered"))
    assert "dmesg" in text
    assert "modprobe" in text
    assert "note: not all answered" in text


def test_the_command_on_this_machine(cli) -> None:

    listed = json.loads(cli("ports", "--json", "--no-detect").out)
    assert set(listed) == {"serial", "can"}
    for entry in (*listed["serial"], *listed["can"]):
        parse(entry["endpoint"])


def test_vendors_interfaces_are_asked_in_a_process_of_their_own() -> None:
    from analyzer.live.can_adapters import detect

    configs, why = detect()
    assert why == ""
    assert not any(entry["interface"] in ("socketcan", "virtual", "udp_multicast") for entry in configs)
