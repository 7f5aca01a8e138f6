"""What the Lingkong motor RS485 manual V2.36 says a drive does, statement by statement, in the manual's order.

Sections are the numbers of the headings, as in the catalogue; the pages before the first command go by their own headings.
The two tables of a command, request and reply, are said in the same three statements for each.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Statement as S

_REPLY_PARTS = ("head", "code", "address", "length", "once", "clean")
_SETUP = "the setup program's limits can be neither read nor set on the bus"
_LIGHT = "not visible on the bus: a light"
_SCALE = "amperes need a meter: on the bus the number alone is seen"


def _tables(section: str, command: str, code: str, request: int, reply: int) -> tuple[S, ...]:
    """Return what the tables of a command say: `request` and `reply` bytes of data."""
    asked, told = (f"{n} bytes of data" if n else "no data" for n in (request, reply))
    parts = tuple(f"shape/{command}/{part}" for part in _REPLY_PARTS)
    return (
        S(
            f"{section}/request",
            f"{command} has code {code} and {asked}.",
            (f"shape/{command}/answered", f"examples/{command}/*"),
        ),
        S(f"{section}/reply", f"The reply has the head, code and address of the request, and {told}.", parts),
        S(f"{section}/reply-sums", "Each sum of the reply fits.", (f"shape/{command}/*checksum",)),
    )


def _limited(section: str, *limits: str, **claims: tuple[str, ...]) -> tuple[S, ...]:
    """Return the remarks on what a setup program limits; `claims` about a limit hold one motion against the others."""
    found = []
    for limit in limits:
        own = claims.get(limit.lower().replace(" ", "_"), ())
        says = f"{limit} of the setup program limits it."
        found.append(S(f"{section}/{limit.lower().replace(' ', '-')}", says, own, unclaimed="" if own else _SETUP))
    return tuple(found)


def _tells_state(section: str, command: str) -> S:
    says = "The reply tells what 9C tells: temperature, torque current (MS: power), speed and encoder."
    return S(f"{section}/tells-state", says, (f"motion/{command}/crossed-tells", f"motion/{command}/tells-now"))


def _to_a_position(section: str, command: str, of: str, *unit: str) -> Iterator[S]:
    """Yield what is said of a move to a position over all turns. `of`: of what a unit is said; `unit`: claims about it."""
    reaches = f"motion/{command}/reaches"
    yield S(f"{section}/moves", "It moves the motor to a position over all turns.", (reaches, f"motion/{command}/absolute"))
    type_of = "The position is signed, of eight bytes, low byte first."
    yield S(f"{section}/type", type_of, (f"ranges/{command}/position/*",))
    yield S(f"{section}/unit", f"One unit{of} is 0.01 degrees: 36000 are a turn.", (reaches, *unit))
    yield S(f"{section}/direction", "It turns from where it is towards the target.", (reaches,))


def _within_the_turn(section: str, command: str, null: str, of: str, *unit: str) -> Iterator[S]:
    """Yield what is said of a move to an angle within the turn. `null`: its byte that is 0; `of`, `unit`: as above."""
    reaches, ways = f"motion/{command}/reaches", (f"motion/{command}/two-ways", f"motion/{command}/way-round")
    yield S(f"{section}/moves", "It moves the motor to an angle within the turn.", (reaches,))
    yield S(f"{section}/clockwise", "Direction 0 turns clockwise.", (f"motion/{command}/clockwise", *ways))
    counter = (*ways, f"ranges/{command}/direction/*")
    yield S(f"{section}/counterclockwise", "Direction 1 turns counterclockwise.", counter)
    yield S(f"{section}/range", "The angle is 0 to 35999, unsigned, of two bytes.", (f"ranges/{command}/angle/*",))
    yield S(f"{section}/unit", f"One unit{of} is 0.01 degrees.", (reaches, *unit))
    observed = f"observed by ranges/{command}/reserved: what another value does is not said"
    yield S(f"{section}/null", f"The {null} byte is 0.", unclaimed=observed)


def _by_an_increment(section: str, command: str, of: str) -> Iterator[S]:
    """Yield what is said of a move by an angle. `of`: as above."""
    reaches, ranges = f"motion/{command}/reaches", f"ranges/{command}/position/*"
    yield S(
        f"{section}/moves", "It moves the motor by an angle.", (reaches, f"motion/{command}/adds-up", f"motion/{command}/many")
    )
    yield S(f"{section}/type", "The increment is signed, of four bytes, low byte first.", (ranges,))
    yield S(f"{section}/unit", f"One unit{of} is 0.01 degrees: 36000 are a turn.", (reaches,))
    yield S(f"{section}/direction", "The sign of the increment is the direction.", (reaches, ranges))


def _max_speed(section: str, command: str) -> Iterator[S]:
    """Yield what is said of the speed that a move is limited to."""
    own = f"motion/{command}/max-speed"
    kept = (own, f"motion/{command}/crossed-speed", f"motion/{command}/newer-speed")
    yield S(f"{section}/max-speed", "It turns no faster than max_speed.", kept)
    wide = () if command == "move_single_turn_limited" else (f"motion/{command}/beyond-16-bits",)
    yield S(f"{section}/max-speed-type", "max_speed is unsigned, of four bytes.", (f"ranges/{command}/max_speed/*", *wide))
    yield S(f"{section}/max-speed-unit", "One unit of max_speed is 0.01 deg/s.", (own,))


#: Number and name of each parameter, and what it has.
_PARAMETERS = (
    (10, "angle_pid", "kp, ki and kd of the angle loop, unsigned, of two bytes each"),
    (11, "speed_pid", "kp, ki and kd of the speed loop, unsigned, of two bytes each"),
    (12, "current_pid", "kp, ki and kd of the current loop, unsigned, of two bytes each"),
    (30, "torque_limit", "the highest torque current, signed, in bytes 3 and 4"),
    (32, "speed_limit", "the highest speed, signed, in bytes 3 to 6"),
    (34, "angle_limit", "the limit of the angle, signed, in bytes 3 to 6"),
    (36, "current_ramp", "the ramp of the current, signed, in bytes 3 to 6"),
    (38, "speed_ramp", "the ramp of the speed, signed, in bytes 3 to 6"),
)

STATEMENTS: tuple[S, ...] = (
    # --- the pages before the first command ---
    S("RS485 bus parameters/bus", "The bus is RS485.", unclaimed="wiring: a drive on another bus answers nothing at all"),
    S("RS485 bus parameters/rates", "Single motors work at ten rates from 9600 to 4000000 baud.",
        unclaimed="no command sets the rate: a run is at the one rate of its port"),
    S("RS485 bus parameters/default-rate", "115200 baud is the rate of a new drive.",
        unclaimed="what the rate was when the drive was new cannot be seen"),
    S("RS485 bus parameters/broadcast-rates", "Commands to several motors work at 1, 2 and 4 Mbaud.",
        unclaimed="no command to several motors is described"),
    S("RS485 bus parameters/characters", "Characters have 8 data bits, no parity and 1 stop bit.",
        ("shape/read_state_1/answered", "shape/read_state_1/head_checksum", "resilience/reads/good")),
    S("Single motor command/several-drives", "Several drives share a bus, each with an address of its own from 1 to 32.",
        ("addressing/other/every", "addressing/other/edges", "addressing/other/zero", "addressing/foreign_reply/ignored")),
    S("Single motor command/own-address", "The motor that is addressed executes a command, and no other does.",
        ("addressing/other/neighbours", "addressing/other/one_bit", "addressing/other/not_executed", "addressing/other/m*",
         "addressing/other/run_*")),
    S("Single motor command/executes-then-answers", "A motor that has heard a command answers it, once.",
        ("shape/*/answered", "shape/*/once", "timing/replies/every-time", "traffic/answered")),
    S("Single motor command/delay", "The reply comes 0.25 ms after the request.",
        unclaimed="observed by timing/replies/delay: from which byte it counts, and whether it is a limit, is not printed"),
    S("Single motor command/same-address", "The reply has the address of the request.", ("shape/*/address",)),
    S("Single motor command/frame",
        "A frame is a head of 5 bytes and, in some commands, data behind it, to which a sum belongs.",
        ("shape/*/length", "shape/*/clean", "framing/truncated/ignored")),
    S("Single motor command/head", "A frame begins with 3E.", ("shape/*/head", "framing/head/ignored")),
    S("Single motor command/code", "The second byte is the code of the command.",
        ("shape/*/code", "framing/unknown_code/ignored")),
    S("Single motor command/address", "The third byte is the motor's address, 1 to 32.",
        ("shape/*/address", "addressing/other/*")),
    S("Single motor command/length", "The fourth byte counts the data, and each command has its own length.",
        ("shape/*/length", "framing/overlong/ignored", "framing/underlong/ignored")),
    S("Single motor command/head-sum", "The fifth byte is the low byte of the sum of the four before it.",
        ("shape/*/head_checksum", "framing/checksum_bit/ignored", "framing/checksum_value/ignored",
         "framing/flipped_bit/ignored")),
    S("Single motor command/head-sum-guards", "A command whose head sum is wrong is not executed.",
        ("framing/*/guarded", "framing/reads/guarded", "framing/checksum_bit/not_executed")),
    S("Single motor command/data", "Up to 100 bytes of data follow the head.",
        unclaimed="no command has more than 12 bytes of data"),
    S("Single motor command/any-data", "The length alone says where data end: a byte of data that reads as a head is data.",
        ("framing/start_bytes", "addressing/foreign_reply/inside")),
    S("Single motor command/data-sum",
        "Where there are data, a last byte is the low byte of their sum; without data there is none.",
        ("shape/*/data_checksum", "shape/*/length", "motion/move_multi_turn_limited/sums")),
    S("Single motor command/data-sum-guards", "A command whose data sum is wrong is not executed.",
        ("framing/*/guarded", "framing/checksum_bit/not_executed", "framing/flipped_bit/not_executed")),
    S("Single motor command/answers-any-time", "Each sound command is answered, after any bytes and any pause.",
        ("framing/*/next", "resilience/*/next", "resilience/noise/*", "resilience/idle/*")),
    # --- 1: state 1 and error flags ---
    *_tables("1", "read_state_1", "9Ah", 0, 7),
    S("1/reads", "It reads and changes nothing.", ("resilience/reads/run_speed", "resilience/reads/steady")),
    S("1/temperature", "Byte 0 is the motor's temperature, signed, in degC.", ("motion/*/follows-temperature",)),
    S("1/voltage", "Bytes 1 and 2 are the supply voltage in 0.01 V, low byte first.",
        ("motion/read_state_1/voltage", "motion/read_state_1/plausible")),
    S("1/current", "Bytes 3 and 4 are the supply current, signed, in 0.01 A, low byte first.",
        ("motion/read_state_1/current-at-rest",)),
    S("1/load", "The supply current is that of a motor under load too.",
        unclaimed="how much current a load takes is not printed; nothing loads the motors here"),
    S("1/state-byte", "Byte 5 is the motor state.", ("shape/read_state_1/values", "motion/motor_off/is-read")),
    S("1/state-on", "State 00h is a motor that is on.", ("motion/motor_off/is-read", "motion/stop/stays-on")),
    S("1/state-off", "State 10h is a motor that is off.", ("motion/motor_off/is-read",)),
    S("1/error-byte", "Byte 6 has the error flags; 0 is normal.", ("motion/read_state_1/flag-*",)),
    S("1/low-voltage", "Bit 0 is the protection against a low voltage.", ("motion/read_state_1/flag-low_voltage",)),
    S("1/high-voltage", "Bit 1 is the protection against a high voltage.", ("motion/read_state_1/flag-high_voltage",)),
    S("1/drive-hot", "Bit 2 is a drive that is too hot.", ("motion/read_state_1/flag-drive_hot",)),
    S("1/motor-hot", "Bit 3 is a motor that is too hot.", ("motion/read_state_1/flag-motor_hot",)),
    S("1/overcurrent", "Bit 4 is a motor current that is too high.", ("motion/read_state_1/flag-overcurrent",)),
    S("1/short-circuit", "Bit 5 is a short circuit of the motor.", ("motion/read_state_1/flag-short_circuit",)),
    S("1/stalled", "Bit 6 is a motor that is stalled.", ("motion/read_state_1/flag-stalled",)),
    S("1/input-lost", "Bit 7 is an input signal that was lost too long.", ("motion/read_state_1/flag-input_lost",)),
    # --- 2: clearing errors ---
    *_tables("2", "clear_errors", "9Bh", 0, 7),
    S("2/clears", "It clears the error flags.", ("motion/clear_errors/clears*", "motion/read_state_1/flag-*")),
    S("2/alone", "Clearing is what this command is for.",
        unclaimed="observed by motion/clear_errors/alone-not-*: whether others clear too is not said"),
    S("2/same-reply", "The reply tells what 9A tells.", ("motion/clear_errors/tells-state",)),
    S("2/cause-lasts", "A flag whose cause lasts is not cleared.", ("motion/clear_errors/keeps",)),
    # --- 3: state 2 ---
    *_tables("3", "read_state_2", "9Ch", 0, 7),
    S("3/temperature", "Byte 0 is the motor's temperature, signed, in degC.", ("motion/read_state_2/temperature",)),
    S("3/torque-current", "Bytes 1 and 2 are the torque current of MF and MG, signed.",
        ("motion/read_state_2/crossed", "motion/run_torque/crossed-tells", "motion/read_state_2/torque-sign")),
    S("3/power", "On MS bytes 1 and 2 are the output power, signed.",
        ("motion/read_state_2/crossed", "motion/run_open_loop/crossed-tells")),
    S("3/mg-resolution", "One unit of torque current is 66/4096 A on MG.", unclaimed=_SCALE),
    S("3/mf-resolution", "One unit of torque current is 33/4096 A on MF.", unclaimed=_SCALE),
    S("3/power-range", "Power is read within -1000 and 1000.", ("shape/read_state_2/values", "traffic/reply_ranges")),
    S("3/speed", "Bytes 3 and 4 are the speed, signed, in deg/s, low byte first.",
        ("motion/read_state_2/crossed", "motion/read_state_2/fast")),
    S("3/encoder", "Bytes 5 and 6 are the encoder, low byte first.", ("motion/read_state_2/encoder",)),
    S("3/encoder-range", "The encoder is read within its 14, 15 or 16 bits.",
        ("motion/read_state_2/encoder", "motion/read_encoder/difference")),
    # --- 4: state 3 ---
    *_tables("4", "read_state_3", "9Dh", 0, 7),
    S("4/not-on-ms", "MS motors measure no phase currents, so that it has no effect on them.",
        unclaimed="silence and a reply both fit"),
    S("4/temperature", "Byte 0 is the motor's temperature, signed, in degC.", ("motion/read_state_3/temperature",)),
    S("4/phases", "Bytes 1 to 6 are the currents of phases A, B and C, signed, low byte first.",
        ("motion/read_state_3/crossed",)),
    S("4/mg-resolution", "One unit of phase current is 66/4096 A on MG.", unclaimed=_SCALE),
    S("4/mf-resolution", "One unit of phase current is 33/4096 A on MF.", unclaimed=_SCALE),
    # --- 5 and 6: off and on ---
    *_tables("5", "motor_off", "80h", 0, 0),
    S("5/switches-off", "It switches the motor off.", ("motion/motor_off/is-read", "motion/*/while-off")),
    S("5/ends-motion", "A motor that is switched off performs no action any more.",
        ("motion/motor_off/ends-motion", "motion/*/crossed-stopped")),
    S("5/on-at-power-up", "A motor is on when power comes.", ("motion/motor_on/at-power-up",)),
    S("5/light", "The light flashes slowly while the motor is off.", unclaimed=_LIGHT),
    S("5/answers", "A motor that is off answers commands.", ("motion/*/while-off", "resilience/reads/off")),
    S("5/performs-nothing", "A motor that is off performs no motion command.", ("motion/*/while-off", "state/walk/*")),
    *_tables("6", "motor_on", "88h", 0, 0),
    S("6/switches-on", "It switches the motor on.", ("motion/motor_off/is-read", "motion/motor_on/obeys")),
    S("6/light", "The light is steady while the motor is on.", unclaimed=_LIGHT),
    S("6/obeys", "A motor that is on obeys commands.", ("motion/motor_on/obeys", "state/walk/*")),
    S("6/waits", "Switching on moves nothing: a command must come first.",
        ("motion/motor_on/does-not-resume", "motion/*/crossed-stopped", "motion/*/while-off")),
    # --- 7: stop ---
    *_tables("7", "stop", "81h", 0, 0),
    S("7/stops", "It stops the motor.", ("motion/stop/stops", "motion/stop/ends-a-move", "motion/*/crossed-stopped")),
    S("7/stays-on", "It leaves the motor on.", ("motion/stop/stays-on", "motion/*/crossed-stopped")),
    S("7/next-command", "The next motion command moves the motor again.", ("motion/stop/stays-on", "motion/*/crossed-ends")),
    # --- 8: brake ---
    *_tables("8", "brake", "8Ch", 1, 1),
    S("8/power-off", "00h takes the brake's power away, and the brake holds.", ("motion/brake/holds*", "motion/brake/is-read")),
    S("8/release", "01h powers the brake, and it lets go.", ("motion/brake/holds", "motion/brake/is-read")),
    S("8/stays", "It alone switches the brake: no motion releases it.", ("motion/brake/stays-applied",)),
    S("8/read", "10h reads the brake and leaves it as it is.", ("motion/brake/read-only", "motion/brake/is-read")),
    S("8/unlisted", "Other values are none of its commands.", ("ranges/brake/brake_control/unlisted",)),
    S("8/state", "The reply is 00h where the brake holds, 01h where it is released.", ("motion/brake/is-read",)),
    S("8/new-state", "A reply to a switching tells the state.",
        unclaimed="observed by motion/brake/answers-new: before or after is not said"),
    # --- 9: open loop ---
    *_tables("9", "run_open_loop", "A0h", 2, 7),
    S("9/only-ms", "MS motors alone have it.", ("motion/run_open_loop/other-models", "ranges/models")),
    S("9/drives", "It drives the motor by a voltage.", ("motion/run_open_loop/crossed-ends", "motion/run_open_loop/zero")),
    S("9/type", "Power is signed, low byte first.", ("motion/run_open_loop/crossed-ends", "motion/read_state_2/crossed")),
    S("9/range", "Power is -850 to 850.", ("ranges/run_open_loop/power/*",)),
    S("9/differs", "Its current and torque differ from motor to motor.", unclaimed="nothing is said of how much"),
    _tells_state("9", "run_open_loop"),
    # --- 10: torque ---
    *_tables("10", "run_torque", "A1h", 2, 7),
    S("10/only-others", "MF, MH and MG motors alone have it.", ("motion/run_torque/other-models", "ranges/models")),
    S("10/drives", "It sets the torque current of the motor.",
        ("motion/run_torque/crossed-ends", "motion/read_state_2/crossed")),
    S("10/type", "Torque current is signed, low byte first.",
        ("motion/run_torque/crossed-ends", "motion/read_state_2/crossed")),
    S("10/range", "Torque current is -2048 to 2048.", ("ranges/run_torque/torque_current/*", "motion/run_torque/to-its-end")),
    S("10/mf-amperes", "The range is 16.5 A either way on MF.", unclaimed=_SCALE),
    S("10/mg-amperes", "The range is 33 A either way on MG.", unclaimed=_SCALE),
    S("10/differs", "Supply current and torque differ from motor to motor.", unclaimed="nothing is said of how much"),
    _tells_state("10", "run_torque"),
    # --- 11: speed ---
    *_tables("11", "run_speed", "A2h", 4, 7),
    S("11/runs", "It runs the motor at a speed.",
        ("motion/run_speed/speed-*", "motion/run_speed/lasts", "motion/run_speed/changes")),
    S("11/type", "Speed is signed, of four bytes, low byte first.", ("motion/run_speed/opposite", "ranges/run_speed/speed/*")),
    S("11/unit", "One unit of speed is 0.01 deg/s.", ("motion/run_speed/speed-*",)),
    *_limited("11", "Max Speed",
         "Max Acceleration", "Max Torque Current", max_speed=("motion/write_parameter/speed-limit-run_speed-each-way",),
         max_acceleration=("timing/write_parameter/one-ramp", "timing/write_parameter/speed-ramp-run_speed-each-way"),
         max_torque_current=("motion/write_parameter/torque-limit-*",)),
    _tells_state("11", "run_speed"),
    # --- 12 and 13: positions over all turns ---
    *_tables("12", "move_multi_turn", "A3h", 8, 7),
    *_to_a_position("12", "move_multi_turn", "", "motion/set_position/and-moves"),
    *_limited("12", "Max Angle",
         "Max Speed", "Max Acceleration", "Max Torque Current",
         max_angle=("motion/write_parameter/angle-limit-move_multi_turn-each-way",),
         max_speed=("motion/write_parameter/speed-limit-move_multi_turn-each-way",),
         max_acceleration=("timing/write_parameter/speed-ramp-move_multi_turn-each-way",),
         max_torque_current=("motion/write_parameter/torque-limit-move_multi_turn",)),
    _tells_state("12", "move_multi_turn"),
    *_tables("13", "move_multi_turn_limited", "A4h", 12, 7),
    *_to_a_position("13", "move_multi_turn_limited", " of position"),
    *_max_speed("13", "move_multi_turn_limited"),
    *_limited("13", "Max Angle",
         "Max Acceleration", "Max Torque Current",
         max_angle=("motion/write_parameter/angle-limit-move_multi_turn_limited-each-way",),
         max_acceleration=("timing/write_parameter/speed-ramp-move_multi_turn_limited-each-way",),
         max_torque_current=("motion/write_parameter/torque-limit-move_multi_turn_limited",)),
    _tells_state("13", "move_multi_turn_limited"),
    # --- 14 and 15: angles within the turn ---
    *_tables("14", "move_single_turn", "A5h", 4, 7),
    *_within_the_turn("14", "move_single_turn", "last", "", "ranges/move_single_turn/angle/highest"),
    *_limited("14", "Max Speed",
         "Max Acceleration", "Max Torque Current", max_speed=("motion/write_parameter/speed-limit-move_single_turn-each-way",),
         max_torque_current=("motion/write_parameter/torque-limit-move_single_turn",)),
    _tells_state("14", "move_single_turn"),
    *_tables("15", "move_single_turn_limited", "A6h", 8, 7),
    *_within_the_turn("15", "move_single_turn_limited", "fourth", " of angle"),
    *_max_speed("15", "move_single_turn_limited"),
    *_limited("15", "Max Acceleration",
         "Max Torque Current", max_torque_current=("motion/write_parameter/torque-limit-move_single_turn_limited",)),
    _tells_state("15", "move_single_turn_limited"),
    # --- 16 and 17: increments ---
    *_tables("16", "move_increment", "A7h", 4, 7),
    *_by_an_increment("16", "move_increment", ""),
    *_limited("16", "Max Speed",
         "Max Acceleration", "Max Torque Current", max_speed=("motion/write_parameter/speed-limit-move_increment-each-way",),
         max_acceleration=("timing/write_parameter/speed-ramp-move_increment-each-way",),
         max_torque_current=("motion/write_parameter/torque-limit-move_increment",)),
    _tells_state("16", "move_increment"),
    *_tables("17", "move_increment_limited", "A8h", 8, 7),
    *_by_an_increment("17", "move_increment_limited", " of the increment"),
    *_max_speed("17", "move_increment_limited"),
    *_limited("17", "Max Acceleration",
         "Max Torque Current", max_acceleration=("timing/write_parameter/speed-ramp-move_increment_limited-each-way",),
         max_torque_current=("motion/write_parameter/torque-limit-move_increment_limited",)),
    _tells_state("17", "move_increment_limited"),
    # --- 18 and 19: control parameters ---
    *_tables("18", "read_parameter", "C0h", 7, 7),
    S("18/number", "The first byte says which parameter is read.", ("shape/read_parameter/of/*", "shape/read_parameter/echo")),
    S("18/values", "The reply has the number and the values of that parameter.",
        ("shape/read_parameter/of/*", "read-back/parameter/*/written")),
    S("18/reads", "It reads and changes nothing.", ("resilience/settings/*", "resilience/reads/run_speed")),
    *_tables("19", "write_parameter", "C1h", 7, 7),
    S("19/writes", "It writes the values of the parameter whose number it has.",
        ("read-back/parameter/*/written", "state/walk/*")),
    S("19/others", "It writes no other parameter.", ("resilience/settings/*", "ranges/write_parameter/parameter/unlisted")),
    S("19/at-once", "It takes effect at once.",
        ("motion/write_parameter/speed-limit-*at-once", "motion/write_parameter/torque-limit-at-once-*",
         "timing/write_parameter/speed-ramp-at-once", "timing/write_parameter/speed-ramp-under-way-*")),
    S("19/power", "What it wrote is gone when power was off.", ("read-back/parameter/*/power",)),
    S("19/values", "The reply has the values after writing.", ("read-back/parameter/*/written",)),
    # --- 20: encoder ---
    *_tables("20", "read_encoder", "90h", 0, 6),
    S("20/encoder", "The first value is the encoder: its raw value less the zero offset.",
        ("motion/read_encoder/difference", "motion/read_encoder/below-offset")),
    S("20/raw", "The second value is the raw value.", ("motion/read_encoder/follows", "motion/set_zero/fits-behind")),
    S("20/offset", "The third value is the offset of the zero.", ("motion/read_encoder/difference", "motion/set_zero/offset")),
    S("20/initial-zero", "That offset is the zero from power-up.", ("motion/set_zero/offset",)),
    S("20/ranges", "A value has 14, 15 or 16 bits; of 18 bits the upper 16 are sent.", ("motion/read_encoder/*",)),
    # --- 21: zero ---
    *_tables("21", "set_zero", "19h", 0, 2),
    S("21/zero", "The raw value where the shaft stands becomes the zero from power-up.", ("motion/set_zero/at-power-up",)),
    S("21/not-at-once", "The zero is that of the next power-up.", ("motion/set_zero/not-at-once",)),
    S("21/kept", "The zero is kept without power.", ("motion/set_zero/at-power-up",)),
    S("21/wear", "Each use wears the flash.", unclaimed="the wear of a chip is not seen by a few writes"),
    S("21/raw", "The reply tells the raw value where the shaft stands, low byte first.",
        ("motion/set_zero/fits-behind", "motion/set_zero/answers-raw")),
    # --- 22 to 25: positions ---
    *_tables("22", "read_position", "92h", 0, 8),
    S("22/position", "It reads the position over all turns, signed, of eight bytes, low byte first.",
        ("motion/set_position/counts-on", "ranges/set_position/position/*")),
    S("22/clockwise", "A positive position is clockwise.",
        ("motion/move_single_turn/clockwise", "motion/read_encoder/follows")),
    S("22/unit", "One unit is 0.01 degrees.", ("motion/read_single_turn/is-position", "motion/read_encoder/follows")),
    *_tables("23", "clear_turns", "93h", 0, 0),
    S("23/clears", "It clears what was counted of turns.",
        ("motion/clear_turns/drops-turns", "motion/clear_turns/while-turning")),
    S("23/angle", "It drops turns: the angle within the turn stays.", ("motion/clear_turns/keeps-angle",)),
    S("23/turns-nothing", "It clears information, and moves nothing.", ("motion/clear_turns/stands",)),
    *_tables("24", "read_single_turn", "94h", 0, 4),
    S("24/zero", "The angle counts from the zero of the encoder.",
        ("motion/set_zero/at-power-up", "motion/read_single_turn/is-encoder")),
    S("24/clockwise", "The angle rises clockwise.", ("motion/read_single_turn/is-position",)),
    S("24/wraps", "At the zero the angle is 0 again.",
        ("motion/read_single_turn/within-turn", "motion/read_single_turn/is-position")),
    S("24/range", "The angle is 0 to 35999, of four bytes, low byte first.",
        ("shape/read_single_turn/values", "motion/read_single_turn/within-turn")),
    S("24/unit", "One unit is 0.01 degrees.", ("motion/read_single_turn/is-position",)),
    *_tables("25", "set_position", "95h", 4, 4),
    S("25/sets", "It calls the present position any angle over all turns.",
        ("ranges/set_position/position/*", "motion/set_position/and-moves")),
    S("25/turns-nothing", "It gives a name, and moves nothing.", ("motion/set_position/stands",)),
    S("25/under-way", "A motion under way goes on.",
        unclaimed="observed by motion/set_position/under-way: what 95h does to its end is not said"),
    S("25/ram", "The name is gone when power was off.", ("motion/set_position/lost",)),
    S("25/type", "The angle is signed, of four bytes, low byte first.", ("ranges/set_position/position/*",)),
    S("25/unit", "One unit is 0.01 degrees.", ("motion/set_position/to-the-digit", "motion/set_position/counts-on")),
    S("25/echo", "The reply has the angle that was sent.", ("shape/set_position/echo",)),
    # --- appendix 1 ---
    *(
        S(f"appendix 1/{name}", f"Parameter {number} has {what}.", claims)
        for number, name, what in _PARAMETERS
        for claims in [(f"shape/read_parameter/of/{name}", f"read-back/parameter/{name}/written")]
    ),
    S("appendix 1/loops", "Kp, ki and kd are gains of the loops.", unclaimed="what a gain does to a shaft is not printed"),
    S("appendix 1/limits", "The limits limit torque, speed and angle.",
        ("motion/write_parameter/speed-limit-*-each-way", "motion/write_parameter/speed-limit-*at-once",
         "motion/write_parameter/angle-limit-*-each-way", "motion/write_parameter/torque-limit-*")),
    S("appendix 1/ramps", "The ramps are slopes of current and speed.",
        ("timing/write_parameter/one-ramp", "timing/write_parameter/one-slope-*",
         "timing/write_parameter/speed-ramp-*-each-way", "timing/write_parameter/speed-ramp-at-once",
         "timing/write_parameter/speed-ramp-under-way-*")),
)  # fmt: skip
