"""Framing: the properties of design and issue, on streams made from the catalogue, and each rule once by hand.

The context is in the loop wherever it can matter: what is fed goes through framer, decoder and transactions.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.context import Context
from analyzer.decoder import Decoder
from analyzer.framer import BURST_CHARACTERS, SILENCE_NS, SLOWEST_BYTE_NS, Framer
from analyzer.junk import JUNK_PIECE
from analyzer.link import HeadLink, modbus_crc, sum8
from analyzer.records import Chunk, Frame, Junk, JunkReason
from analyzer.transactions import Transactions
from tests.bytestreams import HARMLESS, SERIAL, cuttings, joined, lines, noise, placed, traffic, vectors, wires

BYTE_NS = 86_806
MS = 1_000_000


class Line:
    """A framer with decoders and transactions behind it, as in the pipeline; keeps what comes out."""

    def __init__(self, *names, **options):
        self.context = Context()
        self.dialects = [dialects.get(name) if isinstance(name, str) else name for name in names]
        self.framer = Framer("line", self.dialects, self.context, **options)
        self.decoders = {d.name: Decoder(d) for d in self.dialects}
        self.transactions = Transactions(self.context)
        self.events = []

    def take(self, events):
        for event in events:
            self.events.append(event)
            if isinstance(event, Frame):
                message, asked = self.decoders[event.dialect.name].decode(event, self.context)
                self.transactions.observe(message, len(self.events), asked)
        return self

    def feed(self, *data, t_ns=None, direction=Role.UNKNOWN, burst=False):
        for piece in data:
            self.take(self.framer.feed(Chunk(t_ns, "line", piece, direction, burst)))
        return self

    def silence(self):
        return self.take(self.framer.silence())

    def close(self):
        self.take(self.framer.close())
        return self

    @property
    def frames(self):
        return [e for e in self.events if isinstance(e, Frame)]

    @property
    def good(self):
        return [(e.offset, e.data, e.dialect.name) for e in self.frames if e.checksum_ok]

    @property
    def junk(self):
        return [(e.offset, e.data, e.reason) for e in self.events if isinstance(e, Junk)]


def frames_at(frames):
    return [(p.at, p.sent.data, p.sent.dialect) for p in placed(frames)]


def hexed(text, completed=""):
    """Return bytes from hex text, completed with the check of a dialect."""
    data = bytes.fromhex(text)
    return dialects.get(completed).link.completed(data) if completed else data


def native(text):
    return hexed(text, "mks-rs485")


def modbus(text):
    return hexed(text, "mks-modbus")


ASK = native("FA 01 32")
SPEED = native("FB 01 32 00 64")
RUN = native("FA 01 F6 01 40 02")
PACKAGE = native("FC 01 F6 01 40 02 00 00 00 00 00 02 F6 01 40 02" + " 00" * 35)


# --- nothing is lost, and chunks do not matter ------------------------------------------------------------------------


@given(data=st.data(), names=wires())
@settings(max_examples=200)
def test_frames_and_junk_are_the_input(data, names):
    line = data.draw(lines(names) | noise(400))
    whole = Line(*names).feed(line).close()
    assert b"".join(e.data for e in whole.events) == line
    at = 0
    for event in whole.events:
        assert event.offset == at
        at += len(event.data)
    assert whole.framer.waiting == 0


@given(data=st.data(), names=wires())
@settings(max_examples=250)
def test_chunks_do_not_matter(data, names):
    line = data.draw(lines(names))
    pieces = data.draw(cuttings(line))
    t_ns = data.draw(st.sampled_from((None, 10**18)))
    whole = Line(*names).feed(line, t_ns=t_ns).close()
    cut = Line(*names).feed(*pieces, t_ns=t_ns).close()
    assert cut.events == whole.events


@given(data=st.data(), names=wires())
@settings(max_examples=100)
def test_chunks_do_not_matter_between_pauses(data, names):
    """Bytes that come one after the other, with pauses of all lengths between, and their times."""
    reads, now = [], 10**18
    for _ in range(data.draw(st.integers(1, 6))):
        part = data.draw(lines(names))
        now += data.draw(st.sampled_from((0, 1, 5, 20, 30, 100))) * MS + len(part) * BYTE_NS
        reads.append((now, part))
    whole, cut = Line(*names, byte_ns=BYTE_NS), Line(*names, byte_ns=BYTE_NS)
    for t_ns, part in reads:
        whole.feed(part, t_ns=t_ns)
        left = len(part)
        for piece in data.draw(cuttings(part)):
            left -= len(piece)
            cut.feed(piece, t_ns=t_ns - left * BYTE_NS)
    assert cut.close().events == whole.close().events


@given(data=st.data(), names=wires(), byte_ns=st.sampled_from((0, BYTE_NS)))
@settings(max_examples=100)
def test_times_come_from_the_chunks_of_the_first_and_last_byte(data, names, byte_ns):
    line = data.draw(lines(names))
    times, before, now = [], 0, 10**18
    under_test = Line(*names, byte_ns=byte_ns)
    for piece in data.draw(cuttings(line)):
        now += data.draw(st.integers(0, 40 * MS))
        under_test.feed(piece, t_ns=now)
        times += [max(before, now - n * byte_ns) for n in reversed(range(len(piece)))]
        before = now
    for event in under_test.close().events:
        assert (event.first_ns, event.last_ns) == (times[event.offset], times[event.offset + len(event.data) - 1])


def test_times_that_run_backwards_stand_still():
    line = Line("mks-rs485").feed(ASK, t_ns=2000).feed(ASK, t_ns=1000).feed(ASK, t_ns=3000).close()
    assert [e.last_ns for e in line.events] == [2000, 2000, 3000]


# --- every frame is found ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "command", "frame"), vectors(), ids=lambda v: v if isinstance(v, str) else v.hex())
def test_every_vector_is_found(name, command, frame):
    expected = [(0, frame, name)]
    assert Line(name).feed(frame).close().good == expected
    assert Line(name).feed(*(bytes((b,)) for b in frame)).close().good == expected
    before, after = bytes(HARMLESS), bytes(reversed(HARMLESS))
    between = Line(name).feed(before + frame + after).close()
    assert between.good == [(len(before), frame, name)]
    assert [(offset, data) for offset, data, _ in between.junk] == [(0, before), (len(before) + len(frame), after)]
    twice = Line(name).feed(frame + frame).close()
    assert twice.good == [(0, frame, name), (len(frame), frame, name)]
    among_all = Line(*SERIAL).feed(frame).close()
    assert among_all.good == expected


@given(data=st.data(), names=wires())
@settings(max_examples=150)
def test_every_frame_of_a_clean_line_is_found(data, names):
    """Several drives, and where the wire has them, several dialects."""
    frames = data.draw(traffic(names))
    line = Line(*names).feed(*data.draw(cuttings(joined(frames)))).close()
    assert line.good == frames_at(frames)
    assert line.junk == []
    assert all(e.role is Role.UNKNOWN for e in line.frames)


@given(data=st.data(), names=wires())
@settings(max_examples=60)
def test_every_frame_is_found_where_the_host_is_echoed(data, names):
    frames = [f for frame in data.draw(traffic(names)) for f in [frame] * (1 + (frame.role is Role.REQUEST))]
    line = Line(*names).feed(*data.draw(cuttings(joined(frames)))).close()
    assert line.good == frames_at(frames)


@given(data=st.data(), names=wires())
@settings(max_examples=60)
def test_every_frame_is_found_in_reads_of_its_own(data, names):
    frames = data.draw(traffic(names))
    line, now = Line(*names, byte_ns=BYTE_NS), 10**18
    for frame in frames:
        now += data.draw(st.sampled_from((1, 4, 30, 700))) * MS + len(frame.data) * BYTE_NS
        line.feed(frame.data, t_ns=now)
    assert line.close().good == frames_at(frames)


@given(data=st.data(), names=wires())
@settings(max_examples=60)
def test_every_frame_is_found_where_the_capture_says_who_speaks(data, names):
    frames = data.draw(traffic(names))
    line = Line(*names)
    for frame in frames:
        line.feed(*data.draw(cuttings(frame.data)), direction=frame.role)
    assert line.close().good == frames_at(frames)
    assert [e.role for e in line.frames] == [f.role for f in frames]


# --- damage -----------------------------------------------------------------------------------------------------------


def damage(draw, frames):
    """Damage one frame of a line; return the line, and the frames that the damage neither touches nor abuts."""
    index = draw(st.integers(0, len(frames) - 1))
    hurt = frames[index].data
    first = draw(st.integers(0, len(hurt) - 1))
    kind = draw(st.sampled_from(("flip", "cut", "insert")))
    last = first + 1
    if kind == "flip":
        new = bytes((hurt[first] ^ draw(st.integers(1, 255)),))
    elif kind == "cut":
        last = draw(st.integers(first + 1, len(hurt)))
        new = b""
    else:
        last = first
        new = draw(st.binary(min_size=1, max_size=4))
    wreck = hurt[:first] + new + hurt[last:]
    before, after = frames_at(frames[:index]), frames_at(frames[index + 1 :])
    shift = len(joined(frames[:index])) + len(wreck)
    after = [(shift + at, data, name) for at, data, name in after]
    undamaged = before[: len(before) - (first == 0)] + after[last == len(hurt) :]
    return joined(frames[:index]) + wreck + joined(frames[index + 1 :]), undamaged


@given(data=st.data(), names=wires())
@settings(max_examples=200)
def test_frames_that_no_damage_touches_or_abuts_are_found(data, names):
    """After a cut, an insertion or a flip the very next frame is found, where it does not abut the damage."""
    line, undamaged = damage(data.draw, data.draw(traffic(names, 2, 6)))
    found = Line(*names).feed(line).close().good
    assert [frame for frame in undamaged if frame not in found] == []


@given(data=st.data(), names=wires())
@settings(max_examples=100)
def test_a_known_frame_whose_check_is_wrong_is_that_frame(data, names):
    frames = data.draw(traffic(names, 2, 6))
    index = data.draw(st.integers(0, len(frames) - 1))
    hurt = bytearray(frames[index].data)
    hurt[-1] ^= data.draw(st.integers(1, 255))
    line = [*frames]
    line[index] = frames[index]._replace(data=bytes(hurt))
    found = Line(*names).feed(joined(line)).close()
    assert [(e.offset, e.data) for e in found.frames] == [(p.at, p.sent.data) for p in placed(line)]
    assert [e.checksum_ok for e in found.frames] == [n != index for n in range(len(line))]


def test_a_bad_checksum_needs_something_that_follows():
    bad = ASK[:-1] + b"\0"
    assert Line("mks-rs485").feed(bad + SPEED).close().frames[0].checksum_ok is False
    assert Line("mks-rs485").feed(bad).close().frames[0].checksum_ok is False
    line = Line("mks-rs485").feed(bad + b"\x55" + SPEED).close()
    assert line.junk == [(0, bad + b"\x55", JunkReason.NOISE)]


def test_a_bad_checksum_does_not_hide_a_frame():
    """What looks like a longer frame with a wrong check is none where a good frame begins inside."""
    head = hexed("FA 01 FD")
    line = Line("mks-rs485").feed(head + SPEED + ASK[:2] + SPEED).close()
    assert [data for _, data, _ in line.good] == [SPEED, SPEED]


def test_the_head_of_the_next_frame_is_not_swallowed():
    """A frame that lost a byte checks, by chance, with the head of the next one at its end."""
    lost = hexed("FA 01 F6 01 40 C8")
    assert sum8(lost) == 0xFA
    line = Line("mks-rs485").feed(ASK + lost + ASK + SPEED).close()
    assert line.good == [(0, ASK, "mks-rs485"), (10, ASK, "mks-rs485"), (14, SPEED, "mks-rs485")]
    assert line.junk == [(4, lost, JunkReason.TRUNCATED)]
    # Also where the one after is damaged, so that nothing sound follows.
    line = Line("mks-rs485").feed(ASK + lost + ASK + b"\x55\x55\x55").close()
    assert line.good == [(0, ASK, "mks-rs485"), (10, ASK, "mks-rs485")]


@pytest.mark.parametrize(
    ("text", "claimed", "why"),
    [
        ("FA 01 F6 01 40 10 42 74", False, "leaving out the 10 makes a frame that checks with the 74"),
        ("FA 01 F6 01 40 10 42 75", True, "leaving out no byte does"),
        ("FA 01 F6 01 40 1C 4E 80", True, "an 80 is what a pulse on the idle line makes"),
        ("FA 01 F6 01 40 1C 4E 4E", True, "the last byte comes once more"),
        ("FA 01 F6 14 01 00 06 F8", False, "so is an F8; but reserved bits are set, and without the 14 none are"),
        ("FA 01 F6 01 40 10 42 74 55", True, "two bytes more: nothing follows the longer one"),
    ],
)
def test_a_frame_that_checks_with_an_inserted_byte_in_it(text, claimed, why):
    data = hexed(text)
    assert sum8(data[:6]) == data[6]
    line = Line("mks-rs485").feed(ASK + data + ASK).close()
    assert ((4, data[:7], "mks-rs485") in line.good) is claimed, why
    assert (4 + len(data), ASK, "mks-rs485") in line.good


# --- waiting ----------------------------------------------------------------------------------------------------------


def test_a_frame_is_given_away_when_another_follows_or_nothing_does():
    line = Line("mks-rs485").feed(ASK)
    assert line.events == []
    assert line.framer.waiting == 4
    line.feed(SPEED[:3])
    assert line.events == []
    line.feed(SPEED[3:])
    assert line.good == [(0, ASK, "mks-rs485")]
    line.silence()
    assert line.good[1:] == [(4, SPEED, "mks-rs485")]
    assert line.framer.waiting == 0
    assert line.silence().close().events[2:] == []


def test_an_inner_frame_is_not_taken_while_an_outer_one_is_arriving():
    inner = ASK + SPEED
    outer = native("FC" + inner.hex() + "00" * (50 - len(inner)))
    line = Line("mks-rs485").feed(outer[:-1])
    assert line.events == []
    assert line.feed(outer[-1:]).close().good == [(0, outer, "mks-rs485")]
    broken = Line("mks-rs485").feed(outer[:30]).close()
    assert [data for _, data, _ in broken.good] == [ASK, SPEED], "a silence ends the wait"


def test_a_start_byte_inside_a_payload_is_data():
    frame = native("FA FB FD 0F AF BC FA 01 32 2D")
    assert Line("mks-rs485").feed(frame + ASK).close().good == [(0, frame, "mks-rs485"), (11, ASK, "mks-rs485")]


def test_a_failed_check_costs_one_byte():
    line = Line("mks-rs485").feed(ASK + b"\xfa" + ASK + b"\xfa\xfa" + SPEED + ASK).close()
    assert [offset for offset, _, _ in line.good] == [0, 5, 11, 17]
    assert [(offset, data) for offset, data, _ in line.junk] == [(4, b"\xfa"), (9, b"\xfa\xfa")]


def test_a_silence_ends_a_wait_and_a_shorter_pause_does_not():
    first, last = RUN[:4], RUN[4:]
    line = Line("mks-rs485", byte_ns=BYTE_NS).feed(first, t_ns=10**9)
    line.feed(last, t_ns=10**9 + SILENCE_NS).close()
    assert [e.data for e in line.events] == [RUN]
    line = Line("mks-rs485", byte_ns=BYTE_NS).feed(first, t_ns=10**9)
    line.feed(last, t_ns=10**9 + SILENCE_NS + 3 * BYTE_NS + 1).close()
    assert line.junk == [(0, first, JunkReason.TRUNCATED), (4, last, JunkReason.NOISE)]


def test_the_time_that_bytes_take_is_no_silence():
    """Nor is it where the speed of the line is unknown."""
    for options in ({"byte_ns": BYTE_NS}, {}):
        byte_ns = options.get("byte_ns", SLOWEST_BYTE_NS)
        line = Line("mks-rs485", **options).feed(PACKAGE[:3], t_ns=10**9)
        line.feed(PACKAGE[3:], t_ns=10**9 + len(PACKAGE) * byte_ns).close()
        assert [e.data for e in line.events] == [PACKAGE]


def test_a_change_of_direction_ends_a_wait():
    line = Line("mks-rs485").feed(RUN[:4], direction=Role.REQUEST).feed(SPEED, direction=Role.REPLY)
    assert line.junk == [(0, RUN[:4], JunkReason.TRUNCATED)]
    line.feed(ASK, direction=Role.REQUEST)
    assert [(e.data, e.role) for e in line.frames] == [(SPEED, Role.REPLY)]


@given(data=st.data(), names=wires())
@settings(max_examples=100)
def test_waits_are_bounded(data, names):
    line = Line(*names)
    for piece in data.draw(cuttings(data.draw(noise(3000)))):
        line.feed(piece)
        assert line.framer.waiting <= JUNK_PIECE + 5 * 256


# --- bursts -----------------------------------------------------------------------------------------------------------

UNKNOWN = native("FA 01 77 05 06")
LONG_ASK = native("FA 01 32 07")
BURST_NS = (BURST_CHARACTERS + 1) * BYTE_NS


def test_an_unknown_code_is_a_frame_only_where_it_fills_a_burst():
    line = Line("mks-rs485").feed(ASK, burst=True).feed(UNKNOWN, burst=True).feed(SPEED, burst=True).close()
    assert [data for _, data, _ in line.good] == [ASK, UNKNOWN, SPEED]
    line = Line("mks-rs485").feed(ASK + UNKNOWN + SPEED).close()
    assert [data for _, data, _ in line.good] == [ASK, SPEED]
    assert line.junk == [(4, UNKNOWN, JunkReason.NOISE)]
    line = Line("mks-rs485").feed(UNKNOWN + b"\x55", burst=True).close()
    assert line.good == []
    line = Line("mks-rs485").feed(UNKNOWN[:-1] + b"\0", burst=True).close()
    assert line.good == []


def test_a_pause_makes_a_burst_of_an_unknown_code():
    for cut in range(len(UNKNOWN)):
        line, now = Line("mks-rs485", byte_ns=BYTE_NS), 10**9
        line.feed(ASK, t_ns=now)
        now += BURST_NS + len(UNKNOWN) * BYTE_NS
        line.feed(UNKNOWN[:cut], t_ns=now - (len(UNKNOWN) - cut) * BYTE_NS).feed(UNKNOWN[cut:], t_ns=now)
        line.feed(SPEED, t_ns=now + BURST_NS + len(SPEED) * BYTE_NS).close()
        assert [data for _, data, _ in line.good] == [ASK, UNKNOWN, SPEED]


def test_a_known_code_of_another_length_needs_a_firm_end():
    """A sum does not see zeros that were lost, so a mere pause is not enough."""
    line = Line("mks-rs485").feed(LONG_ASK, burst=True).feed(SPEED, burst=True).close()
    assert [data for _, data, _ in line.good] == [LONG_ASK, SPEED]
    line = Line("mks-rs485").feed(LONG_ASK).silence().feed(SPEED).close()
    assert [data for _, data, _ in line.good] == [LONG_ASK, SPEED]
    line = Line("mks-rs485", byte_ns=BYTE_NS).feed(LONG_ASK, t_ns=10**9)
    line.feed(SPEED, t_ns=10**9 + BURST_NS + len(SPEED) * BYTE_NS).close()
    assert [data for _, data, _ in line.good] == [SPEED]


def test_unknown_modbus_functions_fill_bursts():
    frame = modbus("01 11 05 06 07")
    line = Line("mks-modbus").feed(frame, burst=True).feed(modbus("01 04 00 32 00 01"), burst=True).close()
    assert line.good[0] == (0, frame, "mks-modbus")
    assert Line("mks-modbus").feed(modbus("01 04 00 32 00 01") + frame + b"\xff").close().good[1:] == []


def test_an_unknown_lk_code_needs_no_burst():
    head = hexed("3E 12 01 02")
    frame = head + bytes((sum8(head),)) + hexed("05 06 0B")
    ask = hexed("3E 9A 01 00 D9")
    assert [data for _, data, _ in Line("lk-rs485").feed(ask + frame + ask).close().good] == [ask, frame, ask]
    bare = hexed("3E 12 01 00 51")
    assert [data for _, data, _ in Line("lk-rs485").feed(ask + bare + ask).close().good] == [ask, ask]
    assert [data for _, data, _ in Line("lk-rs485").feed(bare, burst=True).close().good] == [bare]


def test_a_package_that_lost_zeros():
    short = PACKAGE[:20] + PACKAGE[25:]
    line = Line("mks-rs485").feed(ASK).silence().feed(short).close()
    assert line.good[1] == (4, short, "mks-rs485"), "its end is firm, so its sum counts"
    line = Line("mks-rs485").feed(ASK + short + ASK).close()
    assert [(e.data, e.checksum_ok) for e in line.frames] == [(ASK, True), (short, False), (ASK, True)]
    line = Line("mks-rs485").feed(ASK + short + b"\x55" + ASK).close()
    assert [data for _, data, _ in line.good] == [ASK, ASK], "nothing follows"
    wrong = PACKAGE[:20] + PACKAGE[25:-1] + bytes((PACKAGE[-1] ^ 1,))
    assert [data for _, data, _ in Line("mks-rs485").feed(ASK + wrong + ASK).close().good] == [ASK, ASK]


# --- Modbus lengths ---------------------------------------------------------------------------------------------------


def tied_reply():
    """Return a read reply of two bytes that with a 00 behind it is a request of 8."""
    for n in range(65536):
        reply = modbus(f"{n >> 8 & 0x7F or 1:02X} 04 02 {n & 0xFF:02X} 00")
        if 1 <= reply[5] <= 125:
            return reply
    raise AssertionError


def test_of_lengths_one_apart_the_longer_wins():
    tied = tied_reply() + b"\0"
    assert modbus_crc(tied) == 0
    assert Line("mks-modbus").feed(tied).close().good == [(0, tied, "mks-modbus")]
    assert Line("mks-modbus").feed(tied + modbus("05 06 00 F7 00 01")).close().good[0] == (0, tied, "mks-modbus")


def test_the_open_request_decides_a_tie():
    reply = tied_reply()
    ask = modbus(f"{reply[0]:02X} 04 00 32 00 01")
    line = Line("mks-modbus").feed(ask + reply + b"\0").close()
    assert line.good == [(0, ask, "mks-modbus"), (8, reply, "mks-modbus")]


def test_what_follows_decides_a_tie():
    """A request to all drives begins with 00."""
    reply, to_all = tied_reply(), modbus("00 06 00 F7 00 01")
    for cut in range(1, 15):
        data = reply + to_all
        line = Line("mks-modbus").feed(data[:cut], data[cut:]).close()
        assert line.good == [(0, reply, "mks-modbus"), (7, to_all, "mks-modbus")]


def test_a_byte_count_that_is_wrong_is_no_candidate():
    good = modbus("01 10 00 F6 00 02 04 00 02 01 40")
    bad = modbus("01 10 00 F6 00 02 05 00 02 01 40 00")
    ask = modbus("01 04 00 32 00 01")
    assert [data for _, data, _ in Line("mks-modbus").feed(ask + good + ask).close().good] == [ask, good, ask]
    assert [data for _, data, _ in Line("mks-modbus").feed(ask + bad + ask).close().good] == [ask, ask]


def test_a_longer_frame_wins_where_the_shorter_is_not_followed():
    """Of several lengths of a code, the one behind which the line goes on."""
    native_dialect = dialects.get("mks-rs485")
    command = native_dialect.by_name["read_speed"]
    other = replace(command, name="other", request=native_dialect.by_name["run_speed"].request)
    dialect = replace(native_dialect, commands=(command, other))
    short = native("FA 01 32")
    long = native(short.hex() + "01 40")
    assert Line(dialect).feed(long + short).close().good == [(0, long, dialect.name), (7, short, dialect.name)]
    assert Line(dialect).feed(short + short).close().good == [(0, short, dialect.name), (4, short, dialect.name)]


# --- why bytes are junk -----------------------------------------------------------------------------------------------


def test_the_end_of_junk_that_begins_a_frame_is_truncated():
    line = Line("mks-rs485").feed(b"\x55\x66" + RUN[:5]).silence().feed(ASK).close()
    assert line.junk == [(0, b"\x55\x66", JunkReason.NOISE), (2, RUN[:5], JunkReason.TRUNCATED)]
    cut = modbus("01 10 00 F6 00 02 04 00 02 01 40")[:9]
    assert Line("mks-modbus").feed(cut).close().junk == [(0, cut, JunkReason.TRUNCATED)]
    cut = hexed("3E A2 01 04 E5 10 27")
    assert Line("lk-rs485").feed(cut).close().junk == [(0, cut, JunkReason.TRUNCATED)]


def test_two_frames_in_one_heap_are_a_collision():
    heap = hexed("FB 01 FB 02 31 31 00 00 00 00 00 00 00 00")
    line = Line("mks-rs485").feed(hexed("FB 02 31 01 FB 01 F1 00 00 00 00 00 55") + ASK).close()
    assert [reason for _, _, reason in line.junk] == [JunkReason.COLLISION]
    assert Line("mks-rs485").feed(heap + ASK).close().junk[0][2] is JunkReason.NOISE


def test_junk_ends_where_a_burst_does():
    line = Line("mks-rs485").feed(b"\x55\x66", burst=True).feed(b"\x77", burst=True).close()
    assert [(offset, data) for offset, data, _ in line.junk] == [(0, b"\x55\x66"), (2, b"\x77")]


def test_junk_without_end_is_passed_on_in_pieces():
    line = Line("mks-rs485").feed(*[b"\x55" * 1000] * 20)
    assert [len(data) for _, data, _ in line.junk] == [JUNK_PIECE] * 4
    assert sum(len(data) for _, data, _ in line.close().junk) == 20_000


# --- hostile bytes ----------------------------------------------------------------------------------------------------


@given(data=st.data(), names=wires(), burst=st.booleans())
@settings(max_examples=150)
def test_no_bytes_raise(data, names, burst):
    line = Line(*names)
    for _ in range(data.draw(st.integers(1, 4))):
        line.feed(data.draw(noise(300)), burst=burst, direction=data.draw(st.sampled_from(Role)))
    line.close()


class Counted(HeadLink):
    """Counts how often is looked."""

    looks = 0

    def slicer(self, commands, expects):
        slicer = super().slicer(commands, expects)
        look = slicer.look

        def counted(buffer, at, end, closed):
            Counted.looks += 1
            return look(buffer, at, end, closed)

        slicer.look = counted
        return slicer


@pytest.mark.parametrize("pattern", ["FA", "FB", "FC", "FA 01 FD", "FC 01 F6", "FC FA", "FA 01 32 2D FC", "00", "FB 01 31"])
@pytest.mark.parametrize("size", [1, 8192])
def test_the_work_grows_with_the_bytes_only(pattern, size):
    """Not with their square: a repeated pattern costs a fixed number of looks a byte, however it is cut."""
    link = dialects.get("mks-rs485").link
    dialect = replace(dialects.get("mks-rs485"), link=Counted(heads=link.heads, check=link.check, package=link.package))
    Counted.looks = 0
    data = bytes.fromhex(pattern) * (6000 // len(bytes.fromhex(pattern)))
    Line(dialect).feed(*(data[i : i + size] for i in range(0, len(data), size))).close()
    assert Counted.looks <= 60 * len(data)


def test_a_consumer_that_stops_early_loses_nothing():
    framer = Framer("line", [dialects.get("mks-rs485")], Context())
    stream = ASK + SPEED + ASK + SPEED
    first = next(framer.feed(Chunk(None, "line", stream)))
    rest = [*framer.feed(Chunk(None, "line", ASK)), *framer.close()]
    assert [e.data for e in (first, *rest)] == [ASK, SPEED, ASK, SPEED, ASK]


def test_an_empty_chunk_is_nothing():
    assert Line("mks-rs485").feed(b"").close().events == []
