"""Every fault shows to a host: a claim refutes it, or its drive and the conforming drive answer one story differently."""

from __future__ import annotations

import random

import pytest

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.codec import codec
from analyzer.encoder import build
from conformance.drives.drive import Fault
from conformance.drives.make import every_fault
from conformance.drives.mks.quirks import QUIRKS
from tests.conformance.claims.test_refuted import pairs
from tests.conformance.drives.mks_story import differs
from tests.conformance.drives.test_mks_rig import MS, NAMES, SECOND, frame_of, make

#: The faults that an MKS drive can have; those of the wire are faults of any drive.
FAULTS = [fault for fault in every_fault() if not set(fault.dialects).isdisjoint(NAMES)]
#: The others are shown by the claims that refute them.
REFUTED = pairs()
FAULTY = [(f, name) for f in FAULTS for name in NAMES if name in f.dialects and (name, f.name) not in REFUTED]


@pytest.mark.parametrize("name", NAMES)
def test_the_story_is_the_same_every_time(name):
    assert not differs(name)


@pytest.mark.parametrize(("fault", "name"), FAULTY, ids=[f"{f.name}-{n}" for f, n in FAULTY])
def test_a_fault_changes_what_is_seen(fault, name):
    assert differs(name, faults=(fault,)), "no claim of REFUTES refutes it, and no chapter of mks_story shows it"


# --- all of them at once ---------------------------------------------------------------------------------------------


def any_request(chance, dialect):
    """Return the bytes and the address of a request with any values, most of them good."""
    command = chance.choice(dialect.commands)
    form = chance.choice(command.request_forms)
    data = chance.randbytes(chance.choice([50, chance.randint(0, 60)]))
    if command.slots is None:
        values = {}
        for name, field in form.layout.named.items():
            good = [v for v in (field.low, field.high, 5, 100, *field.choice_names) if field.allows(v)]
            wild = chance.randint(field.wire_minimum, field.wire_maximum)
            values[name] = chance.choice(good) if good and chance.random() < 0.8 else wild
            if field.fixed is not None:
                values[name] = field.fixed
        data = codec(form.layout).encode(values)
    address = chance.choice([1] * 8 + [0, 80, 2, 255])
    return dialect.link.build(command, form, address, data, Role.REQUEST), address


@pytest.mark.parametrize("name", NAMES)
def test_no_fault_makes_a_drive_raise(name):
    chance = random.Random(name)
    for change in [c for c in (*FAULTS, *QUIRKS) if name in c.dialects]:
        chosen = {"faults": (change,)} if isinstance(change, Fault) else {"quirks": (change,)}
        drive, now = make(name, group_address=80, **chosen), 0
        drive.place_switch("left", -3000)
        for _ in range(40):
            data, address = any_request(chance, drive.dialect)
            drive.receive(frame_of(drive.dialect, data, now, address if name == "mks-can" else None), now)
            now += chance.choice([0, 1, MS, SECOND])
            while (due := drive.next_ns()) is not None and due <= now:
                drive.advance(due)
            drive.advance(now)


def test_the_faults_of_the_wire_serve_the_lingkong_drive_too():
    from conformance.drives.lk.drive import LkDrive

    dialect = dialects.get("lk-rs485")
    asked = ("read_state_1", "read_state_2", "motor_off", "read_encoder", "motor_on")
    # The last request comes after a pause, which some faults need.
    times = [n * SECOND for n in (0, 1, 2, 3, 20)]
    requests = [(t_ns, build(dialect, command, 1)) for t_ns, command in zip(times, asked, strict=True)]

    def seen(**options):
        drive = LkDrive(dialect, 1, **options)
        return [[(o.at_ns, o.data) for o in drive.receive(frame_of(dialect, d, t, None), t)] for t, d in requests]

    plain = seen()
    assert all(plain)
    serving = [fault for fault in FAULTS if "lk-rs485" in fault.dialects]
    assert len(serving) >= 10
    for fault in serving:
        assert seen(faults=(fault,)) != plain, fault.name


# --- the tables ------------------------------------------------------------------------------------------------------


def test_there_are_faults_of_every_theme():
    themes = {fault.breaks for fault in FAULTS}
    assert len(FAULTS) >= 75
    assert themes >= {
        "checksum", "address", "broadcast", "group", "code", "head", "length", "byte order", "sign", "width", "scale",
        "limit", "choice", "stored", "restart", "restore", "completion", "respond", "package", "ramp", "direction", "stop",
        "frozen", "homing", "byte count", "quantity", "echo", "exception", "read-back", "time", "lost", "shape",
    }  # fmt: skip


def test_faults_and_quirks_of_one_drive_leave_others_alone():
    noisy = make("mks-rs485", faults=FAULTS[:3])
    plain = make("mks-rs485")
    assert noisy.hooks.reply
    assert not plain.hooks.reply
    assert plain.behaviours.keys() == noisy.behaviours.keys()
