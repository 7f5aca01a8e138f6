"""Links and slicers: what checks, where frames end, and that an answer never depends on bytes that come later."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.codec import codec
from analyzer.layout import Layout, rest
from analyzer.link import MORE, TIE, HeadLink, ModbusLink, modbus_crc, sum8
from tests.bytestreams import SERIAL, exchanges, noise, vectors
from tests.collect import rtu

NATIVE, MODBUS, LK = (dialects.get(name) for name in SERIAL)


def slicer_of(name, expects=lambda address, function: 0):
    dialect = dialects.get(name)
    return dialect.link.slicer(dialect.commands, expects)


def ending_in_00(pattern, start=0):
    """Return a frame made from `pattern` (a function of an integer) whose CRC ends in 00."""
    return next(f for f in (rtu(pattern(n)) for n in range(start, 65536)) if f[-1] == 0)


# --- every vector -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "command", "frame"), vectors(), ids=lambda v: v if isinstance(v, str) else v.hex())
def test_look_finds_every_vector(name, command, frame):
    slicer = slicer_of(name)
    size = len(frame)
    assert slicer.look(frame, 0, size, True) == size
    assert slicer.look(b"\xff" + frame + b"\xff", 1, size + 2, False) == size
    assert size in slicer.lengths(frame, 0, size)
    assert slicer.whole(frame)
    assert frame[0] in slicer.heads
    for stop in range(1, size):
        assert slicer.look(frame, 0, stop, False) == MORE, f"{stop} of {size} bytes"


@given(data=st.data())
@settings(max_examples=60)
def test_what_is_built_checks_and_is_parsed(data):
    dialect = data.draw(st.sampled_from((NATIVE, MODBUS, LK)))
    link = dialect.link
    for frame in data.draw(exchanges(dialect, 17)):
        assert all(check.ok for check in link.checks(frame.data))
        assert link.fits(frame.data)
        short = frame.data[: -2 if dialect is MODBUS else -1]
        assert link.completed(short) == frame.data
        head = link.parse(frame.data)
        assert head.role in (frame.role, Role.UNKNOWN)
        assert 0 <= head.start <= head.stop <= len(frame.data)
        damaged = frame.data[:-1] + bytes((frame.data[-1] ^ 1,))
        assert not link.fits(damaged)
        assert [c.ok for c in link.checks(damaged)][-1] is False


# --- answers do not depend on what comes later ------------------------------------------------------------------------


def near_frames():
    """Draw bytes near a frame: one, a piece of one, and noise behind it."""
    whole = st.sampled_from([frame for _, _, frame in vectors()])
    pieces = whole.flatmap(lambda f: st.integers(1, len(f)).map(lambda n: f[:n]))
    return st.builds(lambda a, b: a + b, st.one_of(whole, pieces, noise(8)), noise(60)).filter(bool)


@given(name=st.sampled_from(SERIAL), data=near_frames())
@settings(max_examples=400)
def test_an_answer_does_not_change_with_more_bytes(name, data):
    slicer = slicer_of(name)
    size = len(data)
    final = slicer.look(data, 0, size, False)
    lengths = slicer.lengths(data, 0, size)
    damaged = slicer.damaged(data, 0, size)
    for stop in range(1, size):
        answer = slicer.look(data, 0, stop, False)
        assert answer in (MORE, final)
        assert slicer.look(data, 0, stop, True) != MORE
        for part, whole in ((slicer.lengths(data, 0, stop), lengths), (slicer.damaged(data, 0, stop), damaged)):
            assert part == whole if MORE not in part else set(part) - {MORE} <= set(whole)


@given(name=st.sampled_from(SERIAL), before=noise(10), data=near_frames())
@settings(max_examples=200)
def test_an_answer_does_not_depend_on_bytes_before(name, before, data):
    slicer = slicer_of(name)
    line = before + data
    for closed in (False, True):
        here = slicer.look(line, len(before), len(line), closed)
        assert here == slicer.look(data, 0, len(data), closed)
    assert slicer.damaged(line, len(before), len(line)) == slicer.damaged(data, 0, len(data))
    assert slicer.shortened(line, len(before), len(line)) == slicer.shortened(data, 0, len(data))


@given(name=st.sampled_from(SERIAL), data=near_frames())
@settings(max_examples=200)
def test_answers_are_lengths_of_what_is_there(name, data):
    slicer = slicer_of(name)
    size = len(data)
    found = slicer.look(data, 0, size, False)
    if found > 0:
        assert found == slicer.lengths(data, 0, size)[0]
        assert all(c.ok for c in dialects.get(name).link.checks(data[:found]))
    for length in slicer.lengths(data, 0, size) + slicer.damaged(data, 0, size) + slicer.shortened(data, 0, size):
        assert length == MORE or 0 < length <= min(size, slicer.longest)
    if data[0] not in slicer.heads:
        assert found == 0


# --- head, address, code, data, sum -----------------------------------------------------------------------------------


def test_a_package_has_52_bytes():
    slicer = slicer_of("mks-rs485")
    package = NATIVE.link.completed(b"\xfc" + bytes(50))
    assert slicer.look(package, 0, 52, True) == 52
    assert slicer.look(package, 0, 51, False) == MORE
    assert slicer.look(package, 0, 51, True) == 0
    # Its code is none of a frame to one drive.
    assert slicer.look(bytes.fromhex("FA 01 FC F7"), 0, 4, True) == 0


def test_a_package_that_lost_zeros_checks_at_its_shorter_length():
    slicer = slicer_of("mks-rs485")
    short = NATIVE.link.completed(bytes.fromhex("FC 01 F6 01 40 02"))
    assert slicer.shortened(short, 0, len(short)) == [len(short)]
    assert slicer.shortened(short + b"\xff", 0, len(short) + 1)[0] == len(short)
    # What does not begin with a command that is known is none.
    noise = NATIVE.link.completed(bytes.fromhex("FC 01 02 01 40 02"))
    assert slicer.shortened(noise, 0, len(noise)) == []
    assert slicer.shortened(short[1:], 0, len(short) - 1) == []


def test_unknown_codes_are_foreign_and_whole():
    slicer = slicer_of("mks-rs485")
    frame = NATIVE.link.completed(bytes.fromhex("FA 01 77 01 02"))
    assert slicer.look(frame, 0, len(frame), True) == 0
    assert slicer.foreign(frame, 0)
    assert slicer.whole(frame)
    assert not slicer.whole(frame[:-1] + b"\0")
    assert not slicer.foreign(bytes.fromhex("FA 01 F6"), 0)


def test_several_lengths_of_one_code():
    """A dialect may have several; the shortest that checks is the answer, and lengths one apart are a tie."""
    command = NATIVE.by_name["read_speed"]
    longer = replace(command, name="other", request=NATIVE.by_name["enable"].request)
    longest = replace(command, name="third", request=NATIVE.by_name["run_speed"].request)
    dialect = replace(NATIVE, commands=(command, longer, longest))
    slicer = dialect.link.slicer(dialect.commands, lambda address, function: 0)
    bare = dialect.link.completed(bytes.fromhex("FA 01 32"))
    assert slicer.look(bare + b"\xff\xff\xff", 0, 7, True) == 4
    assert slicer.look(bare, 0, 4, False) == MORE
    assert slicer.look(bare, 0, 4, True) == 4
    tied = bare + bytes((sum8(bare),))
    assert slicer.look(tied, 0, 5, False) == TIE
    assert slicer.lengths(tied + b"\xff\xff", 0, 7) == [4, 5]
    assert slicer.lengths(tied, 0, 5) == [4, 5, MORE]
    seven = dialect.link.completed(bytes.fromhex("FA 01 32 01 40 02"))
    assert slicer.look(seven, 0, 7, False) == 7
    assert slicer.damaged(seven, 0, 7) == [4, 5, 7]


def test_another_check_than_the_sum():
    link = HeadLink(heads={0xA5: Role.REQUEST, 0xA6: Role.REPLY}, check=lambda data: sum8(data) ^ 0xFF)
    dialect = replace(NATIVE, link=link, commands=tuple(c for c in NATIVE.commands if c.slots is None))
    slicer = link.slicer(dialect.commands, lambda address, function: 0)
    frame = link.completed(bytes.fromhex("A5 01 32"))
    assert slicer.look(frame, 0, 4, True) == 4
    assert slicer.whole(frame)
    assert slicer.look(NATIVE.link.completed(bytes.fromhex("A5 01 32")), 0, 4, True) == 0


# --- Modbus -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "01 03 00 10 00 02",  # functions that the manual does not have
        "01 03 04 00 01 00 02",
        "01 01 00 00 00 10",
        "01 01 02 FF 01",
        "01 05 00 01 FF 00",
        "01 0F 00 00 00 0A 02 FF 03",
        "01 0F 00 00 00 0A",
        "01 10 00 00 00 02 04 00 00 00 00",
        "01 10 00 90 00 03 05 00 00 00 64 00",  # five bytes in three registers, as printed
        "01 10 00 F6 00 00",  # a refused write
        "01 84 02",
        "01 90 03",
        "00 06 00 F7 00 01",
    ],
)
def test_modbus_lengths_follow_the_functions(text):
    frame = rtu(text)
    slicer = slicer_of("mks-modbus")
    assert slicer.look(frame, 0, len(frame), True) == len(frame)
    assert slicer.look(frame + b"\xff" * 8, 0, len(frame) + 8, False) == len(frame)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("F8 03 00 10 00 02", "an address above 247"),
        ("01 10 00 00 00 02 05 00 00 00 00 00", "a byte count that is not twice the quantity"),
        ("01 10 00 90 00 03 06 00 00 00 64 00 01", "six bytes where the manual prints five"),
        ("01 03 03 00 01 00", "half a register"),
        ("00 03 02 00 01", "a reply from all drives"),
        ("01 84 00", "no exception"),
        ("01 84 0C", "no exception"),
        ("01 11 01 02", "an unknown function"),
        ("01 03 00 10 00 7E", "more registers than fit"),
        ("01 03 00 10 00 00", "no registers"),
    ],
)
def test_what_is_no_modbus_frame(text, why):
    frame = rtu(text)
    slicer = slicer_of("mks-modbus")
    assert slicer.look(frame, 0, len(frame), True) == 0, why


def test_a_modbus_frame_whose_crc_ends_in_00_is_a_tie_with_the_one_a_byte_shorter():
    """A read of register 0x02xx has the bytes of a reply with two data bytes."""
    request = ending_in_00(lambda n: f"{n >> 8:02X} 03 02 {n & 0xFF:02X} 00 01", 0x0100)
    assert len(request) == 8
    slicer = slicer_of("mks-modbus")
    assert slicer.look(request, 0, 8, True) == TIE
    assert slicer.look(request, 0, 7, False) == MORE
    assert slicer.look(request, 0, 7, True) == 7
    assert slicer.lengths(request, 0, 8) == [7, 8]
    assert slicer.preferred(request, 0, (7, 8)) == 0
    assert slicer_of("mks-modbus", lambda a, f: 2).preferred(request, 0, (7, 8)) == 7
    assert slicer_of("mks-modbus", lambda a, f: 4).preferred(request, 0, (7, 8)) == 0


def test_modbus_lengths_further_apart_are_no_tie():
    reply = rtu("01 04 20" + " 00 01" * 16)
    slicer = slicer_of("mks-modbus")
    assert slicer.look(reply, 0, 8, False) == MORE
    assert slicer.look(reply, 0, len(reply), False) == len(reply)
    request = rtu("01 04 20 00 00 02")
    assert slicer.look(request, 0, 8, False) == 8, "the shorter is not kept waiting"
    assert slicer.lengths(request, 0, 8) == [8, MORE]


def test_whole_modbus_frames_of_unknown_functions():
    slicer = slicer_of("mks-modbus")
    frame = rtu("01 11 01 02 03")
    assert slicer.whole(frame)
    assert slicer.foreign(frame, 0)
    assert not slicer.foreign(rtu("01 03 00 00 00 01"), 0)
    assert not slicer.foreign(rtu("01 83 01"), 0)
    # A frame that lost the 00 at its end checks too, and is not whole.
    lost = ending_in_00(lambda n: f"01 06 00 82 {n >> 8:02X} {n & 0xFF:02X}")[:-1]
    assert modbus_crc(lost[:-2]) == int.from_bytes(lost[-2:], "little")
    assert not slicer.whole(lost)


def test_odd_counts_are_the_links():
    assert MODBUS.link.byte_count(0x10, 0x0090, 3) == 5
    assert MODBUS.link.byte_count(0x10, 0x0091, 3) == 6
    assert MODBUS.link.byte_count(0x0F, 0, 10) == 2
    assert ModbusLink().byte_count(0x10, 0x0090, 3) == 6


# --- Lingkong ---------------------------------------------------------------------------------------------------------


def lk(code, address, data=b""):
    head = bytes((0x3E, code, address, len(data)))
    frame = head + bytes((sum8(head),))
    return frame + data + bytes((sum8(data),)) if data else frame


def test_lk_carries_its_length():
    slicer = slicer_of("lk-rs485")
    unknown = lk(0x12, 1, bytes(range(58)))
    assert slicer.look(unknown, 0, len(unknown), False) == len(unknown), "both sums are enough for an unknown code"
    assert slicer.look(unknown, 0, 20, False) == MORE
    bare = lk(0x12, 1)
    assert slicer.look(bare, 0, 5, True) == 0, "one sum is not"
    assert slicer.foreign(bare, 0)
    assert slicer.whole(bare)
    assert slicer.look(lk(0x9A, 1), 0, 5, True) == 5
    assert slicer.look(lk(0x9A, 1, bytes(101)), 0, 107, True) == 0, "no frame is so long"


def test_an_lk_frame_of_which_one_sum_is_wrong_is_damaged():
    slicer = slicer_of("lk-rs485")
    good = lk(0xA2, 1, bytes.fromhex("10 27 00 00"))
    head, data = bytearray(good), bytearray(good)
    head[4] ^= 1
    data[-1] ^= 1
    assert slicer.damaged(bytes(head), 0, 10) == [10]
    assert slicer.damaged(bytes(data), 0, 10) == [10]
    assert slicer.damaged(bytes(head), 0, 9) == [MORE]
    head[-1] ^= 1
    assert slicer.damaged(bytes(head), 0, 10) == [], "both are"
    bare = bytearray(lk(0x9A, 1))
    bare[4] ^= 1
    assert slicer.damaged(bytes(bare), 0, 5) == [5]
    assert slicer.damaged(lk(0x12, 1, b"\1\2"), 0, 8) == [], "an unknown code"


def test_can_needs_no_slicer():
    can = dialects.get("mks-can")
    with pytest.raises(TypeError, match="no slicer"):
        can.link.slicer(can.commands, lambda address, function: 0)


def test_layouts_of_the_serial_dialects_have_codecs_of_their_lengths():
    """The lengths that slicers go by are those that codecs read."""
    for dialect in (NATIVE, MODBUS, LK):
        for command in dialect.commands:
            for form in (*command.request_forms, *command.reply_forms):
                if not form.layout.open_ended:
                    assert len(codec(form.layout).encode({})) == form.layout.byte_length


# --- candidates -------------------------------------------------------------------------------------------------------


def requests_of(name):
    """Return the requests that the manual prints, whole, with their identifiers."""
    dialect = dialects.get(name)
    for command in dialect.commands:
        for vector in command.vectors:
            if vector.role is Role.REQUEST and vector.checksum and not vector.erratum:
                can_id, data = (vector.data[0], vector.data[1:]) if dialect.bus == "can" else (None, vector.data)
                yield command, can_id, data


@pytest.mark.parametrize("name", dialects.names())
def test_a_request_is_a_candidate_however_it_is_spoiled_or_cut(name):
    dialect = dialects.get(name)
    finder = dialect.link.finder(dialect.commands)
    for command, can_id, data in requests_of(name):
        before = b"" if can_id is not None else b"\xff\xff"
        start = len(before)

        def candidates(item, before=before, can_id=can_id, code=command.code):
            return [c for c in finder.at(before + item, len(before), can_id).found if c.known and c.code == code and not c.slot]

        whole = candidates(data)
        assert [(c.start, c.stop, c.fits, c.complete) for c in whole] == [(start, start + len(data), True, True)], data.hex(" ")
        assert whole[0].address == (can_id if can_id is not None else dialect.link.parse(data).address) or command.slots
        spoiled = candidates(data[:-1] + bytes((data[-1] ^ 0x55,)))
        assert [(c.fits, c.complete) for c in spoiled] == [(False, True)]
        for cut in range(dialect.link.deciding_bytes or 4, len(data)):
            found = candidates(data[:cut])
            assert found
            assert not any(c.fits and c.complete and c.stop == start + len(data) for c in found)


@pytest.mark.parametrize("name", ["mks-rs485", "mks-modbus", "lk-rs485"])
def test_a_place_stays_open_until_its_request_is_whole(name):
    dialect = dialects.get(name)
    finder = dialect.link.finder(dialect.commands)
    for _, _, data in requests_of(name):
        assert all(finder.at(data[:cut], 0).open for cut in range(1, len(data)))


def test_an_uncatalogued_code_is_a_candidate_too():
    finder = NATIVE.link.finder(NATIVE.commands)
    (unknown,) = finder.at(bytes.fromhex("FA 01 55"), 0).found
    assert (unknown.known, unknown.complete, unknown.code) == (False, False, 0x55)
    (head,) = finder.at(bytes.fromhex("FA 01 FB"), 0).found
    assert head.weak, "the head of the next frame"
    modbus = MODBUS.link.finder(MODBUS.commands)
    frame = MODBUS.link.completed(bytes.fromhex("01 2B 0E 01 00"))
    assert modbus.at(frame, 0).found == ()
    assert [c.stop for c in modbus.checked(frame, 0, 1)] == [len(frame)]


def test_an_open_ended_request_is_no_less_than_an_unknown_one():
    read = next(c for c in NATIVE.commands if c.slots is None)
    dialect = replace(NATIVE, commands=(replace(read, code=0x55, request=Layout(rest("text"))),))
    (found,) = dialect.link.finder(dialect.commands).at(bytes.fromhex("FA 01 55 41 42 D3"), 0).found
    assert not found.known


def test_only_a_can_frame_has_an_identifier():
    can = dialects.get("mks-can")
    assert can.link.identifier(can.commands[0], 0x123) == 0x123
    assert NATIVE.link.identifier(NATIVE.commands[0], 1) is None
