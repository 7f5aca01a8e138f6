"""What a drive shows of a setting, so that a claim can tell whether a value is stored.

    effect = of(dialect, command)
    effect.see(probe)      what the drive does now, in words and numbers that can be compared

A dialect that reads its settings back (CAN) shows the values themselves. The others show a setting by its effect:

    work mode      whether the motor can be enabled
    subdivision    how far 200 pulses go
    respond        which replies a move gets
    homing         its speed and direction
    group          which address the drive obeys

Rules kept here:
- Seeing changes nothing that is stored and moves the shaft a turn at most, 300 rpm at most, and leaves it standing.
- What does not work on the way raises Inconclusive.
- A setting that shows nowhere (screen, keys, currents of a native drive) has no effect here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Dialect, Form, Risk, Verb
from analyzer.layout import Field
from conformance.claim import Inconclusive
from conformance.model import limits
from conformance.motion import arriving, declared, motion
from conformance.motion.attempts import anew
from conformance.motion.declared import SUBDIVISION
from conformance.talk import settings
from conformance.talk.acceptance import Acceptance, acceptance, answers, need_reliable_replies, without_repeats
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Until

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: The acceleration of moves that are to be short. (Not 250: that byte begins a frame.)
STEEP = 248
#: Pulses of the move that shows a subdivision: a turn at 1, a 256th at 256.
PULSES = 200
#: Homing is watched for so long.
_WATCH_NS = 100 * MS
#: How long a move that shows a setting takes at most, with a reserve.
_MOVE_NS = 1000 * MS
#: Right after a move a real shaft may still settle.
SETTLING_NS = 150 * MS
#: Positions that are one, in counts: a motor holds so well.
_COUNTS = 24
#: Speeds that are one.
_SPEED_SHARE = 0.1

Seen = Any


def _words(seen: Seen) -> str:
    return " ".join(f"{k}={v}" for k, v in seen.items()) if isinstance(seen, Mapping) else str(seen)


@dataclass(frozen=True)
class SettingEffect:
    """How a setting shows.

    `see`: what the drive does now. `values`: sets of values that show differently, the first one not the default.
    `ready`: what must be done first. `same`: whether two things seen are one. `sends`: verbs that it sends, with values;
    their risks are the claim's. `moves`: it moves the shaft. `expected(values)`: what is seen after these values, None where
    only differences count. `set_first` False: the drive's present value is to stay.
    """

    see: Callable[[Probe], Seen]
    values: tuple[Mapping[str, int], ...] = ()
    ready: Callable[[Probe], None] = lambda probe: None
    same: Callable[[Probe, Seen, Seen], bool] = lambda probe, one, other: bool(one == other)
    words: Callable[[Seen], str] = _words
    expected: Callable[[Dialect, Mapping[str, int]], Seen] | None = None
    sends: tuple[tuple[Verb, Mapping[str, int]], ...] = ()
    moves: bool = False
    alone: bool = False
    set_first: bool = True

    def pair(self, form: Form) -> tuple[dict[str, int], dict[str, int]]:
        """Return two sets of values of a form that show differently, neither of them the default where that can be."""
        if not self.set_first:
            return {}, {}
        if len(self.values) > 1:
            return dict(self.values[0]), dict(self.values[1])
        return differing(form)

    def expect(self, probe: Probe, seen: Seen, should: Seen, refutes: str, exchange: Exchange, key: str = "") -> None:
        """Refute unless what is seen is what should be."""
        holds, expected = self.same(probe, should, seen), self.words(should)
        probe.expect(self.words(seen), holds=holds, expected=expected, refutes=refutes, exchange=exchange, key=key)

    def risks(self, dialect: Dialect) -> frozenset[Risk]:
        """Return the risks of what `ready` and `see` send, beside reads."""
        found: set[Risk] = set(declared.risks(dialect)) if self.moves else set()
        for verb, values in self.sends:
            found |= dialect.by_verb[verb].risks(values)
        return frozenset(found) - {Risk.READ}

    def needed(self, dialect: Dialect, needs: Mapping[str, Any], *more: Risk) -> dict[str, Any]:
        """Return what a claim must declare that uses this effect beside what `needs` says, with the risks `more`."""
        changed = declared.settings(dialect) if self.moves else ()
        return {
            **needs,
            "risks": needs["risks"] | self.risks(dialect) | set(more),
            "settings": tuple(dict.fromkeys((*needs["settings"], *changed))),
            "alone": needs["alone"] or self.alone,
        }


def differing(form: Form) -> tuple[dict[str, int], dict[str, int]]:
    """Return two sets of allowed values of a form that differ in every field, from each other and from the defaults."""
    one: dict[str, int] = {}
    two: dict[str, int] = {}
    for name, field in form.layout.named.items():
        if field.fixed is not None:
            one[name] = two[name] = field.fixed
            continue
        others = [v for v in _distinct(field) if v != field.default]
        one[name] = others[0]
        two[name] = others[1] if len(others) > 1 else int(field.default if field.default is not None else others[0])
    return one, two


def _distinct(field: Field) -> list[int]:
    """Return allowed values that show a mistake: no two bytes alike, none 0; of choices the last first."""
    choices = limits.listed(field)
    if choices is not None:
        return list(reversed(choices))
    marks = (0x0102_0304_0506_0708 >> (64 - field.bit_width), 0x0A0B_0C0D_0E0F_1011 >> (64 - field.bit_width))
    spans = field.high - field.low
    inner = [field.low + spans * n // 7 for n in (2, 5)]
    return [v for v in (*marks, *inner, field.high, field.low) if field.allows(v)]


def of(dialect: Dialect, command: Command) -> SettingEffect | None:
    """Return how a setting of a dialect shows, None where it does not."""
    if settings.changes_link(command):
        return _LINK
    if command.readable:
        return _read_back(command)
    return by_action(dialect, command)


def by_action(dialect: Dialect, command: Command) -> SettingEffect | None:
    """Return how a setting shows by what the drive does, None where it does not or the dialect lacks what it takes."""
    effect = BY_VERB.get(command.verb)
    if effect is None or not declared.can_move(dialect) or any(verb not in dialect.by_verb for verb, _ in effect.sends):
        return None
    return effect


# --- read back --------------------------------------------------------------------------------------------------------


def stored(probe: Probe, command: Command, cannot: type[Exception] = Inconclusive) -> tuple[dict[str, int], Exchange]:
    """Return the stored values of a setting, and the exchange that read them.

    Raises `cannot` where the drive says that it cannot be read, Inconclusive where it is not answered or by another layout.
    """
    values, exchange = settings.read_back(probe, command)
    text = probe.reply(exchange).data.hex(" ").upper()
    if values is None:
        raise cannot(f"{command.name} cannot be read: {text}")
    if not values:
        raise Inconclusive(f"the read of {command.name} was answered {text}")
    return values, exchange


def _read_back(command: Command) -> SettingEffect:
    return SettingEffect(
        see=lambda probe: stored(probe, command)[0],
        expected=lambda dialect, values: {n: values[n] for n in command.request_forms[0].layout.named if n in values},
    )


def _answers(probe: Probe) -> str:
    return "an answer at its address" if answers(probe) else "silence at its address"


#: A setting of the link shows by where the drive answers. It is not tried out here: that would lead the drive away.
_LINK = SettingEffect(see=_answers, set_first=False)

# --- by what it does --------------------------------------------------------------------------------------------------


def _can_be_enabled(probe: Probe) -> str:
    exchange = probe.ask(Verb.ENABLE, {"enabled": 1})
    return "pulses" if acceptance(probe, exchange) is Acceptance.REFUSED else "bus"


def _controller(dialect: Dialect, values: Mapping[str, int]) -> str:
    names = dialect.by_verb[Verb.SET_WORK_MODE].request_forms[0].layout.named["work_mode"].choice_names
    return "bus" if names[values["work_mode"]] in declared.bus_modes(dialect) else "pulses"


def _enabled(probe: Probe) -> int:
    return probe.read(Verb.READ_ENABLED)


def counts(probe: Probe) -> int:
    """Return where a standing shaft is by the encoder, in counts.

    Raises Inconclusive where its two reads differ, which claims about reads judge.
    """
    position = probe.read(Verb.READ_POSITION, "position")
    parts = probe.reply(probe.ask(Verb.READ_ENCODER_CARRY, quiet_ns=0)).values
    whole = parts.get("carry", 0) * probe.dialect.counts_per_turn + parts.get("encoder", 0)
    if abs(whole - position) > _COUNTS:
        raise Inconclusive(f"31 reads {position} and 30 {whole}")
    return position


def steady_speed(probe: Probe) -> float:
    """Return the rpm at which the shaft turns, signed, as it is read and as two positions have it.

    Raises Inconclusive where the two differ, which claims about reads judge.
    """
    before = motion.position(probe)
    probe.wait(100 * MS)
    read = motion.speed(probe).value
    rpm, uncertain = motion.speed_between(before, motion.position(probe))
    if abs(abs(rpm) - abs(read)) > uncertain + max(probe.within("rpm", read), CLOCK_SHARE * abs(read)):
        raise Inconclusive(f"the speed reads {read:.0f} rpm, and two positions say {rpm:.0f}")
    return read


@anew
def shift(probe: Probe, verb: Verb, values: Mapping[str, Any]) -> int:
    """Do a move and return how far the encoder went.

    Raises Inconclusive where the drive refuses it or does not come to rest.
    """
    start = counts(probe)
    # A read before the end is told may collide with that.
    exchange = probe.ask(verb, values, until=Until.DONE, timeout_ns=_MOVE_NS, quiet_ns=0)
    if exchange.answers and probe.refused(exchange):
        raise Inconclusive(f"{probe.command(verb).name} was refused")
    motion.wait_standing(probe)
    probe.wait(SETTLING_NS if probe.noise.settles else 0)
    return counts(probe) - start


def _distance(probe: Probe) -> int:
    # Not slower: at 200 subdivisions a shaft would look as if it stood. Not faster: at 1 this is 288 rpm.
    values = {"direction": 0, "speed": 18, "acceleration": STEEP, "pulses": PULSES}
    return shift(probe, Verb.MOVE_RELATIVE_PULSES, values)


def _expected_counts(dialect: Dialect, values: Mapping[str, int]) -> int:
    return declared.counts_of(dialect, dialect.by_verb[Verb.MOVE_RELATIVE_PULSES], PULSES, values["subdivision"])


def near(probe: Probe, one: int, other: int) -> bool:
    """Say whether two distances in counts are one but for a motor's play; the direction is another claim's.

    Each distance has two places of its own, which tremble.
    """
    return abs(abs(one) - abs(other)) <= max(
        min(_COUNTS, max(3, abs(one) // 8)), probe.noise.step("counts") + 2 * probe.noise.counts
    )


@anew
def _statuses(probe: Probe) -> str:
    """Return the statuses that a small move is answered with, until the shaft stands and half a second longer."""
    values = {"direction": 0, "speed": 60, "acceleration": STEEP, "pulses": PULSES}
    exchange = probe.ask(Verb.MOVE_RELATIVE_PULSES, values, until=Until.TIMEOUT, timeout_ns=700 * MS)
    motion.wait_standing(probe)
    if exchange.damaged:
        raise Inconclusive("the replies to a move cannot be read")
    # A late reply to the setting before it tells nothing of the move.
    statuses = arriving.statuses((exchange,), probe.command(Verb.MOVE_RELATIVE_PULSES))
    return " then ".join(map(str, without_repeats(statuses))) or "silence"


def _expected_statuses(dialect: Dialect, values: Mapping[str, int]) -> str:
    if not values["respond"]:
        return "silence"
    return "1 then 2" if values["active"] else "1"


def _ready(probe: Probe) -> None:
    motion.ready_to_move(probe, subdivision=SUBDIVISION)


@dataclass(frozen=True)
class Homing:
    """How homing begins: speed (rpm) and way (1 raises the encoder)."""

    rpm: float
    way: int

    def __str__(self) -> str:
        """Return it for people."""
        return f"homing at {self.rpm:.0f} rpm, the encoder {'rising' if self.way > 0 else 'falling'}"


@anew
def homing(probe: Probe) -> Homing:
    """Begin homing, look, and stop at once. Raises Inconclusive where it does not begin."""
    exchange = probe.ask(Verb.HOME)
    probe.reply(exchange)
    if probe.refused(exchange):
        raise Inconclusive("homing does not begin")
    probe.wait(_WATCH_NS)
    rpm = steady_speed(probe)
    probe.ask(Verb.EMERGENCY_STOP)
    motion.wait_standing(probe)
    if abs(rpm) < 1:
        raise Inconclusive("homing does not turn the shaft")
    return Homing(abs(rpm), 1 if rpm > 0 else -1)


def _same_homing(probe: Probe, one: Homing, other: Homing) -> bool:
    most = max(one.rpm, other.rpm)
    return one.way == other.way and abs(one.rpm - other.rpm) <= max(probe.within("rpm", most), _SPEED_SHARE * most)


def hears(probe: Probe, address: int, own: int | None = None) -> bool:
    """Say whether the drive obeys what is sent to an address that does not answer: it is disabled, and enabled again.

    `own`: where it answers, when that is not the address of the run.
    """
    return all(_obeys(probe, address, wanted, own) for wanted in (0, 1))


def _obeys(probe: Probe, address: int, enabled: int, own: int | None) -> bool:
    # By then it would have answered, too: it has done it.
    probe.ask(Verb.ENABLE, {"enabled": enabled}, address=address, until=Until.TIMEOUT, timeout_ns=probe.rig.quiet_ns)
    return bool(probe.reply(probe.ask(Verb.READ_ENABLED, address=own, quiet_ns=0)).values.get("enabled") == enabled)


#: Groups that are tried: each drive can have the first ones, a CAN drive all.
GROUPS = (0x50, 0x51, 0x7F, 0xC8, 0x6A5)
GROUP = GROUPS[0]


def _group(probe: Probe) -> str:
    field = probe.command(Verb.SET_GROUP_ADDRESS).request_forms[0].layout.named["group_address"]
    heard = [f"{a:#x}" for a in GROUPS if field.allows(a) and a != probe.address and hears(probe, a)]
    if len(heard) != 1:
        need_reliable_replies(probe)
        if not hears(probe, probe.address):
            raise Inconclusive("3A does not follow F3 at the drive's own address, so it shows nothing of a group's")
    probe.ask(Verb.ENABLE, {"enabled": 1})
    return f"hears {' and '.join(heard) or 'none'} of the groups that are tried"


_MOVE = (Verb.MOVE_RELATIVE_PULSES, {"direction": 0, "speed": 60, "acceleration": STEEP, "pulses": PULSES})
_ON, _OFF = (Verb.ENABLE, {"enabled": 1}), (Verb.ENABLE, {"enabled": 0})

#: What a setting shows by, where it cannot be read.
BY_VERB: Mapping[Verb, SettingEffect] = {
    Verb.SET_WORK_MODE: SettingEffect(
        see=_can_be_enabled, values=({"work_mode": 5}, {"work_mode": 0}), expected=_controller, sends=(_ON,)
    ),
    Verb.SET_SUBDIVISION: SettingEffect(
        see=_distance,
        ready=motion.ready_to_move,
        same=near,
        expected=_expected_counts,
        sends=(_MOVE,),
        moves=True,
        values=tuple({"subdivision": n} for n in (200, 8, 64, 1, 128, 32)),
        words=lambda seen: f"{PULSES} pulses turn the shaft by {abs(seen)} counts",
    ),
    Verb.SET_RESPOND: SettingEffect(
        see=_statuses,
        ready=_ready,
        expected=_expected_statuses,
        sends=(_MOVE,),
        moves=True,
        values=tuple({"respond": r, "active": a} for r, a in ((1, 0), (0, 1), (0, 0), (1, 1))),
        words=lambda seen: f"a move is answered by {seen}",
    ),
    Verb.SET_HOME: SettingEffect(
        see=homing,
        ready=_ready,
        same=_same_homing,
        moves=True,
        sends=((Verb.HOME, {}), (Verb.EMERGENCY_STOP, {})),
        values=(
            {"home_trigger": 0, "home_direction": 1, "home_speed": 270, "end_limit": 0},
            {"home_trigger": 1, "home_direction": 0, "home_speed": 180, "end_limit": 0},
        ),
    ),
    Verb.SET_GROUP_ADDRESS: SettingEffect(
        see=_group,
        ready=motion.ready_to_move,
        expected=lambda dialect, values: f"hears {values['group_address']:#x} of the groups that are tried",
        moves=True,
        alone=True,
        sends=(_ON, _OFF),
        values=tuple({"group_address": group} for group in GROUPS),
    ),
    Verb.ENABLE: SettingEffect(
        see=_enabled,
        ready=motion.ready_to_move,
        moves=True,
        values=({"enabled": 0}, {"enabled": 1}),
        expected=lambda dialect, values: values["enabled"],
        sends=(_ON, _OFF),
        words=lambda seen: f"enabled reads {seen}",
    ),
}
