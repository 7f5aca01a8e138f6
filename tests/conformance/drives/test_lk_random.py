"""Random requests, good and bad: the LK drive never raises, and answers what it must and nothing else."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from analyzer.catalogue import Command, Form, Role
from analyzer.codec import codec
from analyzer.link import sum8
from analyzer.protocols.lk_rs485 import DIALECT
from analyzer.records import Frame
from conformance.drives.lk.drive import LkDrive
from conformance.drives.lk.quirks import QUIRKS
from conformance.drives.receiver import Receiver
from tests.conformance.drives.lk_bench import Bench

ADDRESS = 3
READ = bytes.fromhex("3E 9C 03 00 DD")
EXAMPLES = settings(max_examples=150, suppress_health_check=list(HealthCheck))


@st.composite
def requests(draw: st.DrawFn, model: str) -> tuple[bytes, Command, Form]:
    """Return a request of the catalogue with values all over the wire's range, at the limits too."""
    command = draw(st.sampled_from(DIALECT.for_model(model).commands))
    form = draw(st.sampled_from(command.request_forms))
    values = {
        name: draw(
            st.one_of(
                st.sampled_from(sorted({f.low, f.high, f.wire_minimum, f.wire_maximum, *f.choice_names})),
                st.integers(f.wire_minimum, f.wire_maximum),
            )
        )
        for name, f in form.layout.named.items()
        if f.fixed is None
    }
    address = draw(st.sampled_from([ADDRESS, ADDRESS, ADDRESS, ADDRESS, 0, 1, 33, 255]))
    data = codec(form.layout).encode(values)
    return DIALECT.link.build(command, form, address, data, Role.REQUEST), command, form


@st.composite
def sequences(draw: st.DrawFn) -> tuple[str, list[Any]]:
    """Return a model and what is done to it: requests, some spoiled, waits and scenarios."""
    model = draw(st.sampled_from(DIALECT.models))
    wait = st.sampled_from([0.0, 0.001, 0.1, 1.7, 4000.0])
    scenario = st.sampled_from(
        [
            lambda d: d.block(),
            lambda d: d.block(False),
            lambda d: d.turn_shaft(-777.7),
            lambda d: d.supply(5),
            lambda d: d.supply(0),
            lambda d: d.supply(24),
            lambda d: d.hot(-300),
            lambda d: d.hot(300),
            lambda d: d.hot(20),
            lambda d: d.encoder_error(),
            lambda d: d.encoder_error(False),
            lambda d: d.power_cycle(d.now_ns),
        ]
    )
    spoil = st.none() | st.integers(0, 17)
    step = st.one_of(st.tuples(requests(model), spoil), st.tuples(requests(model), st.none()), wait, scenario)
    # 150 examples, about half of their steps requests: more than five thousand.
    return model, draw(st.lists(step, min_size=70, max_size=90))


@EXAMPLES
@given(sequences())
def test_random_requests(given: tuple[str, list[Any]]) -> None:
    model, steps = given
    bench = Bench(ADDRESS, model=model)
    for step in steps:
        if isinstance(step, float):
            bench.wait(step)
        elif not isinstance(step, tuple):
            step(bench.drive)
        else:
            (frame, command, form), spoiled = step
            if spoiled is not None:
                at = spoiled % len(frame)
                frame = frame[:at] + bytes((frame[at] ^ 0x55,)) + frame[at + 1 :]
            check_exchange(bench, frame, command, form, spoiled is not None)
        due = bench.drive.next_ns()
        assert due is None or due > bench.drive.now_ns


def check_exchange(bench: Bench, frame: bytes, command: Command, form: Form, spoiled: bool) -> None:
    sent = bench.send(frame)
    to_it = frame[2] == ADDRESS
    must = to_it and bench.drive.listening and not spoiled and not _unlisted(command, form, frame)
    if not must:
        assert sent == []
        return
    (reply,) = sent
    head = DIALECT.link.parse(reply.data)
    assert (head.address, head.code) == (ADDRESS, command.code)
    assert all(check.ok for check in DIALECT.link.checks(reply.data))
    data = reply.data[head.start : head.stop]
    fitting = [f for f in bench.drive.dialect.by_name[command.name].reply_forms if codec(f.layout).matches(data)]
    assert fitting
    assert not codec(fitting[0].layout).broken(data)


def _unlisted(command: Command, form: Form, frame: bytes) -> bool:
    if command.name not in ("read_parameter", "write_parameter"):
        return False
    return frame[5] not in {f.layout.named["parameter"].fixed for f in command.reply_forms}


@EXAMPLES
@given(
    code=st.integers(0, 255),
    address=st.sampled_from([ADDRESS, 0, 4]),
    data=st.binary(max_size=16),
    off=st.sampled_from([0, 0, 0, 1]),
)
def test_random_codes_and_lengths(code: int, address: int, data: bytes, off: int) -> None:
    bench = Bench(ADDRESS, model="MF")
    head = bytes((0x3E, code, address, len(data)))
    frame = head + bytes((sum8(head) ^ off,)) + (data + bytes((sum8(data),)) if data else b"")
    sent = bench.send(frame)
    known = {(c.code, f.layout.byte_length) for c in bench.drive.dialect.commands for f in c.request_forms}
    if off or address != ADDRESS or (code, len(data)) not in known:
        assert sent == []


@EXAMPLES
@given(st.lists(st.binary(max_size=40) | st.sampled_from([READ, b"\x3e", b"\x3e\xa2\x03"]), max_size=12))
def test_random_bytes_through_the_receiver(chunks: list[bytes]) -> None:
    drive = LkDrive(address=ADDRESS)
    receiver = Receiver(drive.dialect, byte_ns=86_805)
    t_ns = 0
    for chunk in chunks:
        if chunk:
            for frame in receiver.feed(chunk, t_ns, 86_805):
                for reply in drive.receive(frame, frame.last_ns):
                    assert reply.at_ns == frame.last_ns + 250_000
        t_ns += 86_805 * len(chunk) + 100_000_000
    receiver.expire(t_ns)
    t_ns += 1_000_000_000
    (frame,) = receiver.feed(READ, t_ns, 86_805)
    assert len(drive.receive(frame, frame.last_ns)) == 1


@pytest.mark.parametrize("model", DIALECT.models)
def test_time_may_stand_still_and_does_not_go_back(model: str) -> None:
    bench = Bench(model=model)
    bench.ask("move_multi_turn", position=36_000)
    bench.wait(5)
    frame = Frame("bench", 0, 0, 0, bench.request("read_position"), DIALECT, Role.UNKNOWN, True)
    first, second = (bench.drive.receive(frame, t_ns)[0] for t_ns in (bench.t_ns, 0))
    assert first.data == second.data


@settings(max_examples=60)
@given(data=st.data(), quirks=st.sets(st.sampled_from(QUIRKS), max_size=6))
def test_quirks_together_never_raise(data: st.DataObject, quirks: set[Any]) -> None:
    bench = Bench(ADDRESS, model="MS", quirks=sorted(quirks, key=lambda q: q.name), seed=9)
    for frame, _, _ in data.draw(st.lists(requests("MS"), max_size=8)):
        bench.send(frame)
        bench.wait(0.2)
