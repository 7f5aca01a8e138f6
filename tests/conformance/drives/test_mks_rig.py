"""What the tests of the MKS drives share: one drive and its host in virtual time, and what the analyzer says of them."""

from __future__ import annotations

from collections.abc import Iterable

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.codec import codec
from analyzer.encoder import build
from analyzer.link import CanLink
from analyzer.records import CanFrame, Chunk, Frame
from conformance.drives.drive import Outgoing
from conformance.drives.mks.drive import MksDrive
from tests.collect import Collect, run

MS = 1_000_000
SECOND = 1_000_000_000
MINUTE = 60 * SECOND
COUNTS = 16384

NAMES = ("mks-rs485", "mks-modbus", "mks-can")
#: The work mode in which the bus runs the motor in a closed loop up to 3000 rpm: the same number in every dialect.
BUS_MODE = 5
MODELS = {name: dialects.get(name).models for name in NAMES}


def make(
    name: str, address: int = 1, *, model: str = "", mode: int | None = BUS_MODE, quirks=(), faults=(), **given
) -> MksDrive:
    """Return a drive of a dialect, ready for motion by the bus unless `mode` says otherwise (None: its default)."""
    settings = given if mode is None else {"work_mode": mode} | given
    return MksDrive(dialects.get(name), address, model=model, settings=settings, quirks=quirks, faults=faults)


def frame_of(drive_dialect, data: bytes, t_ns: int, can_id: int | None) -> Frame:
    can = CanFrame(t_ns, "bus", can_id, data) if can_id is not None else None
    good = all(c.ok for c in drive_dialect.link.checks(data, can_id))
    return Frame("bus", t_ns, t_ns, 0, data, drive_dialect, Role.REQUEST, good, can)


class Rig:
    """A drive and its host. `heard`: all replies, in order; `log`: all frames both ways, for the analyzer."""

    def __init__(self, drive: MksDrive | str, **options) -> None:
        self.drive = make(drive, **options) if isinstance(drive, str) else drive
        self.now = 0
        self.heard: list[Outgoing] = []
        self.log: list[tuple[int, str, bytes, int | None]] = []

    @property
    def can(self) -> bool:
        return isinstance(self.drive.dialect.link, CanLink)

    # --- talking --------------------------------------------------------------------------------------------------

    def send(self, data: bytes, can_id: int | None = None, *, dialect=None) -> list[Outgoing]:
        """Send bytes now; return what the drive says at once."""
        if self.can and can_id is None:
            can_id = self.drive.address
        self.log.append((self.now, "request", data, can_id))
        frame = frame_of(dialect or self.drive.dialect, data, self.now, can_id)
        return self._keep(self.drive.receive(frame, self.now))

    def ask(self, command: str, address: int | None = None, **values) -> list[dict]:
        """Send a command; return the values of what the drive says at once, then let 5 ms pass."""
        dialect = self.drive.dialect
        to = self.drive.address if address is None else address
        data = build(dialect, command, to, values)
        said = self.send(data, to if self.can else None)
        return [self.values(o, dialect, command) for o in said + self.wait(5 * MS)]

    def send_at(self, command: str, **values) -> list[Outgoing]:
        """Send a command to the drive; return what it says at once, and let no time pass."""
        return self.send(build(self.drive.dialect, command, self.drive.address, values))

    def value(self, command: str, name: str = "", **values) -> int:
        """Send a read; return one value of its reply."""
        (reply,) = self.ask(command, **values)
        return reply[name or next(iter(reply))]

    def status(self, command: str, **values) -> int | str | None:
        """Send a command; return the status of its first reply, in the native words; None for silence."""
        replies = self.ask(command, **values)
        return replies[0].get("status") if replies else None

    def axis(self) -> int:
        return self.value("read_position")

    def wait(self, duration_ns: int) -> list[Outgoing]:
        """Let time pass event by event; return what the drive says meanwhile."""
        end = self.now + duration_ns
        said = []
        while (due := self.drive.next_ns()) is not None and due <= end:
            assert due >= self.now
            self.now = due
            said += self._keep(self.drive.advance(due))
        self.now = end
        return said + self._keep(self.drive.advance(end))

    def wait_values(self, duration_ns: int) -> list[dict]:
        return [self.values(o, self.drive.dialect, None) for o in self.wait(duration_ns)]

    def _keep(self, said: Iterable[Outgoing]) -> list[Outgoing]:
        said = list(said)
        self.heard += said
        self.log += [(o.at_ns, "reply", o.data, o.can_id) for o in said]
        return said

    # --- understanding --------------------------------------------------------------------------------------------

    def values(self, outgoing: Outgoing, dialect=None, command: str | None = None) -> dict:
        """Return the values of a reply; Modbus echoes as the status that they mean (1 done, 0 refused)."""
        dialect = dialect or self.drive.dialect
        head = dialect.link.parse(outgoing.data, outgoing.can_id)
        assert all(c.ok for c in dialect.link.checks(outgoing.data, outgoing.can_id))
        assert head.address == (outgoing.can_id if self.can else head.address)
        data = outgoing.data[head.start : head.stop]
        if head.exception is not None:
            return {"exception": head.exception}
        named = [dialect.by_name[command]] if command else [c for c in dialect.commands if c.code == head.code]
        for each in named:
            for form in each.reply_forms:
                if codec(form.layout).matches(data) and form.code in (None, head.code):
                    if each.function in (0x06, 0x10):
                        return {"status": int(form.name not in each.replies.failed_forms)}
                    if form.code is None or head.code == form.code:
                        return codec(form.layout).wire(data)
        raise AssertionError(f"{outgoing.data.hex(' ')} is no reply of {command}")

    def judged(self) -> Collect:
        """Return what the analyzer makes of all that went over the bus."""
        items = []
        for t_ns, role, data, can_id in sorted(self.log, key=lambda e: e[0]):
            if can_id is not None:
                items.append(CanFrame(t_ns, "bus", can_id, data))
            else:
                items.append(Chunk(t_ns, "bus", data, Role(role), burst=True))
        names = ["mks-can"] if self.can else ["mks-rs485", "mks-modbus"]
        if not self.can and all(o[2][:1] < b"\xf8" for o in self.log):
            names = ["mks-modbus"]
        elif not self.can and all(o[2][:1] >= b"\xfa" for o in self.log):
            names = ["mks-rs485"]
        model = self.drive.model
        chosen = [dialects.get(n).for_model(model) if model else dialects.get(n) for n in names]
        return run(items, chosen, late_ns=10 * MINUTE)


def test_the_rig_reads_its_own_frames():
    rig = Rig("mks-rs485")
    assert rig.axis() == 0
    assert rig.judged().rules == []
    assert Rig("mks-can").axis() == 0
    assert Rig("mks-modbus").axis() == 0
