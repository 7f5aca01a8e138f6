"""What a gate reads in bytes: every frame, however it is wrapped, cut or spoiled; and what it must not see in plain reads."""

from __future__ import annotations

import itertools
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Risk, Role
from analyzer.codec import codec
from analyzer.decoder import Decoder, slots_of
from analyzer.encoder import build
from analyzer.layout import Field
from analyzer.link import sum8
from analyzer.records import CanFrame, Frame
from conformance.gate.gate import Allowance, Item, Judge, Refused
from conformance.gate.interpretations import Pending, SerialInterpreter
from tests.conformance.vectors import ALL, EVERYTHING, READS, RISKY, SAFE, SERIAL, Sending, ids, on_can

MKS = dialects.get("mks-rs485")
LK = dialects.get("lk-rs485")
MODBUS = dialects.get("mks-modbus")
CAN = dialects.get("mks-can")
RISKY_BYTES = [s for s in RISKY if s.dialect.bus == "serial"]
READ = bytes.fromhex("FA 01 31 2C")
RUN = bytes.fromhex("FA 01 F6 01 40 02 34")


def judge(*risks: Risk, alone: bool = True) -> Judge:
    """Return a judge that allows these risks and has no neighbours to mind."""
    return Judge(Allowance(frozenset(risks), alone=alone))


def refuses(item: Item, *before: bytes, risks: frozenset[Risk] = READS) -> bool:
    """Say whether an item is refused behind others that are let through."""
    found = judge(*risks)
    for sent in before:
        found.admit(sent)
    return bool(found.objections(item))


def leaves(pieces: list[bytes], *risks: Risk) -> bool:
    """Say whether all the pieces leave, one after the other."""
    found = judge(*risks)
    try:
        for piece in pieces:
            found.admit(piece)
    except Refused:
        return False
    return True


def spoiled(data: bytes) -> bytes:
    """Return a frame with its last check wrong."""
    return data[:-1] + bytes((data[-1] ^ 0x55,))


# --- the manuals' frames ----------------------------------------------------------------------------------------------


def test_there_are_risky_and_safe_examples_of_each_dialect():
    for chosen in (SAFE, RISKY):
        assert {s.dialect.name for s in chosen} == set(dialects.names())


def test_a_read_needs_nothing():
    assert [(each, found) for each in SAFE if (found := judge().objections(each.item))] == []


def test_an_example_needs_its_own_risks_and_no_more():
    assert [(each, found) for each in ALL if (found := judge(*each.risks).objections(each.item))] == []


def test_an_example_needs_each_of_its_risks():
    # Who may run for ever may move: the one brings the other.
    lacking = [
        (each, risk)
        for each in RISKY
        for risk in each.risks - READS - ({Risk.MOTION} if Risk.UNBOUNDED in each.risks else set())
    ]
    assert len(lacking) >= len(RISKY)
    assert [
        (each, f"without {risk}") for each, risk in lacking if not judge(*(each.risks - {risk})).objections(each.item)
    ] == []


@pytest.mark.parametrize("sending", RISKY_BYTES, ids=ids(RISKY_BYTES))
class TestRiskyUnderReadsAlone:
    """A gate that allows only reads refuses a risky frame in any wrapping."""

    def test_as_it_is(self, sending: Sending):
        assert refuses(sending.data)

    def test_with_a_wrong_check(self, sending: Sending):
        assert refuses(spoiled(sending.data))

    def test_without_its_check(self, sending: Sending):
        assert refuses(sending.data[:-1])

    def test_behind_and_before_other_bytes(self, sending: Sending):
        assert refuses(b"\x00\x55\xff" + sending.data)
        assert refuses(sending.data + b"\x00\x55")
        assert refuses(b"\x55" + spoiled(sending.data) + b"\x55")

    def test_between_reads(self, sending: Sending):
        assert refuses(READ + sending.data + READ)
        assert refuses(READ + spoiled(sending.data) + READ)

    def test_cut_anywhere(self, sending: Sending):
        for cut in range(1, len(sending.data)):
            assert not leaves([sending.data[:cut], sending.data[cut:]]), f"cut behind {cut} bytes"
            assert not leaves([spoiled(sending.data)[:cut], spoiled(sending.data)[cut:]]), f"spoiled, cut behind {cut}"

    def test_byte_by_byte_and_between_noise(self, sending: Sending):
        assert not leaves([bytes((byte,)) for byte in sending.data])
        assert not leaves([b"\x55\x00", *(bytes((byte,)) for byte in sending.data), b"\x00"])

    def test_behind_a_long_time_of_reads(self, sending: Sending):
        assert not leaves([*[READ] * 20, sending.data[:2], sending.data[2:]])


MKS_COMMANDS = [s for s in RISKY_BYTES if s.dialect is MKS and s.command.slots is None]


def package(*slots: bytes) -> bytes:
    data = b"\xfc" + b"".join(s.ljust(10, b"\0") for s in slots).ljust(50, b"\0")
    return data + bytes((sum8(data),))


@pytest.mark.parametrize("sending", MKS_COMMANDS, ids=ids(MKS_COMMANDS))
def test_inside_a_package(sending: Sending):
    body = sending.data[1:-1]
    whole = package(b"\x02\x31", body)
    for wrapped in (whole, spoiled(whole), whole[:-1], whole[:25]):
        assert refuses(wrapped)
    assert not leaves([whole[:11], whole[11:]])
    found = [r for r in judge().interpret(whole) if r.slot == 2]
    assert [r.command.name for r in found if r.command] == [sending.command.name]
    assert found[0].risks >= sending.risks


def test_a_package_of_reads_only_reads_and_is_meant_for_several():
    item = package(b"\x01\x31", b"\x02\x32")
    assert judge().objections(item) == []
    reasons = [o.reasons for o in judge(alone=False).objections(item)]
    assert ("a package, which several drives obey",) in reasons


def test_an_empty_package_is_one_too():
    assert judge().objections(package()) == []
    assert judge(alone=False).objections(package())


def test_a_slot_with_an_uncatalogued_code_is_unknown():
    found = judge().objections(package(b"\x01\x55"))
    assert next(o.reasons for o in found) == ("needs unknown",)


# --- another dialect's guise ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sending", RISKY_BYTES, ids=ids(RISKY_BYTES))
def test_a_frame_of_one_dialect_inside_the_data_of_another(sending: Sending):
    # LK frames of any length: a head, a known read, and the frame as its data.
    data = sending.data
    head = bytes((0x3E, 0x9A, 1, len(data)))
    carrier = head + bytes((sum8(head),)) + data + bytes((sum8(data),))
    assert refuses(carrier)
    # A write of registers by Modbus.
    registers = data + b"\0" * (len(data) % 2)
    body = bytes((1, 0x10, 0x77, 0x00, 0, len(registers) // 2, len(registers))) + registers
    assert refuses(MODBUS.link.completed(body))


def test_a_reply_head_is_read_as_a_request():
    assert refuses(bytes.fromhex("FB 01 F6 01 40 02 35"))
    assert not refuses(bytes.fromhex("FB 01 31 2D"))


def test_lk_data_of_another_length_than_its_command_is_the_worst():
    head = bytes((0x3E, 0xA2, 1, 5))
    found = judge().objections(head + bytes((sum8(head),)) + bytes(6))
    assert Risk.UNBOUNDED in found[0].interpretation.risks
    assert "5 bytes of data, expected 4" in str(found[0])


def test_modbus_registers_beside_those_of_a_command_are_unknown():
    body = bytes.fromhex("01 10 00 F6 00 03 06 00 02 00 00 00 00")
    found = judge(Risk.MOTION, Risk.UNBOUNDED).objections(MODBUS.link.completed(body))
    assert any("needs unknown" in o.reasons for o in found)


# --- unknown codes ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "FA 01 55 50", "FA 01 55 51", "00 FA 01 55 50", "FA 01 55", "FA 01 31 2C FA 01 55 01 51",
        "3E 55 01 00 94", "3E 55 01 00 95", "00 3E 55 01 00 94", "3E 55",
        "01 06 77 00 00 01", "01 06 77 00 00 01 00 00", "01 10 77 00 00 01 02 00 01",
        "01 05 00 01 FF 00",
    ],
)  # fmt: skip
def test_an_uncatalogued_code_needs_unknown(text: str):
    found = judge(*(EVERYTHING - {Risk.UNKNOWN})).objections(bytes.fromhex(text))
    assert found
    assert all("needs unknown" in o.reasons for o in found)
    assert judge(Risk.UNKNOWN).objections(bytes.fromhex(text)) == []


def test_an_uncatalogued_code_cut_into_pieces():
    for text in ("FA 01 55 50", "3E 55 01 00 94"):
        data = bytes.fromhex(text)
        for cut in range(1, len(data)):
            assert not leaves([data[:cut], data[cut:]])


def test_modbus_functions_that_nobody_knows_count_where_their_crc_fits():
    frame = MODBUS.link.completed(bytes.fromhex("01 2B 0E 01 00"))
    assert refuses(frame)
    assert refuses(b"\x00" + frame)
    assert not leaves([frame[:3], frame[3:]])
    assert not refuses(spoiled(frame))


# --- no alarm without a cause -----------------------------------------------------------------------------------------


SAFE_BYTES = [s.data for s in SAFE if s.dialect.bus == "serial"]


def test_reads_of_all_dialects_behind_each_other():
    for first, second in itertools.product(SAFE_BYTES, repeat=2):
        assert not refuses(second, first), f"{second.hex(' ')} behind {first.hex(' ')}"


def test_allowed_examples_behind_each_other():
    known = EVERYTHING - {Risk.UNKNOWN}
    reader = SerialInterpreter([MKS, MODBUS, LK])
    chosen = list({s.command.name: s for s in SERIAL}.values()) + [s for s in SERIAL if s.dialect is LK][::4]
    for first, second in itertools.product(chosen, repeat=2):
        readings = reader.interpret(reader.interpret(Pending(), first.data)[1], second.data)[0]
        assert all(r.risks <= known for r in readings), f"{second.name} behind {first.name}"


@pytest.mark.parametrize("dialect", [MKS, MODBUS, LK, CAN], ids=lambda d: d.name)
def test_a_scan_over_all_addresses_is_never_refused(dialect: Dialect):
    found = judge(alone=False)
    reads = [c for c in dialect.commands if c.all_risks == READS and not c.request_forms[0].layout.fields]
    for address in range(1, min(dialect.addresses[1], 255) + 1):
        for command in reads:
            frame = build(dialect, command, address)
            found.admit(frame if dialect.bus == "serial" else on_can(address, frame))


#: The read of the brake is one by its value: cut off, it could still be anything.
ALWAYS_SAFE = [s.data for s in SAFE if s.dialect.bus == "serial" and s.command.all_risks == READS]


def test_garbled_reads_do_nothing_but_read():
    for data in ALWAYS_SAFE:
        for garbled in (spoiled(data), data[:-1], data[:-2], data + data, data + b"\x00", b"\x00\xff" + data):
            assert not refuses(garbled), garbled.hex(" ")
            assert not refuses(data, garbled), f"{data.hex(' ')} behind {garbled.hex(' ')}"


def test_heads_left_over_before_a_read():
    for head in ("FA", "FA FA", "FA FA FA", "FA 01", "FB", "FC", "3E", "3E 3E", "3E 9A", "01", "01 04 00", "01 06", "FC 01"):
        for data in SAFE_BYTES:
            assert not refuses(data, bytes.fromhex(head)), f"{data.hex(' ')} behind {head}"


@settings(max_examples=150)
@given(st.lists(st.binary(min_size=1, max_size=12), max_size=6), st.sampled_from(SAFE_BYTES))
def test_a_plain_read_can_always_follow(before: list[bytes], data: bytes):
    found = judge()
    for item in before:
        if not found.objections(item):
            found.admit(item)
    assert found.objections(data) == []


def _drawn(field: Field, rng: random.Random) -> int:
    if field.fixed is not None:
        return field.fixed
    chosen = field.values or [v for v in field.choice_names if field.allows(v)]
    return rng.choice(sorted(chosen)) if chosen else rng.randint(field.low, field.high)


def _random_request(dialect: Dialect, command: Command, rng: random.Random) -> tuple[frozenset[Risk], Item]:
    form = rng.choice(command.request_forms)
    values = {name: _drawn(field, rng) for name, field in form.layout.named.items()}
    frame = dialect.link.build(command, form, 1, codec(form.layout).encode(values), Role.REQUEST)
    return command.risks(values), frame if dialect.bus == "serial" else on_can(1, frame)


@pytest.mark.parametrize("dialect", dialects.every(), ids=lambda d: d.name)
def test_random_allowed_requests_are_seldom_refused(dialect: Dialect):
    rng = random.Random(11)
    commands = [c for c in dialect.commands if c.slots is None]
    found = Judge(Allowance(addresses=frozenset({1})))
    refused = 0
    for _ in range(1200):
        risks, item = _random_request(dialect, rng.choice(commands), rng)
        under = found.under(Allowance(risks, addresses=frozenset({1}), alone=Risk.LINK in risks))
        try:
            under.admit(item)
        except Refused:
            refused += 1
    # LK's long data hold other dialects' heads now and then: one in three hundred.
    assert refused / 1200 < 0.01


# --- the stream -------------------------------------------------------------------------------------------------------


def test_what_was_sent_is_forgotten_once_nothing_in_it_can_go_on():
    reader = SerialInterpreter([MKS, LK])
    assert reader.interpret(Pending(), READ)[1] == Pending()
    assert reader.interpret(Pending(), READ[:3])[1].tail == READ[:3]
    assert len(reader.interpret(Pending(), b"\xfc" + bytes(20))[1].tail) == 21


def test_it_never_grows_beyond_the_longest_frame():
    reader = SerialInterpreter(dialects.every()[:2])
    stream = Pending()
    rng = random.Random(3)
    for _ in range(300):
        _, stream = reader.interpret(stream, rng.randbytes(5))
        assert len(stream.tail) <= 262


@settings(max_examples=200)
@given(st.binary(min_size=2, max_size=40), st.data())
def test_cutting_hides_no_sound_frame(data: bytes, drawn: st.DataObject):
    whole = SerialInterpreter([MKS, LK])
    fitting = {(r.dialect.name, r.code, r.data) for r in whole.interpret(Pending(), data)[0] if r.fits and r.command}
    cuts = sorted(drawn.draw(st.sets(st.integers(1, len(data) - 1), max_size=4)))
    cut = SerialInterpreter([MKS, LK])
    stream, seen = Pending(), set()
    for start, stop in itertools.pairwise([0, *cuts, len(data)]):
        readings, stream = cut.interpret(stream, data[start:stop])
        seen |= {(r.dialect.name, r.code, r.data) for r in readings if r.fits}
    assert fitting <= seen


def sound_frames(data: bytes) -> list[tuple[Dialect, bytes]]:
    """Return every frame of every dialect that checks, at any offset: by the dialects' own slicers."""
    found = []
    for dialect in (MKS, MODBUS, LK):
        slicer = dialect.link.slicer(dialect.commands, lambda address, function: 0)
        for at in range(len(data)):
            if data[at] in slicer.heads:
                found += [(dialect, data[at : at + n]) for n in slicer.lengths(data, at, len(data)) if n > 0]
    return found


def risks_of(dialect: Dialect, frame: bytes) -> frozenset[Risk]:
    """Return the risks of a request as the decoder reads it."""
    decoder = Decoder(dialect)
    message, _ = decoder.decode(Frame("bus", 0, 0, 0, frame, dialect, Role.REQUEST, True))
    if message.role is Role.REPLY or message.command is None:
        return READS
    if message.command.slots is not None:
        slots = slots_of(dialect, message.command, message.data)
        return frozenset().union(READS, *(s.command.risks({}) for s in slots if s.command is not None and s.form is None))
    if message.form is None:
        return READS
    return message.command.risks(message.values)


PIECES = st.lists(
    st.one_of(
        st.tuples(st.sampled_from(SERIAL), st.integers(0, 8), st.integers(1, 17)).map(lambda p: p[0].data[p[1] : p[1] + p[2]]),
        st.sampled_from([s.data for s in SERIAL]),
        st.binary(min_size=1, max_size=6),
    ).filter(bool),
    min_size=1,
    max_size=12,
)  # fmt: skip


@settings(max_examples=150)
@given(PIECES, st.sets(st.sampled_from(sorted(EVERYTHING))))
def test_no_sound_frame_that_is_not_allowed_ever_stands_in_what_left(pieces: list[bytes], allowed: set[Risk]):
    # An oracle that shares nothing with the gate but the catalogue: all that left, searched by slicers and decoded.
    found = judge(*allowed)
    left = b""
    for piece in pieces:
        if not found.objections(piece):
            found.admit(piece)
            left += piece
    for dialect, frame in sound_frames(left):
        beyond = risks_of(dialect, frame) - found.allowance.risks
        assert not beyond, f"{dialect.name} {frame.hex(' ')} in {left.hex(' ')}"


# --- CAN --------------------------------------------------------------------------------------------------------------


RISKY_CAN = [s for s in RISKY if isinstance(s.item, CanFrame)]


@pytest.mark.parametrize("sending", RISKY_CAN, ids=ids(RISKY_CAN))
def test_a_risky_can_frame_is_refused_in_any_form(sending: Sending):
    frame = sending.item
    assert isinstance(frame, CanFrame)
    data = frame.data
    for changed in (data, spoiled(data), data[:-1], data[:1], data[:7] + b"\0"):
        assert judge().objections(on_can(frame.id, changed)), changed.hex(" ")
    for options in ({"extended": True}, {"remote": True}, {"fd": True}):
        found = judge(Risk.UNKNOWN).objections(CanFrame(None, "host", frame.id, data, **options))
        assert found, options


@pytest.mark.parametrize(
    ("frame", "why"),
    [
        (CanFrame(None, "host", 1, b"\x31\x32", extended=True), "29 bits"),
        (CanFrame(None, "host", 0x800, b"\x31\x31"), "29 bits"),
        (CanFrame(None, "host", 1, b"\x31\x32", remote=True), "remote"),
        (CanFrame(None, "host", 1, b"\x31\x32", fd=True), "FD"),
        (CanFrame(None, "host", 1, b"\x31\x32", error=True), "error"),
        (CanFrame(None, "host", 1, b""), "without data"),
        (CanFrame(None, "host", 1, b"\x55\x56"), "0x55"),
    ],
)
def test_strange_can_frames_need_unknown(frame: CanFrame, why: str):
    found = judge(*(EVERYTHING - {Risk.UNKNOWN})).objections(frame)
    assert why in str(found[0])
    assert judge(Risk.UNKNOWN).objections(frame) == []


def test_garbled_reads_on_can_only_read():
    for data in ("31 32", "31 33", "31", "31 00 32", "00 84 85", "00 84"):
        assert not judge().objections(on_can(1, bytes.fromhex(data))), data


# --- other people's links ---------------------------------------------------------------------------------------------


def test_a_dialect_on_another_link_is_read_by_its_slicer():
    from dataclasses import replace

    from analyzer.link import Link
    from analyzer.link.interface import SlicerFinder

    class Foreign(Link):
        """Native MKS frames behind another name."""

        def __getattribute__(self, name: str):
            own = name.startswith("__") or name == "finder"
            return object.__getattribute__(self, name) if own else getattr(MKS.link, name)

        def slicer(self, commands, expects): ...
        def parse(self, frame, can_id=None): ...
        def checks(self, frame, can_id=None): ...
        def build(self, command, form, address, data, role): ...
        def parts(self, frame, can_id=None): ...
        def completed(self, body, can_id=None): ...

    dialect = replace(MKS, name="foreign", link=Foreign())
    assert isinstance(dialect.link.finder(dialect.commands), SlicerFinder)
    found = Judge(Allowance(), [dialect])
    assert found.objections(RUN)
    assert found.objections(spoiled(RUN))
    assert found.objections(bytes.fromhex("FA 01 55 50"))
    assert not found.objections(READ)
