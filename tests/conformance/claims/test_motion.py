"""Claims about motion: nothing is refuted of drives as the manuals have them, and each fault by the claim that is about it."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Risk
from conformance.claim import Claim, Outcome, Theme, Verdict
from conformance.claims.settings.link_changes import SETTLE_NS, change_address
from conformance.drives import make
from conformance.drives.drive import Drive
from conformance.gate.gate import Allowance
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.acceptance import answers
from tests.conformance.theme_runs import claims_of

DRIVES = ("mks-rs485@1", "mks-modbus@1", "mks-can@1,model=42E", "lk-rs485@1,model=MF")
#: Claims in which models differ, by drive.
MODELS = (
    ("mks-rs485@1,model=57D", "set_limit_remap/"),
    ("mks-can@1,model=57E", "set_home/end-limit"),
    ("lk-rs485@1,model=MS", "run_"),
    ("lk-rs485@1,model=MG", "read_encoder/"),
    ("lk-rs485@1,model=MH", "run_torque/"),
)


def run(drive: str, wanted: str = "") -> list[Verdict]:
    """Run the claims whose names begin so."""
    rig = EmulatedRig(make.parse(drive))
    return list(engine.run([c for c in every(rig) if name(c).startswith(wanted)], rig))


_made: dict[tuple[str, str], list[Claim]] = {}


def every(rig: EmulatedRig) -> list[Claim]:
    """Return the claims about a rig's drive; made once for each dialect and model."""
    dialect, model = rig.dialect, rig.dialect.model
    key = (dialect.name, model)
    if key not in _made:
        _made[key] = claims_of(Theme.MOTION, rig)
    return _made[key]


def name(claim: Claim) -> str:
    """Return the id of a claim without its dialect and theme."""
    return claim.id.split("/", 2)[2]


def judge(drive: str, what: str) -> Verdict:
    """Run one claim by its name."""
    rig = EmulatedRig(make.parse(drive))
    return engine.run_claim(next(c for c in every(rig) if name(c) == what), rig)


@pytest.mark.parametrize(("drive", "wanted"), MODELS)
def test_other_models_confirm_what_is_about_them(drive, wanted):
    verdicts = run(drive, wanted)
    assert verdicts
    assert [v.claim.id for v in verdicts if v.outcome is not Outcome.CONFIRMED] == []


@pytest.mark.parametrize("drive", DRIVES)
def test_every_claim_names_its_command_its_section_and_its_risks(drive):
    for claim in every(EmulatedRig(make.parse(drive))):
        assert claim.section, claim.id
        assert claim.id.endswith("other-models") or (claim.covers and claim.commands), claim.id


#: Fault -> the claim that refutes it, in each dialect that has both.
MKS = (
    # Where moves end, and which way
    ("move-pulses-doubled", "move_relative_pulses/distance"),
    ("absolute-pulses-as-counts", "move_absolute_pulses/distance"),
    ("axis-as-pulses", "move_absolute_axis/sign"),
    ("move-ends-short", "move_relative_axis/distance"),
    ("move-ends-beyond", "move_absolute_axis/reads-as-asked"),
    ("relative-as-absolute", "move_relative_axis/again"),
    ("absolute-as-relative", "move_absolute_axis/same-place"),
    ("negative-positions-cut", "move_relative_axis/opposite"),
    ("overshoot", "move_absolute_pulses/within"),
    ("relative-axis-direction-wrong", "move_relative_axis/sign"),
    ("absolute-axis-direction-wrong", "move_absolute_axis/sign"),
    ("absolute-pulses-direction-wrong", "move_absolute_pulses/reads-as-asked"),
    ("relative-pulses-direction-wrong", "run_speed/same-sense"),
    ("run-direction-wrong", "run_speed/same-sense"),
    ("run-direction-ignored", "run_speed/opposite"),
    ("direction-setting-ignored", "set_direction/and-the-bus"),
    ("direction-setting-turns-bus", "set_direction/and-the-bus"),
    # Speeds
    ("speed-5-percent-high", "run_speed/speed-60"),
    ("speed-8-bit", "move_relative_pulses/crossed-speed"),
    ("speed-ignores-subdivision", "set_subdivision/speed-at-128"),
    ("speed-scaled-at-32", "set_subdivision/speed-at-32"),
    ("mode-limit-ignored", "run_speed/highest-sr_open"),
    ("speed-2800-at-most", "run_speed/crossed-speed"),
    ("speed-3000-refused", "move_absolute_pulses/crossed-taken"),
    ("home-speed-low-byte", "home/turns"),
    ("home-direction-not-stored", "home/turns"),
    # Newer motion, stops, enabling
    ("update-ignored", "move_absolute_axis/takes-over"),
    ("update-stops-first", "move_absolute_axis/update-without-stop"),
    ("newer-move-ignored", "move_absolute_axis/takes-over"),
    ("stop-without-ramp", "stop_speed/by-ramp"),
    ("stop-by-slowest-ramp", "stop_relative_axis/at-once"),
    ("stop-coasts", "stop_absolute_axis/by-ramp"),
    ("speed-stop-ignored", "stop_speed/at-once"),
    ("move-stop-ignored", "stop_relative_pulses/by-ramp"),
    ("newer-target-refused", "move_absolute_axis/takes-over"),
    ("pulses-signed", "move_relative_pulses/widest"),
    ("off-refused-while-turning", "enable/off-ends-motion"),
    ("zero-ignored-while-turning", "set_zero/while-turning"),
    ("status-turned-about-clockwise", "read_status/follows"),
    ("alarm-never", "read_io/stall"),
    ("in-2-dead", "read_io/shows-enable-pin"),
    ("emergency-stop-ignored", "emergency_stop/ends-run_speed"),
    ("emergency-stop-ramps", "emergency_stop/ends-move_absolute_axis"),
    ("disable-ignored", "enable/is-read"),
    ("enabled-inverted", "enable/is-read"),
    ("enabled-frozen", "enable/is-read"),
    ("disabled-moves", "move_relative_axis/disabled"),
    ("pulse-mode-moves", "run_speed/pulse-mode"),
    # Replies
    ("completion-missing", "move_relative_axis/replies"),
    ("completion-doubled", "move_relative_pulses/replies"),
    ("completion-says-3", "move_absolute_axis/replies"),
    ("completion-too-early", "move_absolute_pulses/told-when-there"),
    ("interim-and-completion-swapped", "move_relative_axis/replies"),
    ("stop-completion-early", "stop_relative_axis/told-when-standing"),
    ("stop-completion-missing", "stop_speed/replies"),
    ("superseded-completes-too", "move_absolute_axis/superseded"),
    ("run-status-2", "run_speed/crossed-replies"),
    ("respond-ignored", "set_respond/0-silences-run_speed"),
    ("respond-silences-all", "set_respond/0-leaves-reads"),
    ("respond-silences-emergency", "set_respond/0-leaves-reads"),
    ("active-ignored", "set_respond/inactive-move_relative_axis"),
    ("active-silences-first", "set_respond/inactive-stop_speed"),
    # The status
    ("status-frozen", "read_status/crossed"),
    ("status-stale", "read_status/follows"),
    ("status-up-and-down-swapped", "read_status/slowing-down"),
    ("status-outside-list", "read_status/standing"),
    ("homing-as-running", "home/status"),
    ("calibrating-as-homing", "calibrate/status"),
    # What is read
    ("position-sign-turned", "read_encoder_carry/standing"),
    ("position-half-width", "read_position/wide"),
    ("position-doubled", "read_position/turn"),
    ("carry-cut-to-zero", "read_encoder_carry/standing"),
    ("carry-too-late", "read_encoder_carry/at-the-carry"),
    ("speed-sign-turned", "read_speed/crossed"),
    ("speed-doubled", "read_speed/crossed"),
    ("pulses-frozen", "read_pulses/counts-moves"),
    ("angle-error-in-counts", "read_angle_error/held-+0_25"),
    ("angle-error-half-width", "read_angle_error/held--1_5"),
    # Zero, homing, limits, protection, power
    ("set-zero-ignored", "set_zero/position"),
    ("set-zero-pulses-only", "set_zero/and-move_absolute_axis"),
    ("home-lies", "home/finds-switch-cw"),
    ("home-sets-no-zero", "home/zero"),
    ("home-wrong-way", "home/finds-switch-ccw"),
    ("home-speed-ignored", "home/speed-120"),
    ("home-return-ignored", "home/without-switch-cw-1000"),
    ("home-mode-ignored", "home/without-switch-ccw-3000"),
    ("home-trigger-not-stored", "home/trigger"),
    ("home-keeps-the-shaft", "home/end-limit"),
    ("home-completion-missing", "home/replies"),
    ("home-begins-with-2", "home/replies"),
    ("end-limit-ignored", "set_home/end-limit-stops-move_relative_axis"),
    ("limit-stop-says-2", "set_home/end-limit-told-move_relative_axis"),
    ("limit-remap-ignored", "set_limit_remap/right-on"),
    ("protection-ignored", "set_protection/lets-go"),
    ("protection-hidden", "set_protection/lets-go"),
    ("protection-inverted", "read_protection/at-first"),
    ("release-ignored", "release_protection/releases"),
    ("protected-moves", "run_speed/protected"),
    ("stall-tolerance-ignored", "set_stall_tolerance/angle"),
    ("zero-mode-ignored", "set_zero_mode/near"),
    ("zero-direction-ignored", "set_zero_mode/direction-ccw"),
    ("zero-status-frozen", "read_zero_status/tells"),
    ("restart-lies", "restart/ends-motion"),
    ("calibration-without-interim", "calibrate/replies"),
)
LK = (
    ("lk-asked-speed-tenfold", "run_speed/speed-10"),
    ("lk-asked-speed-int16", "run_speed/speed-360"),
    ("lk-speed-inverted", "run_speed/sign"),
    ("lk-asked-speed-sign-lost", "run_speed/opposite"),
    ("lk-speed-sign-lost", "read_state_2/crossed"),
    ("lk-target-tenfold", "move_multi_turn/reaches"),
    ("lk-position-int32", "set_position/counts-on"),
    ("lk-multi-turn-relative", "move_multi_turn_limited/absolute"),
    ("lk-increment-absolute", "move_increment/adds-up"),
    ("lk-increment-sign-lost", "move_increment_limited/reaches"),
    ("lk-single-turn-inverted", "move_single_turn/clockwise"),
    ("lk-single-turn-shortest", "move_single_turn_limited/two-ways"),
    ("lk-max-speed-ignored", "move_increment_limited/max-speed"),
    ("lk-stops-short", "move_single_turn/reaches"),
    ("lk-off-still-moves", "move_increment/while-off"),
    ("lk-silent-while-off", "run_speed/while-off"),
    ("lk-off-keeps-running", "motor_off/ends-motion"),
    ("lk-state-always-on", "motor_off/is-read"),
    ("lk-on-resumes", "motor_on/does-not-resume"),
    ("lk-on-needed-twice", "motor_on/obeys"),
    ("lk-off-at-power-up", "motor_on/at-power-up"),
    ("lk-stop-ignored", "stop/stops"),
    ("lk-stop-is-off", "stop/stays-on"),
    ("lk-stop-clears-turns", "stop/keeps-turns"),
    ("lk-brake-without-effect", "brake/holds"),
    ("lk-brake-state-inverted", "brake/is-read"),
    ("lk-brake-read-releases", "brake/read-only"),
    ("lk-torque-half", "read_state_2/crossed"),
    ("lk-error-bits-shifted", "read_state_1/flag-motor_hot"),
    ("lk-clear-errors-never", "clear_errors/clears"),
    ("lk-clear-errors-always", "clear_errors/keeps"),
    ("lk-voltage-tenth", "read_state_1/voltage"),
    ("lk-temperature-unsigned", "read_state_1/follows-temperature"),
    ("lk-phases-in-step", "read_state_3/crossed"),
    ("lk-encoder-not-offset", "read_encoder/below-offset"),
    ("lk-encoder-coarse", "read_state_2/encoder"),
    ("lk-single-turn-runs-on", "read_single_turn/within-turn"),
    ("lk-position-single-turn", "set_position/counts-on"),
    ("lk-clear-turns-ignored", "clear_turns/drops-turns"),
    ("lk-set-position-kept", "set_position/lost"),
    ("lk-zero-lost", "set_zero/at-power-up"),
    ("lk-runs-open-loop", "run_open_loop/other-models"),
    ("lk-stop-keeps-torque", "run_torque/crossed-stopped"),
    ("lk-stop-keeps-moves", "move_single_turn_limited/crossed-stopped"),
    ("lk-stop-needs-on", "move_multi_turn/crossed-ends"),
    ("lk-off-keeps-torque", "run_torque/crossed-stopped"),
    ("lk-state-2-cold", "read_state_2/temperature"),
    ("lk-state-3-cold", "read_state_3/temperature"),
    ("lk-motion-cold", "move_multi_turn/crossed-tells"),
    ("lk-motion-speed-0", "move_increment_limited/crossed-tells"),
    ("lk-motion-encoder-raw", "run_torque/crossed-tells"),
    ("lk-cleared-no-voltage", "clear_errors/tells-state"),
    ("lk-supply-current-swapped", "read_state_1/current-at-rest"),
    ("lk-off-while-turning", "read_state_1/crossed"),
    ("lk-stalled-while-turning", "read_state_1/crossed"),
    ("lk-zero-not-told", "set_zero/offset"),
    ("lk-single-turn-shifted", "read_single_turn/is-encoder"),
    ("lk-single-turn-36000", "read_single_turn/within-turn"),
    ("lk-single-turn-36000-turned", "read_single_turn/within-turn"),
    ("lk-run-limit-clockwise-only", "write_parameter/speed-limit-run_speed-each-way"),
    ("lk-whole-turns-ignored", "move_increment/crossed-ends"),
    ("lk-fast-moves-long", "move_multi_turn_limited/crossed-ends"),
    ("lk-clear-turns-upward", "clear_turns/drops-turns"),
    ("lk-turns-kept-while-turning", "clear_turns/while-turning"),
    ("lk-stop-ignored-backwards", "run_speed/crossed-stopped"),
    ("lk-stop-drops-turns-of-a-run", "stop/keeps-turns"),
    ("lk-off-drops-turns-of-a-run", "motor_off/keeps-turns"),
    ("lk-clear-errors-turns-off", "clear_errors/tells-state"),
    ("lk-cleared-state-always-on", "clear_errors/tells-state"),
    ("lk-phases-doubled", "read_state_3/crossed"),
    ("lk-torque-limit-of-runs-alone", "write_parameter/torque-limit-move_increment"),
    ("lk-torque-half-range", "run_torque/to-its-end"),
    ("lk-run-no-faster-below", "run_speed/changes"),
    ("lk-speed-limit-below-only", "write_parameter/speed-limit-move_increment-each-way"),
    ("lk-angle-limit-above-only", "write_parameter/angle-limit-move_multi_turn-each-way"),
    ("lk-torque-limit-late", "write_parameter/torque-limit-at-once-run_torque"),
    ("lk-max-speed-kept", "move_multi_turn/own-speed"),
    ("lk-brake-lost-while-turning", "brake/holds-turning"),
    ("lk-errors-kept-while-off", "clear_errors/clears-off"),
    ("lk-zero-short", "set_zero/offset"),
)


def _with_fault() -> list[tuple[str, str, str]]:
    """Return drive, fault and claim of each pair, in the first dialect that has the fault and in Modbus."""
    dialects = {fault.name: fault.dialects for fault in make.every_fault()}
    rows = []
    for fault, claim in (*MKS, *LK):
        for dialect in [d for d in DRIVES if d.split("@")[0] in dialects[fault]][:2]:
            rows.append((dialect, fault, claim))
    return rows


@pytest.mark.parametrize(("drive", "fault", "claim"), _with_fault())
def test_a_fault_is_refuted_by_the_claim_about_it(drive, fault, claim):
    if not any(name(c) == claim for c in every(EmulatedRig(make.parse(drive)))):
        assert drive.startswith("mks-modbus"), "Modbus tells no completion and has no 8C and 94; all others have the claim"
        return
    verdict = judge(f"{drive},fault={fault}", claim)
    assert (verdict.outcome, verdict.reason) == (Outcome.REFUTED, verdict.reason)
    assert verdict.expected
    assert verdict.got


@pytest.mark.parametrize(
    ("fault", "claim"),
    [
        ("lk-increment-lost-in-a-run", "move_increment/takes-over"),
        ("lk-run-lost-in-a-move", "run_speed/takes-over"),
        ("lk-move-lost-in-a-torque", "move_multi_turn/takes-over"),
        ("lk-single-turn-lost-backwards", "move_single_turn/takes-over"),
        ("lk-single-turn-frozen-backwards", "read_single_turn/crossed"),
        ("lk-encoder-frozen-turning", "read_encoder/crossed"),
        ("lk-voltage-capped", "read_state_1/voltage"),
        ("lk-temperature-capped", "read_state_2/follows-temperature"),
        ("lk-flags-read-away", "clear_errors/clears"),
        ("lk-clear-turns-to-zero", "clear_turns/keeps-angle"),
    ],
)
def test_what_an_lk_drive_does_and_tells_in_motion_is_judged(fault, claim):
    assert judge(f"lk-rs485@1,model=MF,fault={fault}", claim).outcome is Outcome.REFUTED


@pytest.mark.parametrize(
    ("fault", "claim"),
    [("lk-overshoot", "move_increment/within"), ("lk-stop-coasts", "stop/brakes"), ("lk-zero-at-once", "set_zero/not-at-once")],
)
def test_what_the_lk_manual_leaves_open_is_observed(fault, claim):
    verdict = judge(f"lk-rs485@1,fault={fault}", claim)
    assert (verdict.outcome, verdict.expected != "") == (Outcome.OBSERVED, True)


@pytest.mark.parametrize(
    ("fault", "claim", "text"),
    [
        ("lk-speed-limit-ignored", "speed-limit-run_speed-each-way", "the speed limit does not hold for run_speed"),
        ("lk-angle-limit-ignored", "angle-limit-move_multi_turn-each-way", "the angle limit does not hold for move_multi_turn"),
        ("lk-torque-limit-ignored", "torque-limit-move_increment", "a run turns the shaft with a torque limit of 0"),
    ],
)
def test_a_limit_of_lk_that_never_holds_is_observed(fault, claim, text):
    verdict = judge(f"lk-rs485@1,fault={fault}", f"write_parameter/{claim}")
    assert (verdict.outcome, verdict.reason) == (Outcome.OBSERVED, text)


def test_a_move_within_bounds_is_all_that_a_bounded_run_sends():
    """A claim that needs more than is allowed is not run, and says why."""
    allowed = frozenset({Risk.SETTING, Risk.MOTION, Risk.TORQUE})
    rig = EmulatedRig(make.parse("mks-rs485@1"), allowance=Allowance(allowed, speed=300, turns=2, subdivision=16))
    chosen = {name(c): c for c in every(rig)}
    assert engine.run_claim(chosen["move_relative_axis/distance"], rig).outcome is Outcome.CONFIRMED
    assert engine.run_claim(chosen["move_relative_axis/crossed-ends"], rig).outcome is Outcome.CONFIRMED
    beyond = engine.run_claim(chosen["move_relative_axis/told-when-there"], rig)
    assert beyond.outcome is Outcome.NOT_RUN
    assert "rpm" in beyond.reason
    unbounded = engine.run_claim(chosen["run_speed/speed-60"], rig)
    assert unbounded.outcome is Outcome.NOT_RUN
    assert "unbounded" in unbounded.reason


class TurnedBefore(EmulatedRig):
    """A rig whose drives have turned for long before a claim, as a real one has."""

    def make_drive(self) -> Drive:
        drive = super().make_drive()
        drive.turn_shaft(300 * 16384 + 5000)
        return drive


@pytest.mark.parametrize("fault", ["carry-half-width", "carry-without-sign"])
def test_a_carry_is_looked_at_about_zero_wherever_the_shaft_is(fault):
    rig = TurnedBefore(make.parse(f"mks-rs485@1,fault={fault}"))
    claim = next(c for c in every(rig) if name(c) == "read_encoder_carry/at-the-carry")
    assert engine.run_claim(claim, rig).outcome is Outcome.REFUTED


def test_a_change_of_the_link_is_waited_for_until_the_drive_answers():
    rig = EmulatedRig(make.parse("mks-rs485@1"))
    rig.quiet_ns = 0
    probe = rig.probe(every(rig)[0])
    begun_ns = probe.gate.now_ns()
    change_address(probe, probe.command("set_address"), 7)
    assert answers(probe, 7)
    assert probe.gate.now_ns() - begun_ns < SETTLE_NS
