"""The toy drive: CAN identifiers that are not addresses, no checksum, motor on, run, move to, stop.

    identifier 04D = node 2 << 5 | code 0D      data little-endian, as ODrive's CAN protocol has it

A package of its own would hold just this file and an entry point.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from fractions import Fraction

from analyzer.catalogue import Command, Dialect, Motion, MotionKind, Replies, Risk, Subject, Vector, Verb, always, when
from analyzer.layout import Effect, Layout, Order, StatePart, i32, u8, u16
from analyzer.link import CanLink, Check, CommandShape, FormShape, Head, Part, Role

_CODE_BITS = 5
_CODES = (1 << _CODE_BITS) - 1
LITTLE = {"order": Order.LITTLE}
TENTH, HUNDREDTH = Fraction(1, 10), Fraction(1, 100)


@dataclass(frozen=True)
class NodeLink(CanLink):
    """Data frames whose identifier holds the node and the code; the data has neither, nor a checksum."""

    shortest = 0
    checked = False

    def identifier(self, command: CommandShape, address: int) -> int:
        return address << _CODE_BITS | command.code

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        identifier = can_id or 0
        return Head(identifier >> _CODE_BITS, Role.UNKNOWN, identifier & _CODES, None, 0, len(frame))

    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        return ()

    def fits(self, frame: bytes, can_id: int | None = None) -> bool:
        return True

    def build(self, command: CommandShape, form: FormShape, address: int, data: bytes, role: Role) -> bytes:
        return data

    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        return body

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        return ()


class Status(IntEnum):
    """The answer to a setting or a motion."""

    REFUSED = 0
    DONE = 1


class Power(IntEnum):
    """Whether the motor is on."""

    OFF = 0
    ON = 1


_ANSWER = Layout(u8("status", choices=Status))
_DONE = Replies(final={1}, failed={0})
_STOPS = ("stop",)

DIALECT = Dialect(
    name="toy-can",
    title="A toy drive on CAN",
    manual="The toy's manual V2",
    bus="can",
    link=NodeLink(),
    family="toy",
    sections={Subject.FRAMING: "1", Subject.ADDRESSING: "1", Subject.SILENCE: "1"},
    addresses=(0, 62),
    broadcast=None,
    baud_rates=(500_000,),
    commands=(
        Command(
            name="motor_on",
            verb=Verb.MOTOR_ON,
            code=0x07,
            section="2.1",
            summary="Switch the motor on or off.",
            risk=(when("power", 0, None, Risk.TORQUE), when("power", 1, 0xFF, Risk.MOTION)),
            request=Layout(u8("power", choices=Power, default=Power.ON)),
            reply=_ANSWER,
            replies=_DONE,
            motion=Motion(kind=MotionKind.HOLD),
        ),
        Command(
            name="run",
            verb=Verb.RUN_SPEED,
            code=0x0D,
            section="2.2",
            summary="Turn at a speed until told otherwise.",
            risk=(always(Risk.MOTION, Risk.UNBOUNDED),),
            request=Layout(i32("speed", minimum=-5000, maximum=5000, unit="rpm", scale=TENTH, **LITTLE)),
            reply=_ANSWER,
            replies=_DONE,
            motion=Motion(kind=MotionKind.RUN, speed="speed", stops=_STOPS),
            vectors=(Vector("04D 2C 01 00 00", {"speed": 300}),),
        ),
        Command(
            name="move_to",
            verb=Verb.MOVE_ABSOLUTE_AXIS,
            code=0x0C,
            section="2.3",
            summary="Turn to a place.",
            risk=(always(Risk.MOTION),),
            request=Layout(
                i32("position", unit="deg", scale=HUNDREDTH, **LITTLE),
                u16("speed", maximum=5000, unit="rpm", scale=TENTH, **LITTLE),
            ),
            reply=_ANSWER,
            replies=_DONE,
            motion=Motion(
                kind=MotionKind.MOVE_TO, speed="speed", distance="position", stops=_STOPS, counted_by="read_position"
            ),
        ),
        Command(
            name="stop",
            verb=Verb.STOP,
            code=0x18,
            section="2.4",
            summary="Stop, keeping the torque.",
            risk=(always(Risk.MOTION),),
            request=Layout(u8("why", maximum=3, default=0)),
            reply=_ANSWER,
            replies=_DONE,
            motion=Motion(kind=MotionKind.STOP),
        ),
        Command(
            name="read_position",
            verb=Verb.READ_POSITION,
            code=0x09,
            section="3.1",
            summary="Read the position.",
            risk=(always(Risk.READ),),
            request=Layout(),
            reply=Layout(i32("position", unit="deg", scale=HUNDREDTH, state=StatePart("position", 1.0), **LITTLE)),
        ),
        Command(
            name="read_speed",
            verb=Verb.READ_SPEED,
            code=0x14,
            section="3.2",
            summary="Read the speed.",
            risk=(always(Risk.READ),),
            request=Layout(),
            reply=Layout(i32("speed", unit="rpm", scale=TENTH, state=StatePart("speed", 1.0), **LITTLE)),
        ),
        Command(
            name="set_current",
            verb=Verb.SET_CURRENT,
            code=0x0B,
            section="2.5",
            summary="Set the highest current.",
            risk=(always(Risk.SETTING, Risk.TORQUE),),
            request=Layout(u16("current", maximum=4000, unit="mA", default=1000, effect=Effect.CURRENT, **LITTLE)),
            reply=_ANSWER,
            replies=_DONE,
        ),
    ),
)
