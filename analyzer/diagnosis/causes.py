"""The causes that a diagnosis can find: what each is called, looks like, comes from, and what one does about it."""

from __future__ import annotations

from typing import NamedTuple


class Cause(NamedTuple):
    """A cause. `wrong`: what is wrong, in a sentence; the other texts are for the page of troubles."""

    id: str
    wrong: str
    looks: str
    why: str
    todo: str
    example: str


CAUSES = {
    cause.id: cause
    for cause in (
        Cause(
            "missing_checksum",
            "A request is sent without its checksum.",
            "No drive answers; the frame is right as far as it goes.",
            "A terminal or a program sends the bytes of a table as they are. A drive waits for the last byte, or drops the frame.",
            "Append the checksum; `servotap frame` prints whole frames.",
            "FA 01 F6 01 40 02",
        ),
        Cause(
            "wrong_checksum",
            "A request has a checksum that is not the manual's.",
            "No drive answers, although head, code and length are right.",
            "The check was typed by hand, kept after the values changed, or comes by a rule that is not known here.",
            "Send the frame with the right check, which is printed.",
            "FA 01 30 77",
        ),
        Cause(
            "wrong_checksum_rule",
            "The checks of the requests are computed by another rule than the manual's.",
            "Every request fails; each check is what a well-known other rule gives.",
            "The sum leaves out the head or the CAN identifier, or a library computes an XOR or another CRC.",
            "Compute the check over all bytes before it, by the rule of the dialect.",
            "FA 01 F6 00 00 02 F9",
        ),
        Cause(
            "crc_swapped",
            "The two bytes of the CRC are swapped.",
            "No drive answers a Modbus request; its last two bytes are the right ones in the wrong order.",
            "Modbus sends the low byte of the CRC first; all its other numbers come high byte first.",
            "Swap the last two bytes.",
            "01 04 00 30 00 03 04 B0",
        ),
    )
}
