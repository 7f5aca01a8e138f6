"""Every command of the LK catalogue against the emulated drive: replies, silence, models, errors, brake, readings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from analyzer.catalogue import Role
from analyzer.codec import codec
from analyzer.context import Context
from analyzer.errors import UsageError
from analyzer.framer import Framer
from analyzer.layout import Field
from analyzer.link import sum8
from analyzer.protocols.lk_rs485 import DIALECT, ERROR_BITS
from analyzer.protocols.mks_rs485 import DIALECT as MKS
from analyzer.records import Frame
from conformance.drives.drive import Request
from conformance.drives.lk.drive import ACTS, ANSWERS, FACTORY, MOVES, PARAMETERS, PHYSICAL, SENT, LkDrive
from tests.collect import Collect, run
from tests.conformance.drives.lk_bench import STEP_NS, Bench

MODELS = DIALECT.models
FLAGS = [f.name for f in ERROR_BITS]


def highest(field: Field) -> int:
    return max(field.choice_names, default=field.high) if field.fixed is None else field.fixed


def lowest(field: Field) -> int:
    return field.low if field.fixed is None else field.fixed


def log_of(bench: Bench, model: str) -> Collect:
    """Return what the analyzer's own pipeline makes of all that went over the bench."""
    return run(bench.chunks, [DIALECT.for_model(model)])


# --- the whole catalogue ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_every_vector_is_answered_without_a_finding(model: str) -> None:
    dialect = DIALECT.for_model(model)
    benches: dict[int, Bench] = {}
    answered = set()
    for command in dialect.commands:
        for vector in command.vectors:
            if vector.role is not Role.REQUEST or (vector.models and model not in vector.models):
                continue
            address = DIALECT.link.parse(vector.data).address
            bench = benches.setdefault(address, Bench(address, model=model))
            (reply,) = bench.send(vector.data)
            assert reply.at_ns == bench.t_ns - STEP_NS + 250_000
            head = DIALECT.link.parse(reply.data)
            assert (head.address, head.code) == (address, command.code)
            answered.add(command.name)
    assert answered == set(dialect.by_name)
    for bench in benches.values():
        log = log_of(bench, model)
        assert not log.findings
        assert not log.pieces
        assert len(log.entries) == len(bench.chunks)
        assert [e.message.role for e in log.entries] == [Role.REQUEST, Role.REPLY] * (len(log.entries) // 2)
        assert all(e.latency_ns == 250_000 for e in log.entries[1::2])


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("end", [lowest, highest])
def test_every_limit_of_every_field_is_answered_without_a_finding(model: str, end: Callable[[Field], int]) -> None:
    bench = Bench(model=model)
    for command in DIALECT.for_model(model).commands:
        for form in command.request_forms:
            if form.name == "unlisted_parameter":
                continue
            values = {n: end(f) for n, f in form.layout.named.items()}
            if command.name == "read_parameter":
                values["parameter"] = 10 if end is lowest else 38
            assert len(bench.ask(command.name, **values)) == 1
            bench.wait(0.3)
    log = log_of(bench, model)
    assert not log.findings
    assert not log.pieces


def test_the_tables_name_what_is_in_the_catalogue() -> None:
    names = set(DIALECT.by_name)
    assert set(ACTS) <= names
    assert set(ANSWERS) <= names
    assert set(FACTORY) <= set(PARAMETERS)
    fields = {n for c in DIALECT.commands for f in c.reply_forms for n in f.layout.named}
    assert set(PHYSICAL) | set(SENT) | set(PARAMETERS) | {"parameter", "parameter_bytes"} == fields
    assert not set(PHYSICAL) & set(SENT)
    assert {c.name for c in DIALECT.commands if c.name not in ACTS} == {
        "read_state_1", "read_state_2", "read_state_3", "read_parameter",
        "read_encoder", "read_position", "read_single_turn",
    }  # fmt: skip


# --- silence ----------------------------------------------------------------------------------------------------------


def raw(code: int, address: int, data: bytes = b"") -> bytes:
    head = bytes((0x3E, code, address, len(data)))
    return head + bytes((sum8(head),)) + (data + bytes((sum8(data),)) if data else b"")


def test_a_frame_of_another_dialect_meets_silence() -> None:
    drive = LkDrive()
    data = bytes.fromhex("FA 01 F6 01 40 02 34")
    assert drive.receive(Frame("bench", 0, 0, 0, data, MKS, Role.UNKNOWN, True), 0) == []


@pytest.mark.parametrize("number", [0, 9, 13, 29, 31, 39, 255])
def test_a_parameter_that_is_not_listed_meets_silence(number: int) -> None:
    bench = Bench()
    before = dict(bench.drive.parameters)
    assert bench.ask("read_parameter", parameter=number) == []
    assert bench.ask("write_parameter", parameter=number, parameter_bytes=1) == []
    assert bench.drive.parameters == before


# --- values that the manual forbids -----------------------------------------------------------------------------------


def test_reserved_bytes_are_not_looked_at() -> None:
    bench = Bench()
    plain = bench.send(raw(0xC0, 1, bytes.fromhex("20 00 00 00 00 00 00")))
    assert bench.send(raw(0xC0, 1, bytes.fromhex("20 01 02 03 04 05 06")))[0].data == plain[0].data
    bench.send(raw(0xA5, 1, bytes.fromhex("00 28 23 FF")))
    bench.wait(2)
    assert bench.position() == 9000


# --- state 1, 2, 3 ----------------------------------------------------------------------------------------------------


def test_state_1_follows_what_is_done_from_outside() -> None:
    bench = Bench()
    assert bench.read("read_state_1") == {
        "temperature": 30, "voltage": 2400, "current": 4, "state": 0, **dict.fromkeys(FLAGS, 0)
    }  # fmt: skip
    bench.drive.hot(-12.4)
    bench.drive.supply(19.5)
    state = bench.read("read_state_1")
    assert (state["temperature"], state["voltage"]) == (-12, 1950)
    assert not any(state[name] for name in FLAGS)
    bench.drive.hot(400)
    assert bench.read("read_state_1")["temperature"] == 127


@pytest.mark.parametrize(
    ("wrong", "right", "flags"),
    [
        (lambda d: d.supply(9.5), lambda d: d.supply(24), {"low_voltage"}),
        (lambda d: d.supply(55), lambda d: d.supply(24), {"high_voltage"}),
        (lambda d: d.hot(95), lambda d: d.hot(40), {"motor_hot"}),
        (lambda d: d.hot(115), lambda d: d.hot(40), {"motor_hot", "drive_hot"}),
        (lambda d: d.encoder_error(), lambda d: d.encoder_error(False), {"input_lost"}),
        (lambda d: d.trip("overcurrent"), lambda d: d.trip("overcurrent", False), {"overcurrent"}),
        (lambda d: d.trip("short_circuit"), lambda d: d.trip("short_circuit", False), {"short_circuit"}),
    ],
)
def test_errors_stay_until_they_are_cleared_and_their_cause_is_gone(wrong: Any, right: Any, flags: set[str]) -> None:
    bench = Bench()
    bench.ask("run_speed", speed=9000)
    bench.wait(1)
    wrong(bench.drive)

    def shown(command: str) -> set[str]:
        state = bench.read(command)
        return {name for name in FLAGS if state[name]}

    assert shown("read_state_1") == flags
    bench.wait(3)
    assert bench.speed() == 0  # the torque is gone
    assert shown("clear_errors") == flags
    right(bench.drive)
    assert shown("read_state_1") == flags
    bench.ask("run_speed", speed=9000)
    bench.wait(1)
    assert bench.speed() == 0
    assert shown("clear_errors") == set()
    bench.wait(1)
    assert bench.speed() == 0  # what was asked meanwhile is not taken up
    bench.ask("run_speed", speed=9000)
    bench.wait(1)
    assert bench.speed() == 90
    assert bench.read("read_state_1")["state"] == 0


def test_a_blocked_shaft_stalls() -> None:
    bench = Bench()
    bench.drive.block()
    bench.ask("move_increment", position=9000)
    assert bench.drive.next_ns() == 1_000_000_000
    bench.t_ns = 999_000_000
    assert bench.read("read_state_1")["stalled"] == 0
    bench.t_ns = 1_000_000_000
    assert bench.read("read_state_1")["stalled"] == 1
    assert bench.read("clear_errors")["stalled"] == 1
    bench.drive.block(False)
    assert bench.read("clear_errors")["stalled"] == 0
    bench.wait(1)
    assert bench.position() == 0
    bench.drive.block()
    bench.ask("run_torque", torque_current=500)
    bench.wait(5)
    assert bench.read("read_state_1")["stalled"] == 0  # a torque has no goal to miss
    assert bench.read("read_state_2")["torque_current"] == 500


def test_a_drive_without_supply_is_dead_and_powers_up_again() -> None:
    bench = Bench()
    bench.ask("write_parameter", parameter=32, speed_limit=1)
    bench.drive.supply(0)
    assert bench.ask("read_state_1") == []
    bench.drive.supply(24)
    state = bench.read("read_state_1")
    assert not any(state[name] for name in FLAGS)
    assert bench.read("read_parameter", parameter=32)["speed_limit"] == FACTORY["speed_limit"]


def test_trip_of_no_flag_is_told() -> None:
    with pytest.raises(UsageError, match="no error flag 'hot'"):
        LkDrive().trip("hot")


def test_phase_currents_add_up_to_nothing() -> None:
    bench = Bench(model="MG")
    bench.ask("run_torque", torque_current=800)
    for _ in range(20):
        bench.wait(0.1)
        phases = [v for n, v in bench.read("read_state_3").items() if n.startswith("phase")]
        assert abs(sum(phases)) <= 2
        assert max(map(abs, phases)) <= 800
    assert max(map(abs, phases)) >= 400


def test_reply_fields_are_cut_off_at_what_they_hold() -> None:
    bench = Bench(model="MS", settings={"torque_limit": 5000})
    bench.ask("run_speed", speed=72_000)
    bench.ask("brake", brake_control=0)
    assert bench.read("read_state_2")["power"] == 1000


# --- the encoder ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bits", "scale"), [(14, 1 << 14), (15, 1 << 15), (16, 1 << 16), (18, 1 << 16)])
def test_encoder_widths(bits: int, scale: int) -> None:
    bench = Bench(settings={"encoder_bits": bits, "encoder_zero": scale // 4}, angle=45.0)
    assert bench.read("read_encoder") == {
        "encoder": scale * 7 // 8, "encoder_raw": scale // 8, "encoder_offset": scale // 4
    }  # fmt: skip
    assert bench.read("read_state_2")["encoder"] == scale * 7 // 8
    assert bench.read("read_single_turn")["angle"] == 31500
    assert bench.position() == 31500
    bench.drive.turn_shaft(45.0)
    assert bench.read("read_encoder")["encoder"] == 0
    assert bench.read("read_single_turn")["angle"] == 0
    assert bench.position() == 36000


@pytest.mark.parametrize(("model", "bits"), [("MF", 14), ("MG", 18), ("MH", 15), ("MS", 16)])
def test_encoder_width_by_model(model: str, bits: int) -> None:
    bench = Bench(model=model, angle=-0.01)
    assert bench.read("read_encoder")["encoder_raw"] == (1 << min(bits, 16)) - (2 if bits > 15 else 1)


def test_angles_and_encoder_agree_all_the_way_round() -> None:
    bench = Bench(model="MF", settings={"encoder_zero": 1234})
    scale = bench.drive.motor.encoder_scale
    for _ in range(500):
        bench.drive.turn_shaft(1.237)
        angle = bench.read("read_single_turn")["angle"]
        encoder = bench.read("read_state_2")["encoder"]
        apart = abs(angle / 36000 - encoder / scale) % 1
        assert min(apart, 1 - apart) <= 1.5 / scale
        assert (bench.position() - angle) % 36000 in (0, 1, 35999)


# --- settings ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"nonsense": 1}, "no setting 'nonsense'"),
        ({"torque_limit": 32768}, "expected -32768..32767"),
        ({"encoder_bits": 17}, "expected one of 14, 15, 16, 18"),
        ({"encoder_bits": 14, "encoder_zero": 1 << 14}, "expected 0..16383"),
        ({"baud_rate": 12345}, "baud_rate: got 12345"),
    ],
)
def test_settings_that_cannot_be_are_told(settings: dict[str, int], text: str) -> None:
    with pytest.raises(UsageError, match=text):
        LkDrive(settings=settings)


def test_line_speed() -> None:
    assert LkDrive().speed == 115200
    assert LkDrive(settings={"baud_rate": 1_000_000}).speed == 1_000_000


def test_the_reply_form_is_the_one_of_its_fields() -> None:
    bench = Bench()
    for command in DIALECT.for_model("MF").commands:
        for form in command.reply_forms:
            values = {n: 0 if f.fixed is None else f.fixed for n, f in form.layout.named.items()}
            request = Request(bench.drive.responder, command, command.request_forms[0], {}, (), True)
            data = bench.drive.responder.reply(request, values, 1)
            head = DIALECT.link.parse(data)
            assert codec(form.layout).wire(data[head.start : head.stop]) == values


def test_every_move_is_a_command_of_motion() -> None:
    assert set(MOVES) == {c.name for c in DIALECT.commands if c.name.startswith(("run_", "move_"))}


def test_replies_are_found_by_the_framer() -> None:
    bench = Bench()
    bench.ask("read_state_2")
    framer = Framer("bench", [DIALECT], Context())
    frames = [f for c in bench.chunks for f in framer.feed(c)] + list(framer.close())
    assert [type(f) for f in frames] == [Frame, Frame]
