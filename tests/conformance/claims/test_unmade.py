"""A claim that cannot be made for a dialect costs that claim alone, and says so."""

from __future__ import annotations

import pytest

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Motion, MotionKind, Risk, Role, Verb, always
from analyzer.layout import Layout, StatePart, i16, i32, u8, u16
from analyzer.link import CanLink, HeadLink, sum8
from conformance import claims
from conformance.claim import NotRun, Theme
from conformance.claims.declare import Case, claim, declared_in, made

EMPTY, STATUS = Layout(), Layout(u8("status"))
STOPS = ("stop",)


def command(verb, code, *risks, request=EMPTY, reply=STATUS, motion=None):
    return Command(
        name=verb.value,
        verb=verb,
        code=code,
        section="1",
        summary="x",
        risk=(always(*risks),),
        request=request,
        reply=reply,
        motion=motion,
    )


POSITION = command(
    Verb.READ_POSITION, 0x21, Risk.READ, reply=Layout(i32("position", unit="deg", state=StatePart("position", 1.0)))
)
SPEED = command(Verb.READ_SPEED, 0x22, Risk.READ, reply=Layout(i16("speed", unit="rpm", state=StatePart("speed", 1.0))))
ON = command(Verb.MOTOR_ON, 0x30, Risk.MOTION, motion=Motion(kind=MotionKind.HOLD))
STOP = command(Verb.STOP, 0x31, Risk.MOTION, motion=Motion(kind=MotionKind.STOP))
RUN = command(
    Verb.RUN_SPEED,
    0x32,
    Risk.UNBOUNDED,
    request=Layout(i16("speed", unit="rpm")),
    motion=Motion(kind=MotionKind.RUN, speed="speed", stops=STOPS),
)
MOVE = command(
    Verb.MOVE_ABSOLUTE_AXIS,
    0x33,
    Risk.MOTION,
    request=Layout(i32("position", unit="deg")),
    motion=Motion(kind=MotionKind.MOVE_TO, distance="position", stops=STOPS, counted_by="read_position"),
)
TURN = command(
    Verb.MOVE_SINGLE_TURN,
    0x34,
    Risk.MOTION,
    request=Layout(u16("angle", unit="deg", maximum=359)),
    motion=Motion(kind=MotionKind.MOVE_IN_TURN, distance="angle", stops=STOPS, counted_by="read_position"),
)
NODE = command(Verb.SET_ADDRESS, 0x35, Risk.SETTING, Risk.LINK, request=Layout(u8("node", minimum=1, maximum=15)))
PARAMETER = command(Verb.READ_PARAMETER, 0x36, Risk.READ, request=Layout(u8("index")), reply=Layout(u8("index"), u16("value")))
LINKS = {"can": CanLink(), "serial": HeadLink(heads={0xAA: Role.REQUEST, 0x55: Role.REPLY}, check=sum8)}
TOYS = {
    "one read": (POSITION,),
    "reads": (POSITION, SPEED),
    "motor on": (POSITION, ON),
    "run": (POSITION, SPEED, ON, RUN, STOP),
    "moves": (POSITION, SPEED, ON, RUN, STOP, MOVE),
    "move in turn": (POSITION, SPEED, ON, RUN, STOP, TURN),
    "address": (POSITION, SPEED, NODE),
    "parameter": (POSITION, SPEED, PARAMETER),
}


def toy(bus, *commands):
    return Dialect("toy", "A toy", "Its manual", bus, LINKS[bus], commands, addresses=(1, 15), baud_rates=(9600,))


def unmade(made_claims):
    return [c.id for c in made_claims if "/unmade/" in c.id]


@pytest.mark.parametrize("bus", LINKS)
@pytest.mark.parametrize("which", TOYS)
def test_every_claim_about_a_small_dialect_can_be_made(bus, which):
    every = claims.every(toy(bus, *TOYS[which]))
    assert not unmade(every)
    assert {c.theme for c in every} >= {Theme.SHAPE, Theme.FRAMING, Theme.RESILIENCE}


def test_a_motor_on_command_without_parameters_has_range_claims():
    ids = {c.id for c in claims.every(toy("serial", *TOYS["run"]))}
    assert {"toy/ranges/run_speed/speed/lowest", "toy/ranges/run_speed/speed/highest"} <= ids


def test_a_dialect_without_any_read_keeps_the_claims_that_need_none():
    every = claims.every(toy("serial", ON))
    lost = unmade(every)
    assert lost
    assert not any(i.startswith("toy/shape/") for i in lost)
    assert any(c.theme is Theme.SHAPE for c in every)


@pytest.mark.parametrize("dialect", dialects.every(), ids=lambda d: d.name)
def test_every_claim_about_the_dialects_of_this_package_can_be_made(dialect):
    assert not unmade(claims.every(dialect))


def test_what_stands_for_it_does_not_run_and_says_why():
    def broken(dialect):
        yield next(made(dialect, Theme.STATE, "good", claims.every))
        raise KeyError("nothing")

    first, second = made(toy("can", *TOYS["reads"]), Theme.STATE, "broken", broken)
    assert "/unmade/" not in first.id
    assert second.id == "toy/state/unmade/broken"
    with pytest.raises(NotRun, match="cannot be made for toy: KeyError: 'nothing'"):
        second.check(None)


def _cases(dialect):
    for verb in (Verb.READ_SPEED, Verb.RUN_SPEED, Verb.READ_POSITION):
        yield Case(dialect, dialect.by_verb.get(verb))


@claim(Theme.STATE, each=_cases, refuted_by="x", risks=lambda case: case.command.all_risks)
def _declared(probe, command):
    """{command} holds."""


def test_a_case_that_cannot_be_declared_costs_that_case():
    found = [c.id for c in declared_in(__name__, toy("serial", *TOYS["reads"]))]
    assert found == ["toy/state/read_speed/declared", "toy/state/unmade/declared-1", "toy/state/read_position/declared"]
