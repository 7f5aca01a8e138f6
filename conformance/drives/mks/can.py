"""An MKS SERVO42E/57E on CAN.

    001#F60140023A  ->  run_speed(direction 0, speed 320, acceleration 2)  ->  001#F601F8
    001#008283      ->  read_parameter(work_mode)                          ->  001#820588      the setting's own layout

Rules kept here:
- A reply has the drive's own ID. Standard data frames only: a drive takes no remote, extended or FD frame.
- What differs from the RS485 drives in the same words of the manual: the motor direction turns motion by the bus (86),
  homing from a closed switch goes back by the return angle (94), homing does not let the shaft go, 20 to 60 V.

Not emulated: pulses at the STP and DIR pins beyond their count, the 100 ms after 85, the LED, homing that a 200 ms pulse
at En starts, and what an X4 mode without a magnet would read (the encoder stays readable).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from analyzer.catalogue import Command, Dialect, Form
from analyzer.protocols.mks_can import DIALECT
from analyzer.records import Message
from conformance.drives.drive import Fault, Quirk, Values
from conformance.drives.mks.drive import MksDrive
from conformance.drives.mks.speaker import Speaker


class CanSpeaker(Speaker):
    """The CAN frames of the E drives."""

    turns_bus_motion = True
    lets_go_at_home = False
    backs_off_by_angle = True
    supply = (20.0, 60.0)

    def _form(self, command: Command, asked: Values, values: Values) -> Form:
        """Return the form of a reply; a code that the catalogue does not have cannot be read either."""
        if "unreadable" in values:
            form = next(f for f in command.reply_forms if f.name in command.replies.failed_forms)
            return replace(form, code=asked["parameter"])
        return super()._form(command, asked, values)

    def understands(self, message: Message) -> bool:
        """Say whether a message is a request in a standard data frame."""
        can = message.frame.can
        plain = can is not None and not (can.extended or can.remote or can.error or can.fd)
        return plain and super().understands(message)


class MksCanDrive(MksDrive):
    """One MKS drive on CAN; see `MksDrive`."""

    def __init__(
        self,
        dialect: Dialect = DIALECT,
        address: int = 1,
        *,
        model: str = "",
        settings: Mapping[str, int] | None = None,
        quirks: Iterable[Quirk] = (),
        faults: Iterable[Fault] = (),
        seed: int = 0,
    ) -> None:
        spoken = dialect.for_model(model) if model else dialect
        super().__init__((CanSpeaker(spoken),), address, settings=settings, quirks=quirks, faults=faults, seed=seed)
