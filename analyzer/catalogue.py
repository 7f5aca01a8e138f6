"""Commands, dialects, worked examples and errata: the manuals as data.

A `Command` holds what the manual says about one command: code, layouts of requests and replies, meanings of statuses, work
modes, risk and printed frames. A `Dialect` is one manual's commands on one link. Nothing here does I/O or knows a
particular drive.

Forms: a command has one or more forms, and the first that matches wins. A form matches if the data's length fits its
layout and all `fixed` fields have their value. It may also name the `models` that have it, or need an open request of the
command (`needs_request`). So these cases need no special code: two commands of one code (run and stop), a parameter table
behind one code, replies with another command's code, and models that answer differently.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from importlib import import_module

from analyzer.layout import ANSWERING, Effect, Field, Layout
from analyzer.link import Link
from analyzer.link import Role as Role


class Risk(StrEnum):
    """What a command may do to a machine; a command and its values have a set of these."""

    READ = "read"
    SETTING = "setting"
    MOTION = "motion"
    UNBOUNDED = "unbounded"
    TORQUE = "torque"
    POWER_ON = "power-on"
    LINK = "link"
    WEAR = "wear"
    DESTRUCTIVE = "destructive"
    UNKNOWN = "unknown"


class Certainty(StrEnum):
    """How sure a reading of the manual is."""

    CERTAIN = "certain"
    LIKELY = "likely"
    OPEN = "open"


class Damage(StrEnum):
    """Where a wrong print comes from: the manual's authors, or the scan its text was read from."""

    MANUAL = "manual"
    SCAN = "scan"


class Doubt(StrEnum):
    """What an erratum leaves in doubt about a command, a field or a whole dialect.

    `effect`: what a setting does. `meaning`: what a value or a stored parameter stands for. `values`: which are allowed.
    `limits`: what happens beyond them. `layout`: which bytes there are. `example`: what a printed frame is answered with.
    `sequence`: how commands act on one another.
    """

    ADDRESSING = "addressing"
    CHECK = "check"
    CHECK_OF_ADDRESS = "check_of_address"
    DELAY = "delay"
    ECHO = "echo"
    EFFECT = "effect"
    EXAMPLE = "example"
    LAYOUT = "layout"
    LIMITS = "limits"
    MEANING = "meaning"
    REFUSAL = "refusal"
    REPLY_COUNT = "reply_count"
    REPLY_VALUES = "reply_values"
    RESERVED = "reserved"
    SEQUENCE = "sequence"
    SIGN = "sign"
    VALUES = "values"


class Verb(StrEnum):
    """What a command does, the same word in every dialect."""

    READ_ENCODER_CARRY = "read_encoder_carry"
    READ_POSITION = "read_position"
    READ_ENCODER = "read_encoder"
    READ_SINGLE_TURN = "read_single_turn"
    READ_SPEED = "read_speed"
    READ_PULSES = "read_pulses"
    READ_IO = "read_io"
    WRITE_IO = "write_io"
    READ_ANGLE_ERROR = "read_angle_error"
    READ_ENABLED = "read_enabled"
    READ_ZERO_STATUS = "read_zero_status"
    READ_PROTECTION = "read_protection"
    READ_STATUS = "read_status"
    READ_STATE_1 = "read_state_1"
    READ_STATE_2 = "read_state_2"
    READ_STATE_3 = "read_state_3"
    READ_PARAMETER = "read_parameter"
    READ_VERSION = "read_version"
    READ_USER_ID = "read_user_id"
    RELEASE_PROTECTION = "release_protection"
    CLEAR_ERRORS = "clear_errors"
    CALIBRATE = "calibrate"
    RESTORE = "restore"
    RESTART = "restart"
    ENABLE = "enable"
    MOTOR_ON = "motor_on"
    MOTOR_OFF = "motor_off"
    STOP = "stop"
    EMERGENCY_STOP = "emergency_stop"
    BRAKE = "brake"
    HOME = "home"
    SET_ZERO = "set_zero"
    CLEAR_TURNS = "clear_turns"
    RUN_SPEED = "run_speed"
    STOP_SPEED = "stop_speed"
    SAVE_SPEED = "save_speed"
    RUN_TORQUE = "run_torque"
    RUN_OPEN_LOOP = "run_open_loop"
    MOVE_RELATIVE_PULSES = "move_relative_pulses"
    STOP_RELATIVE_PULSES = "stop_relative_pulses"
    MOVE_ABSOLUTE_PULSES = "move_absolute_pulses"
    STOP_ABSOLUTE_PULSES = "stop_absolute_pulses"
    MOVE_RELATIVE_AXIS = "move_relative_axis"
    STOP_RELATIVE_AXIS = "stop_relative_axis"
    MOVE_ABSOLUTE_AXIS = "move_absolute_axis"
    STOP_ABSOLUTE_AXIS = "stop_absolute_axis"
    MOVE_SINGLE_TURN = "move_single_turn"
    LONG_PACKAGE = "long_package"
    SET_WORK_MODE = "set_work_mode"
    SET_CURRENT = "set_current"
    SET_HOLDING_CURRENT = "set_holding_current"
    SET_SUBDIVISION = "set_subdivision"
    SET_ENABLE_LEVEL = "set_enable_level"
    SET_DIRECTION = "set_direction"
    SET_SCREEN_OFF = "set_screen_off"
    SET_PULSE_DELAY = "set_pulse_delay"
    SET_PROTECTION = "set_protection"
    SET_STALL_TOLERANCE = "set_stall_tolerance"
    SET_INTERPOLATION = "set_interpolation"
    SET_BAUD_RATE = "set_baud_rate"
    SET_BIT_RATE = "set_bit_rate"
    SET_ADDRESS = "set_address"
    SET_RESPOND = "set_respond"
    SET_MODBUS = "set_modbus"
    SET_KEY_LOCK = "set_key_lock"
    SET_AXIS_LOCK = "set_axis_lock"
    SET_GROUP_ADDRESS = "set_group_address"
    SET_HOME = "set_home"
    SET_NO_LIMIT_HOME = "set_no_limit_home"
    SET_NO_LIMIT_CURRENT = "set_no_limit_current"
    SET_LIMIT_REMAP = "set_limit_remap"
    SET_ZERO_MODE = "set_zero_mode"
    SET_PULSE_DIVISION = "set_pulse_division"
    WRITE_PARAMETER = "write_parameter"
    WRITE_USER_ID = "write_user_id"
    OTHER = "other"


@dataclass(frozen=True, slots=True)
class Form:
    """One shape of a command's data.

    `code`: the code on the wire where it is not the command's own (a reply that carries the code of the parameter it
    answers). `needs_request`: this is a reply only while a request of this command is open; `request_values` are values
    (as sent) that this open request must have. `after_request`: its layout begins with the data of this request, which
    alone say what the reply's own data are.
    """

    layout: Layout
    name: str = ""
    code: int | None = None
    models: tuple[str, ...] = ()
    needs_request: bool = False
    after_request: bool = False
    request_values: Mapping[str, int] | None = None


@dataclass(frozen=True, slots=True)
class Replies:
    """What a reply means by the value of its status field, or by the name of its form.

    A command without statuses is finished by any reply. `interim`: it goes on; `final`: done; `failed`: refused or
    gone wrong. A status in none of these sets is outside the manual's list.
    """

    interim: frozenset[int] = frozenset()
    final: frozenset[int] = frozenset()
    failed: frozenset[int] = frozenset()
    status: str = "status"
    failed_forms: frozenset[str] = frozenset()

    def __init__(
        self,
        interim: set[int] | frozenset[int] = frozenset(),
        final: set[int] | frozenset[int] = frozenset(),
        failed: set[int] | frozenset[int] = frozenset(),
        status: str = "status",
        failed_forms: set[str] | frozenset[str] = frozenset(),
    ) -> None:
        object.__setattr__(self, "interim", frozenset(interim))
        object.__setattr__(self, "final", frozenset(final))
        object.__setattr__(self, "failed", frozenset(failed))
        object.__setattr__(self, "status", status)
        object.__setattr__(self, "failed_forms", frozenset(failed_forms))


@dataclass(frozen=True, slots=True)
class RiskRule:
    """These risks hold when field `field` (integer as sent) lies in `low`..`high`; without a field, always."""

    risks: frozenset[Risk]
    field: str = ""
    low: int = 0
    high: int = 0

    def applies(self, values: Mapping[str, int]) -> bool:
        """Say whether the rule holds for these values as sent; a missing value counts as the worst case."""
        if not self.field or self.field not in values:
            return True
        return self.low <= values[self.field] <= self.high


def always(*risks: Risk) -> RiskRule:
    """Declare risks that every use of a command has."""
    return RiskRule(frozenset(risks))


def when(field: str, low: int, high: int | None, *risks: Risk) -> RiskRule:
    """Declare risks of a command while `field` is within `low`..`high` (high None: equal to low)."""
    return RiskRule(frozenset(risks), field, low, low if high is None else high)


class MotionKind(StrEnum):
    """How a command moves the shaft.

    `run`: at a speed, without an end. `move_by`: by a distance. `move_to`: to a place counted over all turns.
    `move_in_turn`: to an angle within one turn. `torque`: with a force, without an end. `home`, `calibrate`: by the drive's
    own rules. `hold`: the motor takes hold of the shaft and covers no distance of its own. `stop`: ends motion.
    """

    RUN = "run"
    MOVE_BY = "move_by"
    MOVE_TO = "move_to"
    MOVE_IN_TURN = "move_in_turn"
    TORQUE = "torque"
    HOME = "home"
    CALIBRATE = "calibrate"
    HOLD = "hold"
    STOP = "stop"


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """What a command does to the shaft, by the names of its request's fields; the unit of each is that of its field.

    `distance`: the length of a move, or the place it goes to. `direction`: 0 raises the position. `tells_end`: a second
    reply says that the motion is done. `stops`: the commands that end it, the gentlest first. `counted_by`: the read whose
    value has the origin and unit of a place.
    """

    kind: MotionKind
    speed: str = ""
    distance: str = ""
    direction: str = ""
    acceleration: str = ""
    tells_end: bool = False
    stops: tuple[str, ...] = ()
    counted_by: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ramp:
    """The law of a ramp: at acceleration a, 1 up to `steps` - 1, one rpm takes (`steps` - a) x `unit_ns`; 0 is at once."""

    unit_ns: int
    steps: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Subdivision:
    """What a subdivision does to pulses and speeds.

    A turn has `full_steps` x subdivision pulses. The shaft turns at the speed as sent where the subdivision is in `plain`, and
    elsewhere at speed x `counted_at` / subdivision. `largest`: what 0 stands for.
    """

    full_steps: int
    counted_at: int
    plain: frozenset[int]
    largest: int


class Trait(StrEnum):
    """A way in which drives of one family differ by dialect."""

    LETS_GO_AT_END_LIMIT = "lets_go_at_end_limit"
    DIRECTION_TURNS_BUS_MOTION = "direction_turns_bus_motion"
    BACKS_OFF_BY_ANGLE = "backs_off_by_angle"
    SEEN_WITHOUT_CHECKSUM = "seen_without_checksum"


class Subject(StrEnum):
    """A subject that a manual describes apart from its commands."""

    FRAMING = "framing"
    ADDRESSING = "addressing"
    SILENCE = "silence"


@dataclass(frozen=True, slots=True)
class Vector:
    """A frame as the manual prints it (or, where it prints none, as computed from its rules).

    `printed`: hex text of the bytes that are printed; CAN: identifier, then data. `checksum` False: the manual leaves
    the checksum out ("CRC" or nothing in its place). `values`: each field by name, integers as sent, of the whole data.
    `computed`: the manual prints none. `erratum`: the id of the erratum that says why the printed frame does not hold;
    `corrected` is then the frame that we take as true.
    """

    printed: str
    values: Mapping[str, int] = field(default_factory=dict)
    role: Role = Role.REQUEST
    section: str = ""
    checksum: bool = True
    computed: bool = False
    erratum: str = ""
    corrected: str = ""
    models: tuple[str, ...] = ()

    @property
    def data(self) -> bytes:
        """The printed bytes."""
        return bytes.fromhex(self.printed)

    def taken_on(self, bus: str) -> tuple[int | None, bytes]:
        """Return the frame that is taken as true: its identifier on CAN, else None, and its bytes."""
        text = self.corrected or self.printed
        if bus != "can":
            return None, bytes.fromhex(text)
        identifier, _, data = text.partition(" ")
        return int(identifier, 16), bytes.fromhex(data)


@dataclass(frozen=True, slots=True)
class Erratum:
    """A place where the manual contradicts itself, its arithmetic, a standard or its scan.

    `section`: one or several, with commas between them; a range is written `8.3.3 to 8.3.7`. `commands`: the names of
    commands that it is about without standing in their sections. `bears_on`: what it leaves in doubt, each with the names of
    the commands or fields for which; without any it is so for the whole dialect.
    """

    id: str
    section: str
    printed: str
    wrong: str
    taken_as: str
    why: str
    certainty: Certainty
    damage: Damage = Damage.MANUAL
    commands: tuple[str, ...] = ()
    bears_on: Mapping[Doubt, tuple[str, ...]] = field(default_factory=dict)

    def doubts(self, doubt: Doubt, names: Collection[str]) -> bool:
        """Say whether it leaves a thing in doubt about commands and fields of these names."""
        about = self.bears_on.get(doubt)
        return about is not None and (not about or any(name in about for name in names))


@dataclass(frozen=True, slots=True)
class Statement:
    """One thing that a manual says a drive does, in our words.

    `id`: its section and a few words, as in `5.1.3/speed-is-signed`. `claims`: patterns of ids of claims, without the dialect,
    that a drive which does otherwise refutes (`motion/read_speed/*`). `unclaimed`: why no claim can, where none does.
    """

    id: str
    says: str
    claims: tuple[str, ...] = ()
    unclaimed: str = ""

    def __post_init__(self) -> None:
        if bool(self.claims) == bool(self.unclaimed):
            raise ValueError(f"statement {self.id}: expected claims, or the reason why there is none")

    @property
    def section(self) -> str:
        """The section of the manual that says it."""
        return self.id.partition("/")[0]


@dataclass(frozen=True, slots=True)
class Slots:
    """The data of a package: `count` slots of `size` bytes, each an address, a code and that command's own data.

    A slot is filled up with zeros; a slot of zeros alone is unused.
    """

    count: int
    size: int


@dataclass(frozen=True)
class Command:
    """One command of one dialect.

    `code`: the function code; for Modbus the register, with `function` 0x04, 0x06 or 0x10. `request` and `reply`: a
    layout, or forms in the order in which they are tried; a reply of None means that the command is never answered.
    `modes`: the work modes it needs, by name; empty: any. `models`: the models that have it; empty: all. `silenced`:
    its replies are those that `respond = 0` silences. `readable`: its value can be read back by the dialect's
    parameter read. `slots`: the data is a package of requests to several drives. `motion`: what it does to the shaft; a
    command that risks motion without one moves in an unknown way.
    """

    name: str
    verb: Verb
    code: int
    section: str
    summary: str
    risk: tuple[RiskRule, ...]
    request: Layout | tuple[Form, ...]
    reply: Layout | tuple[Form, ...] | None
    replies: Replies = Replies()
    function: int | None = None
    quantity: int = 0
    answers_broadcast: bool = False
    answers_group: bool = False
    broadcastable: bool = True
    silenced: bool = False
    readable: bool = False
    modes: tuple[str, ...] = ()
    models: tuple[str, ...] = ()
    slots: Slots | None = None
    motion: Motion | None = None
    printed: str = ""
    notes: tuple[str, ...] = ()
    vectors: tuple[Vector, ...] = ()

    @cached_property
    def request_forms(self) -> tuple[Form, ...]:
        """The request's forms, each with a name."""
        return _forms(self.request, "request")

    @cached_property
    def reply_forms(self) -> tuple[Form, ...]:
        """The reply's forms, each with a name; empty where nothing is answered."""
        return _forms(self.reply, "reply")

    @cached_property
    def judged(self) -> bool:
        """Whether a reply can mean anything but that the command is done."""
        replies = self.replies
        return bool(replies.interim or replies.failed or replies.failed_forms)

    @cached_property
    def borrows(self) -> bool:
        """Whether a reply can carry another command's code."""
        return any(form.code is not None for form in self.reply_forms)

    @cached_property
    def moves(self) -> bool:
        """Whether the command can move the motor."""
        return bool(self.all_risks & {Risk.MOTION, Risk.UNBOUNDED})

    @cached_property
    def all_risks(self) -> frozenset[Risk]:
        """Every risk the command can have with any values."""
        return frozenset().union(*(rule.risks for rule in self.risk))

    def risks(self, values: Mapping[str, int]) -> frozenset[Risk]:
        """Return the risks of a request with these values as sent; a missing value counts as the worst case."""
        return frozenset().union(*(rule.risks for rule in self.risk if rule.applies(values)))

    @cached_property
    def effects(self) -> Mapping[Effect, str]:
        """What the request's fields change, each with the name of its field."""
        fields = all_fields(self.request_forms).values()
        return {f.effect: f.name for f in reversed(fields) if f.effect is not None}

    @cached_property
    def changes_answers(self) -> bool:
        """Whether the request changes who answers, or how."""
        return not ANSWERING.isdisjoint(self.effects)

    def sets(self, effect: Effect) -> str:
        """Return the name of the request's field that has an effect, or nothing."""
        return self.effects.get(effect, "")

    def for_model(self, model: str) -> Command:
        """Return this command as one model has it."""

        def keep(forms: tuple[Form, ...]) -> tuple[Form, ...]:
            return tuple(replace(f, layout=f.layout.for_model(model)) for f in forms if not f.models or model in f.models)

        return replace(self, request=keep(self.request_forms), reply=None if self.reply is None else keep(self.reply_forms))


def _forms(given: Layout | tuple[Form, ...] | None, name: str) -> tuple[Form, ...]:
    if given is None:
        return ()
    if isinstance(given, Layout):
        return (Form(given, name),)
    return tuple(f if f.name else replace(f, name=name) for f in given)


@dataclass(frozen=True)
class Dialect:
    """One manual's commands on one link.

    `addresses`: what one drive can be given (first, last); `broadcast`: the address of all, or None. `models`: names
    that `--model` takes. `baud_rates`: what the drive can be set to, the default first. `fallbacks`: for links with standard
    functions, the command that stands for an uncatalogued use of each; its own data begin after the function.
    `exception`: the form of a reply with an exception code, the same for every command.

    `family`: the make of drive, the same for all its dialects. `siblings`: the other dialects that the same drive can speak;
    `chosen_by`: the value of the field with `Effect.DIALECT` that makes it speak this one. `sections`: where the manual
    describes what belongs to no command. `ramp`, `subdivision`: None where the drive has none. `counts_per_turn`: of the
    encoder, 0 where it is not known. `mode_speeds`: the highest speed (rpm) of each work mode, by its name; a mode that is
    not listed has that of the command's field. `rates`: bits per second of each value of the field with
    `Effect.BAUD_RATE`. `unlisted_codes`: codes that drives were seen to answer without the manual
    listing them. `of_drives`: False where it describes other devices, by a file or by their functions alone. `said_in`: the
    module with the manual's statements (`STATEMENTS`), loaded when they are asked for.
    """

    name: str
    title: str
    manual: str
    bus: str
    link: Link
    commands: tuple[Command, ...]
    errata: tuple[Erratum, ...] = ()
    models: tuple[str, ...] = ()
    addresses: tuple[int, int] = (1, 255)
    broadcast: int | None = 0
    baud_rates: tuple[int, ...] = ()
    fallbacks: Mapping[int, Command] = field(default_factory=dict)
    exception: Form | None = None
    model: str = ""
    family: str = ""
    siblings: tuple[str, ...] = ()
    chosen_by: int = 0
    sections: Mapping[Subject, str] = field(default_factory=dict)
    traits: frozenset[Trait] = frozenset()
    ramp: Ramp | None = None
    subdivision: Subdivision | None = None
    counts_per_turn: int = 0
    mode_speeds: Mapping[str, int] = field(default_factory=dict)
    rates: Mapping[int, int] = field(default_factory=dict)
    unlisted_codes: tuple[int, ...] = ()
    of_drives: bool = True
    said_in: str = ""

    def __post_init__(self) -> None:
        names = [c.name for c in self.commands]
        if len(set(names)) != len(names):
            raise ValueError(f"{self.name}: two commands of one name")
        if any(c.sets(Effect.DIALECT) for c in self.commands) and not self.siblings:
            raise ValueError(f"{self.name}: a field chooses the dialect, and no sibling is named")

    def __repr__(self) -> str:
        """Return the name: the whole of a dialect fills pages."""
        return f"Dialect({self.name!r}{f', model={self.model!r}' if self.model else ''})"

    @cached_property
    def by_name(self) -> dict[str, Command]:
        """Commands by name."""
        return {c.name: c for c in self.commands}

    @cached_property
    def by_verb(self) -> dict[Verb, Command]:
        """Commands by what they do; the first of a verb wins."""
        return {c.verb: c for c in reversed(self.commands)}

    @cached_property
    def by_code(self) -> dict[int, tuple[Command, ...]]:
        """Commands by code, in the manual's order."""
        result: dict[int, tuple[Command, ...]] = {}
        for command in self.commands:
            result[command.code] = (*result.get(command.code, ()), command)
        return result

    @cached_property
    def statements(self) -> tuple[Statement, ...]:
        """What the manual says a drive does, in its order."""
        found: tuple[Statement, ...] = import_module(self.said_in).STATEMENTS if self.said_in else ()
        if len({s.id for s in found}) != len(found):
            raise ValueError(f"{self.said_in}: two statements of one id")
        return found

    def motions(self, *kinds: MotionKind) -> tuple[Command, ...]:
        """Return the commands whose motion is of one of these kinds, in the manual's order."""
        return tuple(c for c in self.commands if c.motion is not None and c.motion.kind in kinds)

    def stops_of(self, command: Command) -> tuple[Command, ...]:
        """Return the commands that end the motion of another, the gentlest first."""
        names = () if command.motion is None else command.motion.stops
        return tuple(self.by_name[name] for name in names if name in self.by_name)

    @cached_property
    def _effects(self) -> dict[Effect, tuple[tuple[Command, Field], ...]]:
        result: dict[Effect, tuple[tuple[Command, Field], ...]] = {}
        for command in self.commands:
            for declared in all_fields(command.request_forms).values():
                if declared.effect is not None:
                    result[declared.effect] = (*result.get(declared.effect, ()), (command, declared))
        return result

    def effects(self, effect: Effect) -> tuple[tuple[Command, Field], ...]:
        """Return every command with a field of this effect, and that field."""
        return self._effects.get(effect, ())

    def effect(self, effect: Effect) -> tuple[Command, Field] | None:
        """Return the first command with a field of this effect, and that field; None where there is none."""
        return next(iter(self.effects(effect)), None)

    def switched(self, value: int) -> str:
        """Return the name of the dialect that a drive speaks once its field with `Effect.DIALECT` has a value."""
        return self.name if value == self.chosen_by else self.siblings[0]

    @cached_property
    def whole(self) -> Dialect:
        """This dialect with the commands of all models."""
        return self

    def for_model(self, model: str) -> Dialect:
        """Return this dialect as one model speaks it, the same object each time.

        Raises ValueError for a model the dialect does not have.
        """
        if model not in self.models:
            raise ValueError(f"{self.name} has no model {model!r}; it has {', '.join(self.models) or 'none'}")
        made: dict[str, Dialect] = self.__dict__.setdefault("_made", {})
        if model not in made:
            commands = tuple(c.for_model(model) for c in self.commands if not c.models or model in c.models)
            made[model] = replace(self, commands=commands, model=model)
            made[model].__dict__["whole"] = self
        return made[model]


def all_fields(forms: tuple[Form, ...]) -> dict[str, Field]:
    """Return the fields of several forms by name; a name's first declaration wins."""
    result: dict[str, Field] = {}
    for form in forms:
        for name, declared in form.layout.named.items():
            result.setdefault(name, declared)
    return result
