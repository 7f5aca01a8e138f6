"""Foreign nodes, which share the bus and are no drives: their frames are kept apart, without findings.

The user says who is a drive (`--ids`). Otherwise, on CAN, the frames tell:

    good      the check fits, and the data are a request or reply of the catalogue      from here on the node is a drive
    near      a command of the catalogue, with a wrong check, none, or wrong values     a finding, unless the node was odd
    odd       anything else                                                             a foreign frame
    29 bits   no dialect here has such identifiers                                      a foreign frame

So a program that forgets the checksum is told so, and a CANopen node on the bus is left alone. What a drive sent before
its first good frame may be foreign, too. Of a node that was odd for long, one good frame can be chance: it needs two in a row.

An identifier that a file of messages (DBC) describes is no drive's, unless the user lists it.

On Modbus a slave of another maker shows itself by its answers: it serves registers and functions that no drive has. These then
make no finding. So the finding of an unlisted request waits until the address has answered, or its time is over.

On other serial lines only the user's word counts: other traffic there becomes junk or frames with errors.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from analyzer.catalogue import Dialect, Role
from analyzer.link.interface import data_lengths
from analyzer.records import CanFrame, Message

if TYPE_CHECKING:
    from analyzer.context import Request

#: So many odd frames of a node make a good one doubtful: one frame in 256 has a fitting check by chance.
_ODD_FOR_LONG = 32
#: So many good frames in a row are no chance.
_NO_CHANCE = 2


class Nodes:
    """Who is a drive on one bus. `listed`: identifiers or addresses of drives, as the user says; None: the frames tell."""

    STATE = ("drives", "odd", "claimed", "slaves", "withheld")

    def __init__(self, listed: Collection[int] | None) -> None:
        self.listed = listed
        #: Identifiers that are known to be drives.
        self.drives: set[int] = set()
        #: Odd frames by identifier, of those that are not.
        self.odd: dict[int, int] = {}
        #: Of described identifiers, how many frames in a row were a drive's by their bytes, too; -1: that was said.
        self.claimed: dict[int, int] = {}
        #: Modbus addresses of slaves of other makers: they answered what no drive answers.
        self.slaves: set[int] = set()
        #: By address, the unlisted request whose answer tells whether a slave of another maker is there.
        self.withheld: dict[int, Request] = {}

    def knows(self, address: int) -> bool | None:
        """Say whether an address is a drive's; None where frames have to tell."""
        if self.listed is not None:
            return address in self.listed
        return True if address in self.drives else None

    def tells(self, can: CanFrame, message: Message | None, near: bool) -> bool:
        """Say whether a CAN frame is a drive's, by itself and by those before it. `message` None: it is of no dialect."""
        good = message is not None and _is_good(message)
        odd = self.odd.get(can.id, 0)
        if good and odd < _ODD_FOR_LONG:
            self.drives.add(can.id)
            self.odd.pop(can.id, None)
            return True
        if good:
            self.odd[can.id] = _ODD_FOR_LONG - 1
        elif odd or not near:
            self.odd[can.id] = odd + 1
        return near and not odd

    def settled(self, message: Message, asked: Request | None) -> Request | None:
        """Return the withheld request whose finding is due: the address sends, and not as a slave of another maker.

        `asked`: the request that the message answers.
        """
        waiting = self.withheld.pop(message.address, None)
        if waiting is None:
            return None
        if message.frame.data == waiting.frame.data:
            # It may be the reply to a write, or the host's request once more: the two look alike.
            self.withheld[message.address] = waiting
        elif asked is waiting and is_unlisted(message) and message.form is not message.frame.dialect.exception:
            self.slaves.add(message.address)
        else:
            return waiting
        return None

    def excuses(self, message: Message, request: Request | None) -> bool:
        """Say whether an unlisted message makes no finding, or not yet.

        `request`: the newest one, which is withheld if it is this message; None where its address is known to be a drive's.
        """
        first = request is not None and message.role is Role.REQUEST and message.address != message.frame.dialect.broadcast
        if first and request is not None and message.address not in self.slaves:
            self.withheld[message.address] = request
        return first or message.address in self.slaves

    def claimed_twice(self, can_id: int, message: Message | None) -> bool:
        """Say, once for each identifier, that its frames are a file's by their identifier and a drive's by their bytes.

        `message`: as a drive's dialect reads the frame, None if its check is wrong. One good frame can be chance.
        """
        before = self.claimed.get(can_id, 0)
        if before < 0:
            return False
        row = before + 1 if message is not None and _is_good(message) else 0
        said = row == _NO_CHANCE
        self.claimed[can_id] = -1 if said else row
        return said


def is_unlisted(message: Message) -> bool:
    """Say whether a message uses Modbus on what the manual of the drives does not list: a register, or a whole function."""
    dialect, command = message.frame.dialect, message.command
    if not dialect.of_drives or not dialect.fallbacks or not message.frame.checksum_ok:
        return False
    return command is None or dialect.fallbacks.get(command.function or 0) is command


def _is_good(message: Message) -> bool:
    return message.frame.checksum_ok and message.form is not None and not message.violations


class Likeness:
    """What frames of a CAN dialect look like, but for their check."""

    def __init__(self, dialect: Dialect) -> None:
        self._link = dialect.link
        # Worked out once, and kept with the dialect.
        kept: dict[int, set[int]] | None = dialect.__dict__.get("_lengths")
        if kept is None:
            asked, told = (data_lengths(dialect.commands, role) for role in (Role.REQUEST, Role.REPLY))
            kept = dialect.__dict__["_lengths"] = {n: asked.get(n, set()) | told.get(n, set()) for n in asked | told}
        self._lengths = kept

    def fits(self, can: CanFrame) -> bool:
        """Say whether a frame has a code of the dialect, and one of its lengths."""
        head = self._link.parse(can.data, can.id)
        return len(can.data) >= self._link.shortest and head.stop - head.start in self._lengths.get(head.code or 0, ())

    def is_near(self, can: CanFrame, *, checks: bool) -> bool:
        """Say whether a frame may be one of the dialect whose check is wrong or forgotten. `checks`: its check fits."""
        if can.remote or can.fd:
            return False
        head = self._link.parse(can.data, can.id)
        lengths = self._lengths.get(-1 if head.code is None else head.code)
        return lengths is not None and (
            checks or self.fits(can) or (self._link.checked and len(can.data) - head.start in lengths)
        )
