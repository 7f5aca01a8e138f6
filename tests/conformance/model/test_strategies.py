"""Limits, strategies and plain requests: what is drawn is what was asked for, and within the bounds, without filtering."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from analyzer import dialects, encoder
from analyzer.catalogue import Dialect, Risk
from analyzer.codec import codec
from analyzer.layout import FieldKind
from analyzer.records import CanFrame
from conformance.gate.bounds import Bounds, Leeway
from conformance.gate.gate import Judge
from conformance.gate.permissions import Allowance
from conformance.model import limits, strategies
from conformance.talk import samples

NAMES = ("mks-rs485", "mks-modbus", "mks-can", "lk-rs485")
EVERY = [(name, model) for name in NAMES for model in ("", *dialects.get(name).models)]
MODELS = [pair for pair in EVERY if pair[1]]
#: What is filtered or thrown away fails these tests: no health check is suppressed but that of the time.
QUICK = settings(max_examples=40, derandomize=True, database=None, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def spoken(name: str, model: str) -> Dialect:
    dialect = dialects.get(name)
    return dialect.for_model(model) if model else dialect


def fields(dialect):
    """Yield every field of every request, with its command and form."""
    for command in dialect.commands:
        for form in command.request_forms:
            for field in form.layout.named.values():
                if field.kind is not FieldKind.BYTES:
                    yield command, form, field


@pytest.mark.parametrize(("name", "model"), EVERY)
def test_every_value_of_a_field_is_inside_or_outside(name, model):
    for command, _, field in fields(spoken(name, model)):
        edges, beyond = limits.edges(field), limits.beyond(field)
        assert all(map(field.allows, edges)), (command.name, field.name)
        assert not any(map(field.allows, beyond)), (command.name, field.name)
        assert all(field.wire_minimum <= v <= field.wire_maximum for v in beyond)
        stretches = sorted(limits.allowed(field) + limits.forbidden(field))
        if field.fixed is None:
            assert stretches[0][0] == field.wire_minimum
            assert stretches[-1][1] == field.wire_maximum
            assert all(a[1] + 1 == b[0] for a, b in pairwise(stretches))


def test_the_limits_are_those_of_the_model():
    current = {m: limits.edges(spoken("mks-rs485", m).by_name["set_current"].request_forms[0].layout.named["current"])
               for m in ("42D", "57D", "28D")}  # fmt: skip
    assert current == {"42D": (0, 3000), "57D": (0, 5200), "28D": (0, 3000)}
    narrow = spoken("mks-rs485", "42D").by_name["set_current"].request_forms[0].layout.named["current"]
    assert limits.beyond(narrow) == (3001, 65535)


def test_gaps_between_choices_are_outside():
    fields_of = spoken("mks-can", "42E").by_name
    mode = fields_of["set_work_mode"].request_forms[0].layout.named["work_mode"]
    assert limits.edges(mode) == (0, 2, 3, 4, 5, 0x10, 0x14)
    assert limits.beyond(mode) == (1, 6, 0x0F, 0x11, 0x13, 0x15, 0xFF)
    position = fields_of["move_absolute_axis"].request_forms[0].layout.named["position"]
    assert limits.beyond(position) == (-8388608,)
    byte = fields_of["run_speed"].request_forms[0].layout.named["acceleration"]
    assert limits.beyond(byte) == ()
    assert strategies.outside(byte).is_empty


@QUICK
@given(st.data())
def test_strays_have_one_value_outside_and_reserved_sets_none(data):
    command, form, _ = data.draw(st.sampled_from(list(fields(spoken("mks-can", "42E")))))
    wrong = strategies.strays(form.layout)
    if not wrong.is_empty:
        stray = data.draw(wrong)
        outside = [n for n, f in form.layout.named.items() if not f.allows(stray.values[n])]
        assert outside == [stray.field], command.name
    reserved = strategies.reserved_set(form.layout)
    if not reserved.is_empty:
        found = {v.rule for v in codec(form.layout).broken(data.draw(reserved))}
        assert found == {"reserved_bits"}


BOUNDS = Bounds(speed=300, turns=2, acceleration=200, current=1000)
LEEWAYS = (strategies.NO_BOUNDS, Leeway(BOUNDS), Leeway(BOUNDS, subdivision=16, degrees=100.0, pulses=50))


@pytest.mark.parametrize("leeway", LEEWAYS)
@pytest.mark.parametrize(("name", "model"), MODELS[::3])
@pytest.mark.parametrize("risks", [{Risk.READ}, {Risk.READ, Risk.SETTING, Risk.MOTION}, set(Risk)])
def test_requests_are_valid_and_pass_a_gate_of_the_same_risks_and_bounds(name, model, risks, leeway):
    dialect = spoken(name, model)
    bounds = leeway.bounds
    allowance = Allowance(
        frozenset(risks), bounds.speed, bounds.turns, bounds.acceleration, bounds.current, alone=True,
        subdivision=leeway.subdivision,
    )  # fmt: skip
    seen = set()

    @QUICK
    @given(strategies.requests(dialect, risks, leeway))
    def drawn(request):
        built = encoder.assemble(dialect, request.command, 1, request.values, form=request.form)
        assert built.refusals == ()
        assert built.risks <= risks | {Risk.READ}
        judge = Judge(allowance, [dialect])
        if leeway.degrees is not None:
            judge.known.note_position(leeway.degrees, 1, leeway.pulses)
        item = CanFrame(0, "bus", 1, built.frame) if dialect.bus == "can" else built.frame
        own = [o for o in judge.objections(item) if o.interpretation.command is request.command]
        assert own == []
        seen.add(request.command.name)

    drawn()
    assert len(seen) > (3 if risks == {Risk.READ} else 10)


@QUICK
@given(strategies.packages(dialects.get("mks-rs485"), {Risk.READ, Risk.MOTION}, Leeway(BOUNDS), addresses=(1, 2, 3)))
def test_packages_hold_requests_of_the_same_risks(package):
    dialect = dialects.get("mks-rs485")
    built = encoder.assemble(dialect, package.command, 0, package.values)
    assert len(built.frame) == 52
    assert built.risks <= {Risk.READ, Risk.MOTION}
    assert built.refusals == ()


def test_what_is_drawn_without_a_test_is_the_same_each_time_and_different_for_another_seed():
    spans = [(5, 5), (10, 11), (-(1 << 40), 1 << 40), (1 << 50, (1 << 50) + 4)]
    first = limits.between(spans, 5, "a")
    assert len(set(first)) == 5
    assert first == limits.between(spans, 5, "a")
    assert first != limits.between(spans, 5, "b")
    many = limits.between(spans, 20, "a")
    assert all(any(low < value < high for low, high in spans) for value in many)
    assert min(map(abs, many)) < 1 << 16 < 1 << 30 < max(map(abs, many))
    assert limits.between([(5, 5), (10, 11)], 3, "a") == ()


@pytest.mark.parametrize(("name", "model"), EVERY)
def test_plain_requests_are_valid_and_move_little_and_slowly(name, model):
    dialect = spoken(name, model)
    leeway = Leeway(Bounds(speed=60, turns=1, acceleration=200), subdivision=16, dialect=dialect)
    for command in dialect.commands:
        values = samples.sample(dialect, command, address=3)
        built = encoder.assemble(dialect, command, 3, values)
        assert built.refusals == (), command.name
        if command.slots is not None:
            continue
        for field_name, field in built.form.layout.named.items():
            if field.name in ("speed", "max_speed", "acceleration", "pulses") and field.fixed is None:
                stretch = limits.allowed(field, leeway, command=command)
                assert any(low <= values[field_name] <= high for low, high in stretch), (command.name, field_name)
        if "new_address" in values:
            assert values["new_address"] == 3
    assert samples.sample(dialect, dialect.commands[0]) == {}
