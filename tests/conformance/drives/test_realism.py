"""Realism: an honest drive reads within its noise, answers in time, and is ideal without any trait."""

from __future__ import annotations

import pytest

from analyzer.errors import UsageError
from conformance import claims as registry
from conformance.claim import Outcome
from conformance.cli import emulate
from conformance.drives import make, realism
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.noise import QUIET
from tests.conformance.quirk_runs import run

DRIVES = ("mks-rs485@1", "mks-modbus@1", "mks-can@1", "lk-rs485@1")
#: Claims that a real shaft and a real line would have refuted, by the end of their ids.
_TELLING = ("/sign", "/distance", "/again", "/same-place", "/at-rest", "/read_position/clean", "/answers-raw", "/voltage")


def rig(text: str) -> EmulatedRig:
    return EmulatedRig(make.parse(text))


def readings(text: str, name: str = "read_position", count: int = 40) -> set[tuple[tuple[str, int], ...]]:
    probe = rig(text).probe(next(iter(registry.every(make.parse(text).dialect))))
    return {tuple(probe.ask(name).reply.values.items()) for _ in range(count)}


@pytest.mark.parametrize("drive", DRIVES)
def test_an_ideal_drive_has_no_noise(drive):
    assert rig(drive).noise == QUIET
    assert len(readings(drive)) == 1


@pytest.mark.parametrize("drive", DRIVES)
def test_noise_is_measured_and_bounded(drive):
    noise = rig(f"{drive},real=bench").noise
    assert 0 < noise.degrees <= 2 * 360 / 16384
    assert noise.live
    assert noise.place <= 0.3


@pytest.mark.parametrize("drive", DRIVES)
def test_what_is_drawn_depends_on_the_seed_alone(drive):
    def seen(seed: int) -> list[object]:
        each = EmulatedRig(make.parse(f"{drive},real=poor"), seed=seed)
        probe = each.probe(next(iter(registry.every(each.dialect))))
        return [(a.data, a.latency_ns) for _ in range(20) for a in probe.ask("read_position").answers]

    assert seen(1) == seen(1) != seen(2)


def test_turns_and_the_value_within_one_stay_one_number():
    values = readings("mks-rs485@1,encoder-noise=2", "read_encoder_carry")
    assert {dict(v)["carry"] * 16384 + dict(v)["encoder"] for v in values} == {-2, 0, 2}


def test_a_byte_of_the_line_is_no_part_of_a_reply():
    each = rig("mks-rs485@1,turnaround-noise=FF")
    assert each.noise.stray == b"\xff"
    exchange = each.probe(next(iter(registry.every(each.dialect)))).ask("read_speed")
    assert (exchange.received[:1], exchange.junk) == (b"\xfb", [])


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("real", ["bench", "poor"])
def test_an_honest_drive_is_not_accused(drive, real):
    wanted = [c for c in registry.every(rig(drive).dialect) if c.id.endswith(_TELLING)]
    verdicts = run(f"{drive},real={real}", wanted).values()
    assert [f"{v.claim.id}: {v.reason}" for v in verdicts if v.outcome is Outcome.REFUTED] == []


@pytest.mark.parametrize("fault", ["speed-low-byte-first", "position-half-width"])
def test_a_lie_is_found_on_a_drive_that_trembles(fault):
    each = rig(f"mks-rs485@1,fault={fault},real=bench")
    wanted = [c for c in registry.every(each.dialect) if "/motion/read_" in c.id]
    assert Outcome.REFUTED in {v.outcome for v in engine.run(wanted, each)}


@pytest.mark.parametrize(
    "text", ["real=great", "encoder-noise=x", "encoder-noise=1..2", "latency=8..1ms", "warm=3", "turnaround-noise=FFF"]
)
def test_traits_that_there_are_not_are_refused(text):
    with pytest.raises(UsageError):
        make.parse(f"mks-rs485@1,{text}")


def test_every_trait_has_an_example_that_is_read(capsys):
    for trait in realism.TRAITS:
        text = f"{trait.name}={trait.example}" if trait.unit else trait.name
        assert make.parse(f"mks-rs485@1,{text}").realism.most(trait.name) > 0
    emulate._print_realism()
    listed = capsys.readouterr().out
    assert [trait.name for trait in realism.TRAITS if trait.name not in listed] == []
