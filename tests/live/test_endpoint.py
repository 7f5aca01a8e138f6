"""Endpoints: one way of naming a bus, understood or refused with what was expected."""

from __future__ import annotations

import shlex

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer.catalogue import Role
from analyzer.errors import UsageError
from analyzer.live.endpoint import DEFAULT_BAUD, DEFAULT_BITRATE, parse, parse_all


@pytest.mark.parametrize(
    ("text", "kind", "place", "name", "speed"),
    [
        ("serial:/dev/ttyUSB0,baud=38400", "serial", "/dev/ttyUSB0", "ttyUSB0", 38400),
        ("left=serial:/dev/ttyUSB0", "serial", "/dev/ttyUSB0", "left", None),
        ("serial:COM8,baud=256000", "serial", "COM8", "COM8", 256000),
        ("serial:/dev/pts/3,baud=25000", "serial", "/dev/pts/3", "pts3", 25000),
        ("serial:/dev/serial/by-id/usb-FTDI_x-if00,baud=9600", "serial", "/dev/serial/by-id/usb-FTDI_x-if00", None, 9600),
        ("serial:,serial=A50285BI,baud=9600", "serial", "", "A50285BI", 9600),
        ("tcp:192.168.0.7:5000", "tcp", "192.168.0.7:5000", "192.168.0.7_5000", None),
        ("tcp:[::1]:5000,baud=115200", "tcp", "[::1]:5000", "1_5000", 115200),
        ("tcp:5000", "tcp", "127.0.0.1:5000", "127.0.0.1_5000", None),
        ("can:socketcan:can0", "can", "socketcan:can0", "can0", None),
        ("arm=can:slcan:/dev/ttyACM0,bitrate=500000", "can", "slcan:/dev/ttyACM0", "arm", 500000),
        ("can:udp_multicast:239.74.163.2", "can", "udp_multicast:239.74.163.2", "239.74.163.2", None),
        ("can:pcan:PCAN_USBBUS1,bitrate=1000000", "can", "pcan:PCAN_USBBUS1", "PCAN_USBBUS1", 1000000),
        ("can:kvaser:0,bitrate=500000", "can", "kvaser:0", "kvaser0", 500000),
    ],
)
def test_what_a_text_names(text, kind, place, name, speed):
    endpoint = parse(text)
    assert (endpoint.kind, endpoint.place, endpoint.speed) == (kind, place, speed)
    assert name is None or endpoint.name == name
    assert str(endpoint) == text
    # Nothing of it needs quoting in a shell.
    assert shlex.split(text) == [text]
    assert shlex.quote(text) == text or "[" in text


def test_the_options_of_a_serial_line():
    endpoint = parse("serial:A,baud=9600,parity=even,stop=2,direction=reply")
    assert (endpoint.parity, endpoint.stop_bits, endpoint.direction) == ("E", 2, Role.REPLY)
    assert endpoint.bits_per_byte == 12
    assert endpoint.byte_ns == 12 * 1_000_000_000 // 9600
    assert parse("serial:A").byte_ns == 10 * 1_000_000_000 // DEFAULT_BAUD


def test_the_time_of_a_byte_where_no_line_speed_is_known():
    assert parse("tcp:h:1").byte_ns == 0
    assert parse("tcp:h:1,baud=9600").byte_ns == 1_041_666
    assert parse("can:virtual:0").byte_ns == 0


def test_speeds_and_auto():
    assert parse("serial:A,baud=auto").auto
    assert parse("serial:A,baud=auto").speed is None
    found = parse("serial:A,baud=auto").at(19200)
    assert (found.speed, found.auto) == (19200, False)
    assert parse("can:virtual:0").bits_per_second == DEFAULT_BITRATE
    assert parse("serial:A").bits_per_second == DEFAULT_BAUD


def test_an_interface_and_a_host_in_their_parts():
    assert parse("can:slcan:/dev/ttyACM0@115200").interface == ("slcan", "/dev/ttyACM0@115200")
    assert parse("tcp:[fe80::1]:99").host == ("fe80::1", 99)


def test_options_of_a_can_interface_pass_with_their_types():
    endpoint = parse("can:pcan:PCAN_USBBUS1,bitrate=500000,f_clock_mhz=80,sample_point=87.5,auto_reset=on")
    assert endpoint.options == {"f_clock_mhz": 80, "sample_point": 87.5, "auto_reset": "on"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected serial:PORT"),
        ("/dev/ttyUSB0", "expected serial:PORT"),
        ("usb:1", "expected serial:PORT"),
        ("serial:", "no port"),
        ("serial:A,baud", "expected NAME=VALUE"),
        ("serial:A,baud=fast", "expected bits per second or auto"),
        ("serial:A,baud=0", "expected bits per second"),
        ("serial:A,baud=9600,baud=9600", "twice"),
        ("serial:A,parity=mark", "expected none, even or odd"),
        ("serial:A,stop=3", "expected 1 or 2"),
        ("serial:A,direction=both", "expected request or reply"),
        ("serial:A,speed=9600", "no option 'speed'"),
        ("tcp:host", "expected tcp:HOST:PORT"),
        ("tcp:192.168..7:5000", "expected tcp:HOST:PORT"),
        ("tcp:\udcff:5000", "expected tcp:HOST:PORT"),
        (f"tcp:{'a' * 64}:5000", "expected tcp:HOST:PORT"),
        ("tcp:host:0", "1..65535"),
        ("tcp:host:70000", "1..65535"),
        ("tcp:host:1,baud=auto", "expected bits per second"),
        ("tcp:host:1,parity=even", "no option"),
        ("can:slcan", "expected can:INTERFACE:CHANNEL"),
        ("can::x", "expected can:INTERFACE:CHANNEL"),
        ("can:slcan:x,bitrate=auto", "expected bits per second"),
        ("can:slcan:x,channel=y", "stands before the options"),
    ],
)
def test_what_is_refused_says_what_was_expected(text, said):
    with pytest.raises(UsageError, match=said):
        parse(text)


def test_only_a_serial_line_of_its_own_is_offered_auto():
    with pytest.raises(UsageError) as refused:
        parse("tcp:host:1,baud=auto")
    assert "or auto" not in str(refused.value)


@given(st.text(max_size=40) | st.builds("{}:{},{}={}".format, *[st.text(max_size=8)] * 4))
def test_any_text_is_understood_or_refused(text):
    try:
        endpoint = parse(text)
    except UsageError:
        return
    assert endpoint.name
    assert set(endpoint.name) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_.-")


def test_names_that_nobody_gave_differ():
    found = parse_all(["serial:/dev/a/x", "serial:/dev/b/x", "serial:/dev/c/x"])
    assert [e.name for e in found] == ["x", "x_2", "x_3"]


def test_two_directions_of_one_line_share_a_name():
    found = parse_all(["left=serial:A,direction=request", "left=serial:B,direction=reply"])
    assert [e.name for e in found] == ["left", "left"]


@pytest.mark.parametrize(
    "texts",
    [
        ["left=serial:A", "left=serial:B"],
        ["left=serial:A,direction=request", "left=serial:B,direction=request"],
        ["left=serial:A,direction=request", "left=serial:B,direction=reply", "left=serial:C,direction=reply"],
        ["left=can:virtual:0", "left=can:virtual:1"],
        ["a=serial:A", "b=serial:A"],
        ["a=serial:,serial=1", "b=serial:,serial=1"],
        [],
    ],
)
def test_endpoints_that_cannot_stand_together(texts):
    with pytest.raises(UsageError):
        parse_all(texts)
