"""Each named fault of the LK drive shows on the bus: an exchange whose answer differs from the conforming drive's."""

from __future__ import annotations

import random
from collections import defaultdict
from functools import partial

import pytest

from conformance.drives.drive import Fault
from conformance.drives.make import every_fault
from tests.conformance.claims.test_conditions import REFUTED_BY
from tests.conformance.drives.lk_bench import SECOND, STEP_NS, Bench
from tests.conformance.drives.lk_motion_story import MOVED
from tests.conformance.drives.lk_story import TOLD, readings
from tests.conformance.drives.test_mks_faults import any_request

#: The faults that only an LK drive has; the others are shown by the claims that refute them.
FAULTS = [fault for fault in every_fault() if fault.dialects == ("lk-rs485",) and fault.name not in REFUTED_BY]
SCRIPTS = TOLD | MOVED
MS_SCRIPTS = {name for name in SCRIPTS if "power" in name} - {"parameters and power", "position and power"}

#: The exchange that shows each fault.
SHOWN_BY: dict[str, str] = {
    "lk-data-sum-wrong": "readings",
    "lk-head-sum-wrong": "readings",
    "lk-data-sum-missing": "readings",
    "lk-data-sum-of-nothing": "echoes",
    "lk-data-sum-with-head": "readings",
    "lk-head-sum-without-start": "echoes",
    "lk-reply-start-wrong": "echoes",
    "lk-reply-code-wrong": "speed",
    "lk-echo-code-wrong": "echoes",
    "lk-reply-address-wrong": "readings",
    "lk-reply-length-wrong": "readings",
    "lk-reply-short": "speed",
    "lk-motion-reply-empty": "multi-turn",
    "lk-set-position-reply-empty": "echoes",
    "lk-echo-with-status": "echoes",
    "lk-parameter-bytes-shifted": "gains",
    "lk-answers-other-address": "strangers",
    "lk-answers-address-0": "strangers",
    "lk-answers-wrong-data-sum": "strangers",
    "lk-answers-wrong-head-sum": "strangers",
    "lk-answers-unknown-code": "strangers",
    "lk-answers-wrong-length": "strangers",
    "lk-silent-while-off": "off",
    "lk-reply-late": "readings",
    "lk-reply-lost": "readings",
    "lk-reply-twice": "readings",
    "lk-reply-cut": "readings",
    "lk-reply-noise": "readings",
    "lk-speed-bytes-swapped": "readings",
    "lk-angle-bytes-swapped": "readings",
    "lk-voltage-bytes-swapped": "readings",
    "lk-asked-speed-swapped": "speed",
    "lk-asked-angle-swapped": "clockwise",
    "lk-speed-sign-lost": "speed",
    "lk-position-sign-lost": "readings",
    "lk-torque-sign-lost": "torque",
    "lk-asked-speed-sign-lost": "speed",
    "lk-increment-sign-lost": "increment",
    "lk-temperature-unsigned": "readings",
    "lk-position-int32": "far",
    "lk-target-int32": "far",
    "lk-asked-speed-int16": "fast",
    "lk-asked-speed-24-bit": "very fast",
    "lk-max-speed-24-bit": "very fast",
    "lk-parameter-int16": "limits",
    "lk-asked-speed-tenfold": "speed",
    "lk-speed-tenth": "speed",
    "lk-position-tenth": "multi-turn",
    "lk-target-tenfold": "multi-turn",
    "lk-voltage-tenth": "readings",
    "lk-torque-half": "torque",
    "lk-max-speed-tenfold": "slow",
    "lk-angle-doubled": "readings",
    "lk-encoder-bytes-swapped": "readings",
    "lk-encoder-doubled": "readings",
    "lk-encoder-half-width": "readings",
    "lk-position-bytes-swapped": "readings",
    "lk-position-doubled": "readings",
    "lk-position-half-width": "readings",
    "lk-position-sign-turned": "readings",
    "lk-speed-doubled": "readings",
    "lk-speed-half-width": "readings",
    "lk-speed-sign-turned": "readings",
    "lk-torque-bytes-swapped": "torque",
    "lk-torque-doubled": "torque",
    "lk-torque-half-width": "torque",
    "lk-torque-sign-turned": "torque",
    "lk-voltage-doubled": "readings",
    "lk-voltage-half-width": "readings",
    "lk-voltage-sign-turned": "readings",
    "lk-torque-any": "too much torque",
    "lk-power-any": "too much power",
    "lk-torque-short": "highest torque",
    "lk-power-short": "highest power",
    "lk-torque-short-below": "lowest torque",
    "lk-torque-one-more": "too much torque",
    "lk-torque-one-less": "too little torque",
    "lk-power-short-below": "lowest power",
    "lk-power-one-more": "too much power",
    "lk-power-one-less": "too little power",
    "lk-angle-one-more": "360 degrees",
    "lk-angle-not-0": "lowest angle",
    "lk-direction-not-1": "counter-clockwise",
    "lk-angle-any": "too high an angle",
    "lk-angle-short": "highest angle",
    "lk-direction-any": "no direction",
    "lk-state-1-swapped": "readings",
    "lk-state-always-on": "off",
    "lk-error-bits-shifted": "errors",
    "lk-error-bits-hidden": "errors",
    "lk-error-bits-frozen": "errors",
    "lk-encoder-not-offset": "zero",
    "lk-encoder-offset-added": "zero",
    "lk-encoder-coarse": "readings",
    "lk-single-turn-runs-on": "turns",
    "lk-position-single-turn": "turns",
    "lk-phases-in-step": "phases",
    "lk-zero-not-raw": "zero",
    "lk-parameter-other": "gains",
    "lk-gains-swapped": "gains",
    "lk-parameter-write-zeros": "gains",
    "lk-brake-state-inverted": "brake",
    "lk-brake-state-unlisted": "brake",
    "lk-brake-read-releases": "brake",
    "lk-single-turn-inverted": "clockwise",
    "lk-single-turn-shortest": "clockwise",
    "lk-speed-inverted": "speed",
    "lk-increment-absolute": "increment",
    "lk-multi-turn-relative": "multi-turn",
    "lk-max-speed-ignored": "slow",
    "lk-speed-limit-ignored": "limits",
    "lk-speed-ramp-ignored": "limits",
    "lk-torque-limit-ignored": "torque limit",
    "lk-angle-limit-ignored": "limits",
    "lk-angle-limit-above-only": "states",
    "lk-run-no-faster-below": "below",
    "lk-max-speed-half-below": "below",
    "lk-ramp-steep-below": "below",
    "lk-speed-limit-below-only": "below",
    "lk-run-limit-clockwise-only": "limited below",
    "lk-torque-limit-late": "below",
    "lk-speed-limit-late": "below",
    "lk-reads-silent-while-off": "states",
    "lk-parameters-silent-while-turning": "states",
    "lk-reads-silent-in-error": "states",
    "lk-stop-ignored-backwards": "states",
    "lk-stop-drops-turns-of-a-run": "states",
    "lk-off-drops-turns-of-a-run": "states",
    "lk-turns-kept-while-turning": "states",
    "lk-clear-errors-turns-off": "states",
    "lk-cleared-state-always-on": "states",
    "lk-increment-lost-in-a-run": "over others",
    "lk-run-lost-in-a-move": "over others",
    "lk-move-lost-in-a-torque": "over others",
    "lk-single-turn-lost-backwards": "over others",
    "lk-single-turn-frozen-backwards": "over others",
    "lk-encoder-frozen-turning": "over others",
    "lk-cleared-flags-told": "afterwards",
    "lk-motion-tells-last-read": "afterwards",
    "lk-brake-reads-on-after-motion": "afterwards",
    "lk-slow-runs-stand": "afterwards",
    "lk-single-turn-by-position": "afterwards",
    "lk-increment-of-stopped-move": "afterwards",
    "lk-ramp-when-standing": "afterwards",
    "lk-no-torque-ignored": "afterwards",
    "lk-phases-told-while-off": "afterwards",
    "lk-torque-told-after-stop": "afterwards",
    "lk-run-without-data-repeats": "afterwards",
    "lk-gains-lost-by-stop": "kept",
    "lk-gains-lost-by-off": "kept",
    "lk-limit-lost-by-clearing": "kept",
    "lk-voltage-capped": "kept",
    "lk-temperature-capped": "kept",
    "lk-flags-read-away": "kept",
    "lk-clear-turns-to-zero": "kept",
    "lk-stop-unchecked": "wrong heads",
    "lk-clear-turns-unchecked": "wrong heads",
    "lk-clear-errors-unchecked": "wrong heads",
    "lk-phases-doubled": "phases",
    "lk-ramp-fast": "multi-turn",
    "lk-ramp-slow": "multi-turn",
    "lk-overshoot": "multi-turn",
    "lk-stops-short": "multi-turn",
    "lk-stop-is-off": "stop",
    "lk-stop-coasts": "stop",
    "lk-stop-ignored": "stop",
    "lk-stop-clears-turns": "stop",
    "lk-off-still-moves": "off",
    "lk-off-keeps-running": "off",
    "lk-off-ignored": "off",
    "lk-on-needed-twice": "off",
    "lk-on-resumes": "off",
    "lk-off-at-power-up": "speed",
    "lk-brake-without-effect": "brake",
    "lk-brake-backwards": "brake",
    "lk-clear-errors-always": "errors",
    "lk-clear-errors-never": "errors",
    "lk-set-position-ignored": "position and power",
    "lk-set-position-kept": "position and power",
    "lk-clear-turns-ignored": "turns",
    "lk-zero-at-once": "zero",
    "lk-zero-lost": "zero",
    "lk-parameter-not-stored": "gains",
    "lk-parameter-elsewhere": "gains",
    "lk-parameter-survives": "parameters and power",
    "lk-ms-runs-torque": "other models",
    "lk-runs-open-loop": "other models",
    "lk-obeys-other-address": "strangers",
    "lk-obeys-wrong-data-sum": "strangers",
    "lk-obeys-wrong-head-sum": "strangers",
    "lk-stop-keeps-torque": "ended torque",
    "lk-stop-keeps-moves": "ended move",
    "lk-stop-needs-on": "ended move",
    "lk-off-keeps-torque": "ended torque",
    "lk-state-2-cold": "readings",
    "lk-state-3-cold": "phases",
    "lk-motion-cold": "speed",
    "lk-motion-temperature-first": "over others",
    "lk-motion-encoder-stale": "over others",
    "lk-motion-current-stale": "over others",
    "lk-motion-speed-0": "stop",
    "lk-motion-encoder-raw": "speed",
    "lk-cleared-no-voltage": "errors",
    "lk-supply-current-swapped": "readings",
    "lk-reads-silent-moving": "readings",
    "lk-reads-unfit-moving": "readings",
    "lk-off-while-turning": "readings",
    "lk-stalled-while-turning": "readings",
    "lk-zero-not-told": "zero",
    "lk-single-turn-shifted": "turns",
    "lk-single-turn-36000": "whole turns",
    "lk-single-turn-36000-turned": "whole turns",
    "lk-whole-turns-ignored": "lengths",
    "lk-fast-moves-long": "lengths",
    "lk-clear-turns-upward": "lengths",
    "lk-torque-limit-of-runs-alone": "changed",
    "lk-torque-half-range": "highest torque",
    "lk-max-speed-kept": "changed",
    "lk-ramp-steep-turning-round": "changed",
    "lk-ramp-steep-slowing": "changed",
    "lk-brake-lost-while-turning": "changed",
    "lk-late-while-turning": "changed",
    "lk-errors-kept-while-off": "wide zero",
    "lk-zero-short": "wide zero",
}


def model_of(script: str, fault: str = "") -> str:
    return "MS" if script in MS_SCRIPTS or fault == "lk-ms-runs-torque" else "MF"


def played(script: str, model: str, *faults: Fault) -> list[list[tuple[int, str]]]:
    bench = Bench(model=model, faults=faults)
    SCRIPTS[script](bench)
    return bench.trace


def test_each_fault_has_its_exchange() -> None:
    names = [fault.name for fault in FAULTS]
    assert len(names) == len(set(names)) >= 30
    assert set(SHOWN_BY) == set(names)
    assert set(SHOWN_BY.values()) <= set(SCRIPTS)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f.name)
def test_fault_shows(fault: Fault) -> None:
    script = SHOWN_BY[fault.name]
    model = model_of(script, fault.name)
    assert played(script, model) == played(script, model)
    assert played(script, model, fault) != played(script, model)


@pytest.mark.parametrize("model", ["MF", "MS"])
def test_no_fault_makes_a_drive_raise(model: str) -> None:
    chance = random.Random(model)
    for fault in [f for f in every_fault() if "lk-rs485" in f.dialects]:
        bench = Bench(model=model, faults=(fault,))
        for _ in range(30):
            if chance.random() < 0.1:
                chance.choice([bench.drive.block, partial(bench.drive.hot, 300), partial(bench.drive.supply, 5)])()
            bench.send(any_request(chance, bench.drive.dialect)[0])
            bench.t_ns += chance.choice([0, STEP_NS, SECOND])
            bench.drive.advance(bench.t_ns)


def test_no_two_faults_are_one() -> None:
    """Over all exchanges, two faults differ somewhere; those that differ already are not played again."""
    alike = [list(FAULTS)]
    for name in SCRIPTS:
        shown = defaultdict(list)
        for number, group in enumerate(alike):
            for fault in group:
                shown[number, repr(played(name, model_of(name, fault.name), fault))].append(fault)
        alike = [group for group in shown.values() if len(group) > 1]
    assert alike == []


def test_faults_of_one_drive_are_not_those_of_another() -> None:
    faulty, good = Bench(faults=FAULTS[:1]), Bench()
    readings(faulty)
    readings(good)
    assert good.trace == played("readings", "MF")
    assert faulty.trace != good.trace
