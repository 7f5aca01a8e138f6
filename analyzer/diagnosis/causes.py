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
            "A program sends the bytes of a table as they are. A drive waits for the last byte, or drops the frame.",
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
        Cause(
            "lost_start",
            "The beginning of a frame is missing: its first bytes, or its first start bit.",
            "The rest of a frame is there, and with its first bytes back length and check fit; or all bytes look shifted.",
            "The receiver wakes up too late: the RS485 driver is switched round after the drive began, or input is cleared.",
            "Switch the receiver on as soon as the last stop bit is out; do not clear the input after sending; bias the line.",
            "40 40 40 41 64 F1 for 01 01 01 05 91 8B",
        ),
        Cause(
            "leading_glitch",
            "Stray bytes (00, FE, FF) stand before whole frames.",
            "Behind the stray bytes the frame is right; a program that counts bytes reads it shifted.",
            "The line is floating while no driver is on, so that switching a driver makes an edge that reads as a byte.",
            "Bias the line and terminate it; in a program drop bytes until a head comes.",
            "FF FB 01 F6 01 F3",
        ),
        Cause(
            "trailing_glitch",
            "Stray bytes (00, FE, FF) stand behind whole frames.",
            "The frame is right, and the next read begins with a byte of the glitch.",
            "A driver is switched off, and the floating line makes an edge.",
            "Release the driver only after the last stop bit; bias the line; take as many bytes as the frame has.",
            "FB 01 F6 01 F3 00",
        ),
        Cause(
            "inverted_lines",
            "A and B are swapped, so every level is turned round.",
            "Nothing but bytes that are no frame, often with many FF and 7F.",
            "Makers name A and B in both ways; or a UART inverts its signals.",
            "Swap the two wires.",
            "7F 7E FF FF EB 75 19 for 01 03 00 00 00 0A C5 CD",
        ),
        Cause(
            "wrong_baud",
            "Sender and receiver run at different speeds.",
            "The same garbled bytes each time, fewer or more than were sent.",
            "One side was set to another speed, or keeps one from before.",
            "Set both sides to one speed; `servotap record PORT:auto` finds it by listening.",
            "98 06 00 98 66 for FA 01 30 2B at half the speed",
        ),
        Cause(
            "wrong_parity",
            "One side uses 7 data bits with a parity, the other 8 without.",
            "Bit 7 is 0 in every byte, or is the parity of the others.",
            "A serial port was opened as 7E1, which is usual for Modbus-ASCII.",
            "Open the port as 8N1.",
            "7A 01 30 2B for FA 01 30 2B",
        ),
        Cause(
            "reply_cut",
            "The host reads only a part of the reply.",
            "What was received is the beginning of the right reply, and ends too early.",
            "The program reads once, at once, or asks for a number of bytes that is too small.",
            "Read until the length of the reply is there, or a timeout has passed.",
            "> FA 01 30 2B    < FB 01 30 00",
        ),
        Cause(
            "echo",
            "The host gets its own bytes back.",
            "What is received begins with what was sent.",
            "The adapter's receiver stays on while it sends, as with two-wire adapters whose RE is tied low.",
            "Switch the receiver off while sending, or drop as many bytes as were sent.",
            "> FA 01 30 2B    < FA 01 30 2B FB 01 30 ...",
        ),
        Cause(
            "no_reply",
            "The requests are right, and nobody answers.",
            "Requests alone; no drive says anything, not even garbled.",
            "The bytes cannot tell: power, wires, speed, address, or dialect.",
            "Try in order what the next step says; `servotap scan` does much of it by itself.",
            "FA 01 30 2B, again and again",
        ),
        Cause(
            "wrong_address",
            "The host asks an address at which nobody answers; another one answers.",
            "All requests to one address are unanswered, those to another are not.",
            "The drive has another address than the program, or is not wired up.",
            "Look the address up in the drive's menu.",
            "FA 02 30 2C unanswered, FA 01 30 2B answered",
        ),
        Cause(
            "wrong_dialect",
            "The host speaks one dialect, and the drive another.",
            "An address answers in one dialect and is silent in the other.",
            "The drive was switched over (Modbus on or off), the program was not.",
            "Speak the drive's dialect, or switch it over.",
            "FA 01 30 2B unanswered, 01 04 00 33 00 01 C1 C5 answered",
        ),
        Cause(
            "broadcast_no_reply",
            "A read is sent to address 0, which is all drives.",
            "No reply to a sound read of address 0.",
            "All drives take it and none answers: their replies would collide.",
            "Ask one drive by its own address.",
            "FA 00 30 2A",
        ),
        Cause(
            "refused_mode",
            "The drive refuses all motion while it answers: its work mode takes pulses.",
            "F3 and the motion commands fail, reads work.",
            "The drive left the factory in a CR mode, which listens to STEP and DIR.",
            "Change the work mode to SR_vFOC with command 82, or in the menu.",
            "> FA 01 F6 01 40 02 34    < FB 01 F6 00 F2",
        ),
        Cause(
            "respond_off",
            "A drive answers reads and no motion command: its replies are switched off.",
            "The motor moves, and the program waits for a reply.",
            "Command 8C has set respond to 0, or a group address is used.",
            "Set respond to 1.",
            "FA 01 F6 01 40 02 34 unanswered, FA 01 30 2B answered",
        ),
    )
}
