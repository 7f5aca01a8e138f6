"""An MKS SERVO42D/57D on RS485 in its native frames: heads FA and FB, sum8, and the FC package.

    FA 01 F6 01 40 02 34  ->  run_speed(direction 0, speed 320, acceleration 2)  ->  FB 01 F6 01 F3

Rules kept here:
- The head says who sent a frame: FA and FC are heard, nothing else is.
- What all MKS dialects share stands in `mks_speaker`, what the drive does in `mks` and its parts. The same drive speaks
  Modbus once it is told to (8E); both are one object, see `mks_serial`.

Not emulated: see `mks`.
"""

from __future__ import annotations

from analyzer.catalogue import Role
from analyzer.records import Message
from conformance.drives.mks.speaker import Speaker


class NativeSpeaker(Speaker):
    """The native frames of the RS485 drives."""

    def understands(self, message: Message) -> bool:
        """Say whether a message is a request that the drive knows, with a head that says so."""
        return self.dialect.link.parse(message.frame.data).role is Role.REQUEST and super().understands(message)
