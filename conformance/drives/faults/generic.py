"""Faults of any drive, made from the link and the fields of its dialect: no row here knows how a drive works.

Three parts: the bytes of replies, numbers that are read or asked, and the limits of fields. A row says what it touches and
what it does to it; the dialects that have what it touches follow from the catalogue.

Rules kept here:
- Names are unique over all drives. Those of faults that only an LK drive has begin with `lk-`.
- On CAN a superfluous piece is a frame of its own.
- Where a fault is in a number, a limit or the meaning of a reply, the checks fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.layout import Field
from analyzer.link import sum8
from analyzer.protocols import lk_rs485, mks_rs485, mks_shared
from analyzer.protocols.lk_rs485 import SpinDirection
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Fault, Hooks, Outgoing
from conformance.drives.faults.numbers import (
    Number,
    accepts,
    at_least,
    at_most,
    half_signed,
    half_width,
    highest_refused,
    low_bits,
    lowest_refused,
    negated,
    one_less,
    one_more,
    plus,
    refuses,
    scaled,
    swap_bytes,
    to_highest,
    unlimited,
    without_sign,
)
from conformance.drives.faults.places import (
    CAN,
    CAN_LONGEST,
    EVERY,
    LK,
    MODBUS,
    NATIVE,
    SERIAL,
    TELLING,
    Change,
    Of,
    Row,
    Rows,
    Say,
    asked,
    bodies,
    body_of,
    byte,
    check,
    counted,
    every,
    faults,
    frames,
    limit,
    rebuilt,
    reply,
    signed,
    stored,
    together,
    whole,
)

LATE_NS = 2_000_000_000
LK_LATE_NS = 20_000_000
PAUSE_NS = 40_000_000
#: A drive that sleeps does so after this long without a request.
SLEEP_NS = 3_000_000_000
NOISE = bytes((0xFF, 0x00, 0x55))
LK_HEAD = 5
COUNTS = mks_shared.COUNTS_PER_TURN
#: Where the code stands in a reply: Modbus has a function there.
CODE_PLACES = {"mks-rs485": 2, "mks-modbus": 1, "mks-can": 0}
#: LK commands whose reply is what the host sent (0x95 has no verb of its own), and those that drive the motor.
LK_ECHOED = (Verb.MOTOR_OFF, Verb.MOTOR_ON, Verb.STOP, Verb.CLEAR_TURNS, Verb.OTHER)
LK_MOTIONS = (
    Verb.RUN_OPEN_LOOP,
    Verb.RUN_TORQUE,
    Verb.RUN_SPEED,
    Verb.MOVE_ABSOLUTE_AXIS,
    Verb.MOVE_SINGLE_TURN,
    Verb.MOVE_RELATIVE_AXIS,
)

# --- the bytes of replies --------------------------------------------------------------------------------------------


def _late(delay_ns: int) -> Say:
    return lambda drive, command, outgoing: (replace(outgoing, at_ns=outgoing.at_ns + delay_ns),)


def _lost(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    return ()


def _twice(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    return (outgoing, outgoing)


def _asleep() -> Say:
    """Lose the first reply after a pause."""
    last_ns = 0

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        nonlocal last_ns
        pause_ns, last_ns = outgoing.at_ns - last_ns, outgoing.at_ns
        return () if pause_ns >= SLEEP_NS else (outgoing,)

    return say


def _halting(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    half = len(outgoing.data) // 2
    yield replace(outgoing, data=outgoing.data[:half])
    yield replace(outgoing, data=outgoing.data[half:], at_ns=outgoing.at_ns + PAUSE_NS)


def _flipped(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    data = bytearray(outgoing.data)
    data[len(data) // 2] ^= 0x08
    yield replace(outgoing, data=bytes(data))


def _without_id(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    yield replace(outgoing, data=drive.dialect.link.completed(outgoing.data[:-1], 0))


def _echo(hooks: Hooks) -> None:
    """Repeat a request before its reply."""
    heard: list[Frame] = []

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        heard[:] = [frame]
        return wanted

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        if heard:
            yield replace(outgoing, data=heard.pop().data)
        yield outgoing

    hooks.accept.append(accept)
    hooks.reply.append(say)


def _under_id(change: Callable[[int], int]) -> Change:
    """Answer under another identifier, with the checksum that fits it."""

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        yield rebuilt(drive, replace(outgoing, can_id=change(outgoing.can_id or 0)), body_of(drive, outgoing))

    return frames(say)


def _next_code(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    yield rebuilt(drive, outgoing, byte(CODE_PLACES[drive.dialect.name], one_up)(body_of(drive, outgoing)))


def _lk_head(place: int, change: Callable[[int], int], of: Of = ()) -> Change:
    """Change a byte of an LK head, with the sum that fits it."""

    def apply(frame: bytes) -> bytes:
        start = byte(place, change)(frame[: LK_HEAD - 1])
        return start + bytes((sum8(start),)) + frame[LK_HEAD:]

    return whole(apply, of)


def _lk_data(change: Callable[[bytes], bytes], of: Of = ()) -> Change:
    """Change the data of an LK reply, with the length and the sums that fit it."""

    def apply(frame: bytes) -> bytes:
        data = change(frame[LK_HEAD:-1])
        start = frame[: LK_HEAD - 2] + bytes((len(data),))
        return start + bytes((sum8(start),)) + (data + bytes((sum8(data),)) if data else b"")

    return whole(apply, of)


def one_up(number: int) -> int:
    """Return the next number; of a byte, the change that is hardest to see."""
    return number + 1


def _added(number: int) -> Callable[[bytes], bytes]:
    return byte(0, lambda value: value + number)


LINK: Rows = {
    "checksum": (
        Row("checksum-wrong", "every reply has a wrong checksum", check(-1, _added(0x5A)), EVERY),
        Row("checksum-off-by-one", "the checksum is one too high", check(-1, _added(1)), EVERY),
        Row("checksum-missing", "replies end without a checksum", check(-1, lambda c: b""), EVERY),
        Row("checksum-doubled", "the checksum stands twice", check(-1, lambda c: c + c), EVERY),
        Row("checksum-zero", "the checksum is always 0", check(-1, lambda c: bytes(len(c))), EVERY),
        Row("checksum-inverted", "the checksum is sent as its complement",
            check(-1, lambda c: bytes(b ^ 0xFF for b in c)), EVERY),
        Row("flaky-checksum", "every fifth reply has a flipped bit", every(5, _flipped), EVERY),
        Row("checksum-without-head", "the checksum leaves the head out", check(-1, _added(-0xFB)), NATIVE),
        Row("checksum-without-id", "the checksum leaves the ID out", frames(_without_id), CAN),
        Row("crc-high-byte-first", "the CRC is sent high byte first", check(-1, lambda c: c[::-1]), MODBUS),
        Row("lk-data-sum-wrong", "the sum of a reply's data is one too high", check(1, _added(1))),
        Row("lk-head-sum-wrong", "the sum of a reply's head is one too high", check(0, _added(1))),
        Row("lk-data-sum-missing", "replies with data have no sum behind them", check(1, lambda c: b"")),
        Row("lk-data-sum-of-nothing", "replies without data carry a data sum of 00",
            whole(lambda f: f if len(f) > LK_HEAD else f + b"\0")),
        Row("lk-data-sum-with-head", "the sum of the data takes in the head",
            whole(lambda f: f[:-1] + bytes((sum8(f[:-1]),)) if len(f) > LK_HEAD else f)),
        Row("lk-head-sum-without-start", "the sum of the head leaves out the 3E", check(0, _added(-0x3E))),
    ),
    "time": (Row("late-reply", "every reply comes two seconds late", frames(_late(LATE_NS)), EVERY),),
    "timing": (Row("lk-reply-late", "replies come 20 ms after the request", frames(_late(LK_LATE_NS))),),
    "lost": (
        Row("lost-reply", "every third reply is not sent", every(3, _lost), EVERY),
        Row("first-after-pause-lost", "the first reply after three seconds of silence is not sent", counted(_asleep), EVERY),
        Row("first-reply-only", "every second reply is not sent", every(2, _lost), EVERY),
    ),
    "shape": (
        Row("doubled-reply", "every reply is sent twice", frames(_twice), EVERY),
        Row("half-frame", "of every reply only the first half is sent", whole(lambda f: f[: len(f) // 2]), EVERY),
        Row("spurious-bytes", "three bytes of noise come before every reply",
            frames(lambda drive, command, outgoing: (replace(outgoing, data=NOISE), outgoing)), EVERY),
        Row("trailing-byte", "a zero byte comes behind every reply", whole(lambda f: f + b"\0"), EVERY),
        Row("echo", "the request is repeated before every reply", Change(_echo), EVERY),
        Row("pause-in-frame", "every reply stops for 40 ms in its middle", frames(_halting), SERIAL + LK),
    ),
    "reply": (
        Row("lk-reply-lost", "each fourth reply is lost", every(4, _lost)),
        Row("lk-reply-twice", "replies come twice", frames(_twice)),
        Row("lk-reply-cut", "replies break off two bytes before their end", whole(lambda f: f[:-2])),
        Row("lk-reply-noise", "a byte 00 comes before each reply", whole(lambda f: b"\0" + f)),
    ),
    "head": (
        Row("wrong-reply-head", "replies begin with FA", bodies(byte(0, lambda _: 0xFA)), NATIVE),
        Row("unknown-reply-head", "replies begin with FD", bodies(byte(0, lambda _: 0xFD)), NATIVE),
    ),
    "reply head": (Row("lk-reply-start-wrong", "replies begin with 3D", _lk_head(0, lambda _: 0x3D)),),
    "address": (
        Row("wrong-reply-address", "replies carry an address one too high",
            bodies(lambda b: byte(1 if b[0] == 0xFB else 0, one_up)(b)), SERIAL),
        Row("wrong-reply-id", "replies carry an ID one too high", _under_id(one_up), CAN),
        Row("reply-under-id-0", "replies carry the ID 0", _under_id(lambda _: 0), CAN),
    ),
    "reply address": (Row("lk-reply-address-wrong", "replies carry the next higher address", _lk_head(2, one_up)),),
    "code": (Row("wrong-reply-code", "replies carry a code (Modbus: function) one too high", frames(_next_code)),),
    "reply code": (
        Row("lk-reply-code-wrong", "motion commands are answered with the code of 0x9C instead of their own",
            _lk_head(1, lambda _: 0x9C, LK_MOTIONS)),
        Row("lk-echo-code-wrong", "0x80, 0x81, 0x88, 0x93 and 0x95 are answered with the next higher code",
            _lk_head(1, one_up, LK_ECHOED)),
    ),
    "length": (
        Row("reply-too-short", "replies lack their last byte of data", bodies(lambda b: b[:-1])),
        Row("reply-too-long", "replies have a byte of data more", bodies(lambda b: b + b"\0")),
        Row("reply-padded", "replies are filled up to eight bytes behind their checksum",
            whole(lambda f: f.ljust(CAN_LONGEST, b"\0")), CAN),
    ),
    "reply length": (
        Row("lk-reply-length-wrong", "the length of a reply counts the data sum too", _lk_head(3, lambda n: n + 1 if n else n)),
        Row("lk-reply-short", "replies to motion commands lack the last byte of their data",
            _lk_data(lambda d: d[:-1], LK_MOTIONS)),
    ),
    "reply layout": (
        Row("lk-motion-reply-empty", "motion commands are answered with a head alone, without the state",
            _lk_data(lambda d: b"", LK_MOTIONS)),
        Row("lk-set-position-reply-empty", "0x95 is answered with a head alone instead of an echo",
            _lk_data(lambda d: b"", Verb.OTHER)),
        Row("lk-echo-with-status", "0x80, 0x81, 0x88 and 0x93 are answered with a data byte 00 instead of an echo",
            _lk_data(lambda d: d or b"\0")),
        Row("lk-parameter-bytes-shifted", "the values that 0xC0 and 0xC1 answer stand one byte too early",
            _lk_data(lambda d: d[:1] + d[2:] + b"\0", (Verb.READ_PARAMETER, Verb.WRITE_PARAMETER))),
    ),
}  # fmt: skip

# --- numbers ---------------------------------------------------------------------------------------------------------


class Measure(NamedTuple):
    """A number that is read: how the names of its faults begin, how it is told, its fields, the commands that answer it."""

    name: str
    told: str
    fields: tuple[str, ...]
    of: Of = ()


#: What an LK motor is driven with: MS drives have a power.
TORQUE = ("torque_current", "power")
MEASURES = (
    Measure("carry", "30: carry", ("carry",), Verb.READ_ENCODER_CARRY),
    Measure("encoder", "30: encoder", ("encoder",), Verb.READ_ENCODER_CARRY),
    Measure("position", "31: position", ("position",), Verb.READ_POSITION),
    Measure("speed", "32: speed", ("speed",), Verb.READ_SPEED),
    Measure("pulses", "33: pulses", ("pulses",), Verb.READ_PULSES),
    Measure("angle-error", "39: angle error", ("angle_error",), Verb.READ_ANGLE_ERROR),
    Measure("lk-position", "0x92: position", ("position",), Verb.READ_POSITION),
    Measure("lk-angle", "0x94: angle", ("angle",)),
    Measure("lk-voltage", "0x9A and 0x9B: voltage", ("voltage",)),
    Measure("lk-torque", "0x9C: torque current", TORQUE),
    Measure("lk-speed", "0x9C: speed", ("speed",)),
    Measure("lk-encoder", "0x9C: encoder", ("encoder",), (Verb.READ_STATE_2, *LK_MOTIONS)),
)
#: What can be wrong with each: the end of the fault's name (of an MKS and an LK drive), what it breaks, text and change.
#: MKS drives send the high byte first, LK drives the low byte.
WRONG_NUMBERS: tuple[tuple[str, str, str, str, Number], ...] = (
    ("low-byte-first", "bytes-swapped", "byte order", "is sent {wrong} byte first", swap_bytes),
    ("sign-turned", "sign-turned", "sign", "has the wrong sign", negated),
    ("without-sign", "sign-lost", "sign", "is sent without its sign", without_sign),
    ("half-width", "half-width", "width", "has half its bits", half_width),
    ("doubled", "doubled", "scale", "is twice what it should be", scaled(2)),
)
#: What would not show: a voltage is never below 0, and 16 bits hold an angle within a turn.
UNSEEN = frozenset({"lk-voltage-sign-lost", "lk-angle-half-width"})


def _wrong_numbers() -> Iterator[Fault]:
    """Yield a fault of each kind for each measured number; one without a sign has none to be wrong."""
    for end, lk_end, breaks, text, change in WRONG_NUMBERS:
        for name, told, fields, of in MEASURES:
            lk = name.startswith("lk-")
            dialect = lk_rs485.DIALECT if lk else mks_rs485.DIALECT
            full, wrong = (f"{name}-{lk_end}", "high") if lk else (f"{name}-{end}", "low")
            if full not in UNSEEN and (breaks != "sign" or signed(dialect, fields[0], of)):
                yield from faults({breaks: (Row(full, f"{told} {text.format(wrong=wrong)}", reply(fields, change, of)),)})


#: A control parameter of an LK drive that has more than 16 bits.
WIDE_PARAMETERS = ("speed_limit", "angle_limit", "current_ramp", "speed_ramp")
MULTI_TURN, INCREMENTS = Verb.MOVE_ABSOLUTE_AXIS, Verb.MOVE_RELATIVE_AXIS


def tenfold(value: int, field: Field) -> int:
    """Return ten times a number, or the highest that its field holds."""
    return min(10 * value, field.high)


NUMBER: Rows = {
    "byte order": (
        Row("current-bytes-swapped", "83 stores the current low byte first", stored("current", swap_bytes), CAN),
        Row("lk-asked-speed-swapped", "0xA2 takes the speed high byte first", asked("speed", swap_bytes)),
        Row("lk-asked-angle-swapped", "0xA5 and 0xA6 take the angle high byte first", asked("angle", swap_bytes)),
    ),
    "sign": (
        Row("negative-positions-cut", "positions below zero are taken for zero", asked("position", at_least(0))),
        Row("lk-asked-speed-sign-lost", "0xA2 runs clockwise, for both signs", asked("speed", without_sign)),
        Row("lk-increment-sign-lost", "0xA7 and 0xA8 go clockwise, for both signs",
            asked("position", without_sign, INCREMENTS)),
        Row("lk-temperature-unsigned", "temperatures below zero are answered as 0", reply("temperature", at_least(0))),
    ),
    "width": (
        Row("position-16-bit", "moves by the encoder keep only 16 bits of the position",
            asked("position", low_bits(16), (Verb.MOVE_RELATIVE_AXIS, Verb.MOVE_ABSOLUTE_AXIS))),
        Row("pulses-16-bit", "FD keeps only 16 bits of the pulses", asked("pulses", low_bits(16))),
        Row("speed-8-bit", "speeds keep only their low byte", asked("speed", low_bits(8))),
        Row("speed-12-bit", "of a speed above 4095 motions keep 12 bits", asked("speed", low_bits(12))),
        Row("speed-15-bit", "of a speed above 32767 motions keep 15 bits", asked("speed", low_bits(15))),
        Row("home-speed-low-byte", "90 stores only the low byte of the speed", stored("home_speed", low_bits(8))),
        Row("lk-position-int32", "0x92 answers only the lower 32 bits of the angle",
            reply("position", half_signed, Verb.READ_POSITION)),
        Row("lk-target-int32", "0xA3 and 0xA4 take only the lower 32 bits of the angle",
            asked("position", half_signed, MULTI_TURN)),
        Row("lk-asked-speed-24-bit", "0xA2 takes only the lower 24 bits of the speed", asked("speed", low_bits(24))),
        Row("lk-max-speed-24-bit", "moves keep only 24 bits of max_speed", asked("max_speed", low_bits(24))),
        Row("lk-max-speed-at-most-65535", "a max_speed above 65535 counts as that",
            asked("max_speed", lambda value, field: min(value, 0xFFFF))),
        Row("lk-asked-speed-int16", "0xA2 takes only the lower 16 bits of the speed", asked("speed", half_signed)),
        Row("lk-parameter-int16", "0xC1 takes only the lower 16 bits of limits and ramps",
            asked(WIDE_PARAMETERS, low_bits(16))),
    ),
    "scale": (
        Row("angle-error-in-counts", "the angle error is in counts of the encoder",
            reply("angle_error", scaled(COUNTS, 51200))),
        Row("position-in-pulses", "31 shows pulses of 3200 a turn",
            reply("position", scaled(3200, COUNTS), Verb.READ_POSITION)),
        Row("position-offset", "31 shows 100 counts too many", reply("position", plus(100), Verb.READ_POSITION)),
        Row("move-pulses-doubled", "FD moves by twice the pulses", asked("pulses", scaled(2))),
        Row("speed-5-percent-high", "F6 turns five per cent too fast", asked("speed", scaled(21, 20), Verb.RUN_SPEED)),
        Row("lk-asked-speed-tenfold", "0xA2 takes the speed in 0.1 deg/s", asked("speed", scaled(10))),
        Row("lk-speed-tenth", "replies have the speed in 10 deg/s", reply("speed", scaled(1, 10))),
        Row("lk-position-tenth", "0x92 answers the angle in 0.1 deg", reply("position", scaled(1, 10), Verb.READ_POSITION)),
        Row("lk-target-tenfold", "0xA3 and 0xA4 take the angle in 0.1 deg", asked("position", scaled(10), MULTI_TURN)),
        Row("lk-voltage-tenth", "the voltage is answered in 0.1 V", reply("voltage", scaled(1, 10))),
        Row("lk-torque-half", "replies have half the torque current", reply(TORQUE, scaled(1, 2))),
        Row("lk-max-speed-tenfold", "max_speed is taken in 0.1 deg/s", asked("max_speed", tenfold)),
    ),
}  # fmt: skip

# --- limits and choices ----------------------------------------------------------------------------------------------

LIMIT: Rows = {
    "limit": (
        Row("current-highest-refused", "83 refuses the highest current", limit("current", highest_refused)),
        Row("current-one-more", "83 accepts one mA more than the highest", limit("current", one_more)),
        Row("current-zero-refused", "83 refuses 0 mA", limit("current", lowest_refused)),
        Row("current-unlimited", "83 accepts any current", limit("current", unlimited)),
        Row("current-clipped", "83 cuts a current that is too high and says success",
            together(limit("current", unlimited), stored("current", to_highest))),
        Row("home-speed-one-more", "90 accepts 3001 rpm", limit("home_speed", one_more)),
        Row("home-speed-highest-refused", "90 refuses 3000 rpm", limit("home_speed", highest_refused)),
        Row("home-current-unlimited", "94 (CAN: 93) accepts any current", limit("home_current", unlimited)),
        Row("zero-speed-5", "9A accepts the speed 5", limit("zero_speed", one_more)),
        Row("zero-speed-5-at-corners", "9A accepts the speed 5 where it sets a zero counter-clockwise",
            limit("zero_speed", one_more, {"set_zero": 1, "zero_direction": 1})),
        Row("home-direction-2-at-corners", "90 accepts the direction 2 for homing without a switch",
            limit("home_direction", accepts(2), {"home_mode": 1}), CAN),
        Row("zero-speed-4-refused", "9A refuses the speed 4", limit("zero_speed", highest_refused)),
        Row("stall-tolerance-one-more", "89 accepts 8000h", limit("stall_tolerance", one_more)),
        Row("stall-tolerance-highest-refused", "89 refuses 7FFFh", limit("stall_tolerance", highest_refused)),
        Row("address-0-accepted", "8B accepts the address of all drives", limit("new_address", accepts(0))),
        Row("address-248-accepted", "8B accepts an address that Modbus reserves", limit("new_address", accepts(248))),
        Row("group-0-accepted", "8D accepts the address of all drives", limit("group_address", accepts(0))),
        Row("acceleration-256-accepted", "moves accept an acceleration of 256 and take it for 0",
            together(limit("acceleration", accepts(256)), asked("acceleration", low_bits(8)))),
        Row("speed-2800-at-most", "3000 rpm is run at 2800", asked("speed", at_most(2800))),
        Row("address-highest-refused", "8B refuses the highest address", limit("new_address", highest_refused), TELLING),
        Row("address-beyond-7ff", "8B accepts 800h", limit("new_address", one_more), CAN),
        Row("lowest-position-accepted", "moves accept -8388608", limit("position", accepts(-8388608)), CAN),
    ),
    "choice": (
        Row("work-mode-6-accepted", "82 accepts a mode that is not listed", limit("work_mode", accepts(6))),
        Row("holding-current-0-refused", "9B refuses 0 (10 %), as the manual's head has it",
            limit("holding_current", refuses(0))),
        Row("holding-current-8-refused", "9B refuses 8 (90 %)", limit("holding_current", refuses(8))),
        Row("holding-current-9-accepted", "9B accepts 9", limit("holding_current", accepts(9))),
        Row("enable-always-refused", "85 refuses 2 (always)", limit("enable_level", refuses(2))),
        Row("enable-3-accepted", "85 accepts 3", limit("enable_level", accepts(3))),
        Row("baud-256000-refused", "8A refuses 7 (256000)", limit("baud_rate", refuses(7))),
        Row("baud-0-accepted", "8A accepts 0", limit("baud_rate", accepts(0))),
        Row("bit-rate-0-refused", "8A refuses 0 (125 kbit/s)", limit("bit_rate", refuses(0))),
        Row("bit-rate-4-accepted", "8A accepts 4", limit("bit_rate", accepts(4))),
        Row("subdivision-256-refused", "84 refuses 256 (0 on serial lines and CAN)", limit("subdivision", refuses(0, 256))),
        Row("subdivision-257-accepted", "84 accepts 257", limit("subdivision", accepts(257))),
        Row("home-direction-2-accepted", "90 accepts a third direction", limit("home_direction", accepts(2))),
        Row("respond-2-accepted", "8C accepts 2", limit("respond", accepts(2))),
        Row("save-any-state", "FF accepts any state", limit("save_state", unlimited)),
        Row("pulse-delay-3-refused", "87 refuses 3 (40 ms)", limit("pulse_delay", refuses(3))),
        Row("close-mode-refused", "82 refuses SR_CLOSE", limit("work_mode", refuses(4)), SERIAL),
        Row("open-mode-refused", "82 refuses the open loop without an encoder", limit("work_mode", refuses(0x14)), CAN),
        Row("subdivision-3-accepted", "84 accepts a subdivision that is not listed", limit("subdivision", accepts(3)), CAN),
        Row("subdivision-25-refused", "84 refuses 25", limit("subdivision", refuses(25)), CAN),
    ),
    "range": (
        Row("lk-torque-any", "0xA1 obeys torque currents beyond 2048", limit("torque_current", unlimited)),
        Row("lk-torque-short", "0xA1 does not obey its highest torque current", limit("torque_current", highest_refused)),
        Row("lk-torque-short-below", "0xA1 does not obey its lowest torque current", limit("torque_current", lowest_refused)),
        Row("lk-torque-one-more", "0xA1 obeys one torque current too many above", limit("torque_current", one_more)),
        Row("lk-torque-one-less", "0xA1 obeys one torque current too many below", limit("torque_current", one_less)),
        Row("lk-power-any", "0xA0 obeys powers beyond 850", limit("power", unlimited)),
        Row("lk-power-short", "0xA0 does not obey its highest power", limit("power", highest_refused)),
        Row("lk-power-short-below", "0xA0 does not obey its lowest power", limit("power", lowest_refused)),
        Row("lk-power-one-more", "0xA0 obeys one power too many above", limit("power", one_more)),
        Row("lk-power-one-less", "0xA0 obeys one power too many below", limit("power", one_less)),
        Row("lk-angle-any", "0xA5 and 0xA6 obey angles beyond 359.99 degrees", limit("angle", unlimited)),
        Row("lk-angle-short", "0xA5 and 0xA6 do not obey 359.99 degrees", limit("angle", highest_refused)),
        Row("lk-angle-one-more", "0xA5 and 0xA6 obey 360 degrees", limit("angle", one_more)),
        Row("lk-angle-not-0", "0xA5 and 0xA6 do not obey 0 degrees", limit("angle", lowest_refused)),
    ),
    "choices": (
        Row("lk-direction-any", "0xA5 and 0xA6 take any direction but 0 for counter-clockwise", limit("direction", unlimited)),
        Row("lk-direction-not-1", "0xA5 and 0xA6 do not obey counter-clockwise",
            limit("direction", refuses(SpinDirection.CCW))),
    ),
}  # fmt: skip

FAULTS = (*faults(LINK), *_wrong_numbers(), *faults(NUMBER, LIMIT))
