"""The theme framing: bad frames are ignored, good ones behind them are not."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from analyzer import dialects, encoder
from analyzer.catalogue import Role
from analyzer.records import Frame, Message
from conformance.claim import Outcome, Theme
from conformance.drives import make
from conformance.drives.drive import Drive, Fault
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.garbling import Garbler, harmless
from tests.conformance.theme_runs import claims_of, refuted, run


def test_a_claim_of_which_no_variant_can_be_sent_does_not_confirm_itself():
    rig = EmulatedRig(make.parse("mks-rs485@255"))
    (claim,) = claims_of(Theme.FRAMING, rig, ("other_dialect/ignored",))
    verdict = engine.run_claim(claim, rig)
    assert (verdict.outcome, "no frame of this kind" in verdict.reason) == (Outcome.NOT_RUN, True)


def test_a_drive_that_is_deaf_behind_a_bad_frame_is_refuted_by_what_is_asked_next_alone():
    found = refuted(Theme.FRAMING, "mks-modbus@1,fault=deaf-after-bad-frame", "checksum", "flipped", "unknown_code")
    assert {"checksum_bit/next", "checksum_value/next"} <= found
    assert all(name.endswith("/next") for name in found)


def test_a_motion_of_another_length_is_not_to_be_executed():
    def setup(drive: Drive) -> None:
        responder, read = drive.responder, drive.responder.read

        def lenient(frame: Frame) -> Message:
            message = read(frame)
            if message.command is None or message.form is not None:
                return message
            form, link = message.command.request_forms[0], drive.dialect.link
            size = form.layout.byte_length
            data = message.data[:size].ljust(size, b"\0")
            return read(replace(frame, data=link.build(message.command, form, drive.address, data, Role.REQUEST)))

        responder.read = lenient  # type: ignore[method-assign]

    fault = Fault("lenient", ("lk-rs485",), "any length is taken", "length", lambda hooks: hooks.setup.append(setup))
    names = {"run_speed/other-length", "motor_off/other-length"}
    assert refuted(Theme.FRAMING, "lk-rs485@1,model=MF", *names, fault=fault) == names


@pytest.mark.parametrize("fault", ["lost-reply", "first-reply-only", "flaky-checksum"])
def test_a_line_that_loses_replies_is_not_called_deaf(fault):
    assert refuted(Theme.FRAMING, f"mks-rs485@1,fault={fault}") == set()


def test_how_long_a_frame_may_pause_is_observed_and_measured():
    verdict = run(Theme.FRAMING, "mks-rs485@1", "pieces/answered")["pieces/answered"]
    assert verdict.outcome is Outcome.OBSERVED
    assert verdict.measured["longest_pause_in_a_frame_ms"] == 16


def test_codes_of_other_firmware_are_named_as_known():
    verdicts = run(Theme.FRAMING, "lk-rs485@1,quirk=lk-firmware-235", "unknown_code/")
    verdict = verdicts["unknown_code/ignored"]
    assert (verdict.outcome, verdict.quirks) == (Outcome.REFUTED, ("lk-firmware-235",))


def test_garbled_frames_are_built_from_reads_alone():
    dialect = dialects.get("mks-rs485")
    with pytest.raises(ValueError, match="built from a read"):
        Garbler(dialect, encoder.assemble(dialect, "run_speed", 1, {"speed": 60}))


@pytest.mark.parametrize("dialect", ["mks-rs485", "mks-modbus", "mks-can", "lk-rs485"])
def test_every_variant_reads_as_nothing_but_a_read(dialect):
    spoken = dialects.get(dialect)
    made = Garbler(spoken, encoder.assemble(spoken, "read_position", 1))
    several = [*made.check_bits(), *made.body_bits(), *made.wrong_checks(), *made.truncated(), *made.overlong()]
    assert len(several) > 10
    assert len({item if isinstance(item, bytes) else item.data for _, item in several}) > 10
    assert all(harmless(item, 1) for _, item in several)
    assert len({what for what, _ in made.check_bits()}) == (16 if dialect == "mks-modbus" else 8)
