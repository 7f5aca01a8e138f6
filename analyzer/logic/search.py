"""What is spoken on one channel: UART or CAN, its rate, its format, its polarity, found in the edges alone.

Theory. All runs of a line are whole numbers of bits long, but for pauses. So the shortest runs that come often enough are one
bit, or a small number of bits. Each such bit time is refined over the runs that it explains, and a receiver is tried with it.
CAN is sure where a CRC fits. A UART is believed where nearly all bytes have their stop bit and edges lie on borders of bits.

Of bit times that explain the bytes equally well the one of a usual rate wins, then the longest. Seven bits with parity look
like eight bits. They are believed where all of many different bytes have that parity. What it cannot know: the format of a
line on which only few different bytes come.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from analyzer.columns.codec import Integers
from analyzer.logic import can, uart
from analyzer.logic.levels import Levels
from analyzer.logic.uart import Format
from analyzer.values import SECOND_NS

#: Usual rates of a UART and of CAN, in bits a second.
UART_RATES = (
    300, 600, 1200, 2400, 4800, 9600, 14400, 19200, 25000, 28800, 31250, 38400, 56000, 57600, 76800, 100000, 115200, 128000,
    153600, 230400, 250000, 256000, 460800, 500000, 576000, 921600, 1000000, 1500000, 2000000, 2500000, 3000000, 4000000,
)  # fmt: skip
CAN_RATES = (10000, 20000, 33333, 50000, 83333, 100000, 125000, 200000, 250000, 500000, 666667, 800000, 1000000)
#: Edges that are looked at, in so many places of a long capture.
_LOOKED, _PLACES = 12_000, 3
#: Share of the runs, and how many, that a length must have to be that of a few bits; and how far it spreads.
_SHARE, _FEWEST, _SPREAD = 0.015, 2, 1.45
#: How many lengths are tried, and how many bits each may be; CAN FD has several bits of its data in one of the others.
_LENGTHS, _DIVISORS, _MULTIPLES = 4, (1, 2, 3, 4, 5), (1, 2, 4, 5, 8)
#: Bits of the longest run inside of a byte.
_LONGEST_RUN = 10
#: A rate within this share of a usual one is meant to be that; nearer than `_EXACT`, and than this part of a sample in a bit,
#: it is taken as exactly that.
NEAR, _EXACT, _OF_A_SAMPLE = 0.03, 0.003, 0.04
#: Runs below which a rate cannot be measured well, so that a usual one near it is taken.
_FEW_RUNS = 24
#: Shares of sound bytes, and of edges on borders of bits, from which on a UART is believed.
BELIEVED, _ALIGNED = 0.6, 0.8
#: What speaks against a reading, as logarithms: a byte with an error, and what is seldom met.
_BAD_BYTE, _RARE_RATE, _INVERTED, _IDLE_LOW, _RARE_FORMAT, _FRACTION = 3.5, 4.0, 1.0, 3.0, 2.0, 8.0
#: Share of the runs that must not be multiples of two bits, or of three.
_ODD_SHARE = 0.1
#: Different bytes that all have a parity, before seven bits are believed; fewer where those alone are text.
_PARITIES, _PARITIES_OF_TEXT = 8, 4
#: Share of the bytes that may lack the parity.
_SPOILT = 0.03
_TEXT = frozenset(b"\t\r\n") | frozenset(range(0x20, 0x7F))
_FORMATS = ((8, "N"), (8, "E"), (8, "O"), (7, "N"))
#: Frames without a good CRC after which a bit time is none of CAN.
_CAN_EDGES = 4000
#: Share of the frames whose CRC must fit, where all are destroyed behind it.
_CAN_SHARE = 0.25
#: CAN FD frames, and their share with sound ones, from which on a channel is believed to be that; bytes of a UART that is so
#: sound are not.
_FEWEST_FD, _OF_FD, _SOUND = 8, 0.95, 0.98
#: Share of the edges that may belong to glitches.
_GLITCHES = 0.3


@dataclass(frozen=True)
class Spoken:
    """What one channel speaks. `count`: bytes or frames in the sample; `quality`: share of those without an error.

    `form` has the bit time and polarity of CAN, too. `values`: different bytes; `fd`: CAN FD frames.
    """

    kind: str
    form: Format
    count: int
    quality: float
    values: int = 0
    fd: int = 0

    @property
    def rate(self) -> int:
        """The rate in bits a second: the usual one where it is near."""
        measured = SECOND_NS / self.form.bit_ns
        usual = _usual(self.form.bit_ns, UART_RATES if self.kind == "serial" else CAN_RATES)
        return usual or round(measured)

    @property
    def words(self) -> str:
        """The rate, the format and the polarity in words."""
        measured = SECOND_NS / self.form.bit_ns
        drift = 100 * (measured / self.rate - 1)
        off = f" ({drift:+.1f} %)" if abs(drift) >= 100 * _EXACT else ""
        inverted = ", inverted" if self.form.inverted else ""
        if self.kind == "can":
            return f"CAN at {self.rate} bit/s{off}{inverted}"
        return f"UART {self.rate} baud{off} {self.form.word}{inverted}"


def _usual(bit_ns: float, rates: Sequence[int], near: float = NEAR) -> int:
    """Return the usual rate that is nearest to a bit time, 0 where none is near."""
    best = min(rates, key=lambda rate: abs(bit_ns * rate / SECOND_NS - 1), default=0)
    return best if abs(bit_ns * best / SECOND_NS - 1) <= near else 0


def sample(levels: Levels) -> list[Levels]:
    """Return some stretches of a channel: its beginning, middle and end, or all of a short one."""
    count = len(levels.edges)
    if count <= _LOOKED:
        return [levels]
    size = _LOOKED // _PLACES
    starts = [place * (count - size) // (_PLACES - 1) for place in range(_PLACES)]
    # A stretch begins in the longest pause near its place, so that it begins with a byte.
    gaps = np.diff(levels.edges)
    starts = [0 if not at else at + 1 + int(np.argmax(gaps[at : at + size // 4])) for at in starts]
    return [levels.since(at).until(min(size, count - 1 - at)) for at in starts]


def shortest_ns(stretches: Sequence[Levels]) -> float:
    """Return the length of the shortest run that comes often, 0 where there is none."""
    lengths = _lengths(_runs(stretches))
    return lengths[0] if lengths else 0.0


def _runs(stretches: Sequence[Levels]) -> Integers:
    return np.concatenate([np.diff(each.edges) for each in stretches])


def _lengths(runs: Integers) -> list[float]:
    """Return lengths around which many runs lie, the shortest first."""
    runs = np.sort(runs[runs > 0]).astype(float)
    least = max(_FEWEST, round(_SHARE * len(runs))) if len(runs) > 2 * _FEWEST else 1
    found: list[float] = []
    at = 0
    while at < len(runs) and len(found) < _LENGTHS:
        end = int(np.searchsorted(runs, runs[at] * _SPREAD, side="right"))
        if end - at >= least:
            found.append(float(np.median(runs[at:end])))
            at = end
        else:
            at += 1
    return found


def _refined(bit_ns: float, runs: Integers) -> float:
    """Return a bit time corrected by the runs that are a whole number of it."""
    for most in (2, 2, 3, 5, 5, _LONGEST_RUN, _LONGEST_RUN):
        bits = np.rint(runs / bit_ns)
        fits = (bits >= 1) & (bits <= most) & (np.abs(runs / bit_ns - bits) < uart.EDGE_ALIGNED)
        if fits.any():
            bit_ns = float((runs[fits] * bits[fits]).sum() / (bits[fits] ** 2).sum())
    return bit_ns


def _bit_times(stretches: Sequence[Levels]) -> list[float]:
    """Return the times that one bit may take."""
    found: list[float] = []
    for length in _lengths(_runs(stretches)):
        for divisor in _DIVISORS:
            bit_ns = _refined(length / divisor, _runs([each.without_glitches(length / divisor) for each in stretches]))
            if all(abs(bit_ns / other - 1) > _EXACT for other in found):
                found.append(bit_ns)
    return found


def spoken(
    levels: Levels, baud: int | None = None, inverted: bool | None = None, word: str = "", *, rated: bool = True
) -> Spoken | None:
    """Return what a channel speaks, None where nothing is believed.

    `baud`: the rate, `inverted`: the polarity, `word`: the format of a UART (8E1), where given. `rated` False: times are no ns,
    so no rate is usual.
    """
    stretches = sample(levels)
    polarities = (False, True) if inverted is None else (inverted,)
    if baud is None:
        times = _bit_times(stretches)
    else:
        given = SECOND_NS / baud
        refined = _refined(given, _runs([each.without_glitches(given) for each in stretches]))
        times = [refined if abs(refined / given - 1) < NEAR else given]
    can_rates, uart_rates = (CAN_RATES, UART_RATES) if rated else ((), ())
    tried = [] if word else list(_as_can(stretches, times, polarities, can_rates, exact=baud is not None))
    sure = max((each for each in tried if each.count), key=lambda each: each.count, default=None)
    if sure is not None:
        return sure
    found = _as_uart(stretches, times, polarities, uart_rates, word)
    # CAN FD has a CRC of its own; so many frames of its head alone, and nothing else, are that.
    heads = (each for each in tried if each.fd >= _FEWEST_FD and each.quality >= _OF_FD)
    fd = max(heads, key=lambda each: each.fd, default=None)
    return fd if fd is not None and (found is None or found.values == 1 or found.quality < _SOUND) else found


# --- CAN ----------------------------------------------------------------------------------------------------------------


def _as_can(
    stretches: Sequence[Levels], times: Sequence[float], polarities: Sequence[bool], rates: Sequence[int], *, exact: bool
) -> Iterator[Spoken]:
    tried = {bit_ns * each for bit_ns in times for each in ((1,) if exact else _MULTIPLES)}
    cleaned = {bit_ns: _runs([each.without_glitches(bit_ns) for each in stretches]) for bit_ns in tried}
    refined = [(_refined(each, runs), runs) for each, runs in cleaned.items()]
    for bit_ns in sorted({round(_snapped(each, rates, _tolerance(runs, each)), 1) for each, runs in refined}):
        for inverted in polarities:
            found = [can.read(_short(each), bit_ns, inverted=inverted) for each in stretches]
            good, fd = sum(each.good for each in found), sum(each.fd for each in found)
            total = sum(len(each.frames) + each.fd + each.broken for each in found)
            # One CRC of 32768 fits by chance; with the bits behind it that happens to one frame of millions.
            sure = any(each.whole for each in found) or good > _CAN_SHARE * total
            if sure or fd:
                yield Spoken("can", Format(bit_ns, inverted=inverted), good * sure, (good + fd) / total, fd=fd)


def _short(levels: Levels) -> Levels:
    return levels.until(_CAN_EDGES) if len(levels.edges) > _CAN_EDGES else levels


def _tolerance(runs: Integers, bit_ns: float) -> float:
    """Return by what share a measured bit time may be off: the more, the fewer samples a bit has."""
    steps = np.diff(np.unique(runs[runs < _LONGEST_RUN * bit_ns]))
    return _EXACT + _OF_A_SAMPLE * (float(steps.min()) if len(steps) else bit_ns) / bit_ns


def _snapped(bit_ns: float, rates: Sequence[int], near: float) -> float:
    usual = _usual(bit_ns, rates, near)
    return SECOND_NS / usual if usual else bit_ns


# --- UART ---------------------------------------------------------------------------------------------------------------


def _as_uart(
    stretches: Sequence[Levels], times: Sequence[float], polarities: Sequence[bool], rates: Sequence[int], word: str
) -> Spoken | None:
    runs = _runs(stretches)
    tried = [
        (_odds(each, fraction, rates) - _IDLE_LOW * _idle_low(stretches, inverted), each)
        for bit_ns in times
        for fraction in (_is_fraction(bit_ns, runs),)
        for inverted in polarities
        for each in _formats(stretches, bit_ns, inverted, rates if len(runs) < _FEW_RUNS else (), rates, word)
    ]
    if not tried:
        return None
    best = max(tried, key=lambda each: (each[0], each[1].form.bit_ns))[1]
    return best if best.quality >= BELIEVED else None


def _idle_low(stretches: Sequence[Levels], inverted: bool) -> int:
    """Return how often a line is low before its first edge, or behind its last: idle lines are high."""
    return sum((level ^ inverted) == 0 for level in (stretches[0].first, stretches[-1].last))


def _odds(said: Spoken, fraction: bool, rates: Sequence[int]) -> float:
    """Return how likely a reading is, as a logarithm: bytes with errors count against it, and what is unusual does."""
    form = said.form
    unusual = _RARE_RATE * (not _usual(form.bit_ns, rates)) + _INVERTED * form.inverted + _FRACTION * fraction
    return -_BAD_BYTE * said.count * (1 - said.quality) - unusual - _RARE_FORMAT * (form.word != "8N1")


def _is_fraction(bit_ns: float, runs: Integers) -> bool:
    """Say whether nearly all runs are twice or three times a bit time, or more: then it is a part of a bit."""
    bits = np.rint(runs / bit_ns)
    bits = bits[(bits > 0) & (bits <= 2 * _LONGEST_RUN)]
    return any((bits % divisor != 0).mean() < _ODD_SHARE for divisor in (2, 3, 5)) if len(bits) else False


def _formats(
    stretches: Sequence[Levels], bit_ns: float, inverted: bool, near: Sequence[int], rates: Sequence[int], word: str
) -> Iterator[Spoken]:
    """Yield what a UART of a rate and polarity makes of a channel, in each format. `near`: rates taken where one is near.

    `word`: the format, where it is given.
    """
    usual = _usual(bit_ns, near) or _usual(bit_ns, rates, _tolerance(_runs(stretches), bit_ns))
    bit_ns = SECOND_NS / usual if usual else bit_ns
    for form in [as_told(word, bit_ns, inverted)] if word else [Format(bit_ns, *each, inverted) for each in _FORMATS]:
        each = _try(stretches, form, found=not word)
        if each is None:
            return
        yield each
        if each.quality == 1.0:
            return


def as_told(word: str, bit_ns: float, inverted: bool) -> Format:
    """Return the format that a user names, 8N1 without a name; a second stop bit looks like an idle line."""
    return Format(bit_ns, int(word[0]), word[1], inverted) if word else Format(bit_ns, inverted=inverted)


def _try(stretches: Sequence[Levels], form: Format, *, found: bool) -> Spoken | None:
    """Return what a UART makes of a channel, None where its edges do not lie on the borders of bits.

    `found`: eight bits may be seven and a parity.
    """
    clean = sum(len(each.without_glitches(form.bit_ns).edges) for each in stretches)
    heard = [uart.read(each, form) for each in stretches]
    count = sum(map(len, heard))
    if not count or clean < (1 - _GLITCHES) * sum(len(each.edges) for each in stretches):
        return None
    on_borders = sum(uart.aligned(each, form, read) * len(read) for each, read in zip(stretches, heard, strict=True)) / count
    if on_borders < _ALIGNED:
        return None
    values, counts = np.unique(np.concatenate([each.values for each in heard]), return_counts=True)
    quality = 1 - sum(each.bad for each in heard) / count
    if found and (form.data_bits, form.parity) == (8, "N") and quality >= BELIEVED:
        data_bits, parity = _seven_bits(dict(zip(values.tolist(), counts.tolist(), strict=True)))
        form = form._replace(data_bits=data_bits, parity=parity)
    return Spoken("serial", form, count, quality, len(values))


def _seven_bits(counts: Mapping[int, int]) -> tuple[int, str]:
    """Return the data bits and the parity that eight bits are; how often each value came."""
    for parity, odd in (("E", 0), ("O", 1)):
        fitting = [value for value in counts if value.bit_count() & 1 == odd]
        text = all(value & 0x7F in _TEXT for value in fitting)
        # Noise may spoil some.
        spoilt = sum(count for value, count in counts.items() if value not in fitting)
        few = spoilt <= _SPOILT * sum(counts.values()) and len(counts) <= (1 + 1 / _PARITIES) * len(fitting)
        if few and len(fitting) >= (_PARITIES_OF_TEXT if text else _PARITIES) and any(value & 0x80 for value in fitting):
            return 7, parity
    marked = len(counts) >= _PARITIES_OF_TEXT and all(value & 0x80 and value & 0x7F in _TEXT for value in counts)
    return (7, "N") if marked else (8, "N")
