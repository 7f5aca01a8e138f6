"""What is known of a port: which open request a reply answers."""

from __future__ import annotations

from analyzer.catalogue import Role
from analyzer.context import Context, Request, State, answers, is_request
from tests.collect import crc, serial, sum8


def request(text, name="mks-rs485"):
    return Request.of(serial(name, (0, text)).entries[0].message, 1, "/bus/1/x/request")


def test_a_reply_answers_by_code_and_layout():
    speed = request(sum8("FA 01 32"))
    assert answers(speed, None, 0x32, bytes(2)) is not None
    assert answers(speed, None, 0x32, bytes(3)) is None
    assert answers(speed, None, 0x31, bytes(2)) is None
    assert answers(speed, 4, 0x32, bytes(2)) is None


def test_a_request_of_an_unknown_command_is_answered_by_nothing():
    assert answers(request(sum8("FA 01 77")), None, 0x77, b"\0") is None


def test_of_two_open_requests_the_oldest_is_answered():
    context = Context()
    first, second = request(sum8("FA 01 32")), request(sum8("FA 01 32"))
    context.open[1] = [first, second]
    assert context.asked("mks-rs485", 1, None, 0x32, bytes(2))[0] is first
    assert context.asked("mks-rs485", 2, None, 0x32, bytes(2)) is None
    assert context.asked("lk-rs485", 1, None, 0x32, bytes(2)) is None


def test_the_newest_read_that_waits_tells_the_length_of_a_modbus_reply():
    context = Context()
    assert context.expects(1, 4) == 0
    short, long = request(crc("01 04 00 32 00 01"), "mks-modbus"), request(crc("01 04 00 30 00 03"), "mks-modbus")
    context.open[1] = [short, long]
    assert context.expects(1, 4) == 6
    long.state = State.DONE
    assert context.expects(1, 4) == 2
    assert context.expects(1, 6) == 0


def test_a_context_starts_with_its_groups_alone():
    groups = frozenset({5})
    context = Context(groups)
    context.groups.add(6)
    assert groups == {5}
    assert not any((context.silenced, context.passive, context.speaks, context.open))
    assert is_request(Role.REQUEST)
    assert not is_request(Role.UNKNOWN)
