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
            "address_changed",
            "The drive was given another address, and is still asked at the old one.",
            "A set_address is answered, and requests to the old address are not.",
            "The new address counts at once.",
            "Ask at the new address.",
            "> FA 01 8B 05 8B    < FB 05 8B 01 8C    > FA 01 30 2B",
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
        Cause(
            "text_mode",
            "Bytes are handled as text: replaced, encoded, or sent as the letters of their digits.",
            "EF BF BD stands where a high byte belongs, or 46 41 (the letters FA) for one byte, or 0D before 0A.",
            "A program decodes or encodes strings, or a port is open in text mode.",
            "Read and write bytes; open the port raw.",
            "46 41 30 31 33 30 32 42 for FA 01 30 2B",
        ),
        Cause(
            "tcp_framing",
            "A frame has the header of Modbus TCP and no CRC.",
            "00 01 00 00 00 06 stands before it; a drive on RTU is silent.",
            "The program speaks Modbus TCP through a gateway that passes bytes on as they are.",
            "Switch the program to RTU over TCP, or let the gateway convert.",
            "00 01 00 00 00 06 01 04 00 30 00 03",
        ),
        Cause(
            "wrong_length",
            "A known request has another length than the manual's.",
            "No drive answers, although the check fits.",
            "A field was left out, or a quantity is not that of the register.",
            "Build the frame with `servotap frame`.",
            "01 04 00 30 00 01 30 05",
        ),
        Cause(
            "unknown_command",
            "A request has a code that the manual does not list.",
            "No drive answers, although the check fits.",
            "A typing error, or the table of another product or firmware.",
            "Look the code up with `servotap catalogue`.",
            "FA 01 2F 2A",
        ),
        Cause(
            "wrong_function",
            "A register is read by function 03, and the drive has it under 04 (or the reverse).",
            "Silence or an exception for one function; the register is right.",
            "Most libraries read holding registers (03) by default; these drives have input registers (04).",
            "Read by the other function: read_input_registers.",
            "01 03 00 32 00 01 25 C5",
        ),
        Cause(
            "wrong_register",
            "A register is one above a known one.",
            "Silence or an exception, and the register below exists.",
            "Tools that count registers from 1 send one less, and others do not.",
            "Take one away from the register, or switch the tool to addresses from 0.",
            "01 04 00 35 00 01",
        ),
        Cause(
            "decimal_as_hex",
            "A register of the manual, which is in hexadecimal, was typed as a decimal number.",
            "The register sent, written in decimal, has the digits of a known one.",
            "The manual writes 0030h, and the program has 30.",
            "Write 0x30.",
            "01 04 00 1E 00 03 D0 0D",
        ),
        Cause(
            "unsupported_dialect",
            "The frames are of motors that are not known here.",
            "Identifiers 0x141 and 0x241 with eight bytes each.",
            "RMD motors on CAN speak another protocol.",
            "Use the manual of the motor's maker.",
            "141#9A00000000000000",
        ),
        Cause(
            "can_no_ack",
            "Nobody acknowledges the adapter's frames.",
            "Error frames that name the acknowledge alone, and no frame of a drive.",
            "No power, a broken or swapped wire, or a drive at another bit rate.",
            "Check power, CAN_H and CAN_L, the termination, then the bit rate.",
            "20000020#0000000000000000",
        ),
        Cause(
            "can_wrong_bitrate",
            "The nodes run at different bit rates.",
            "Stuff, form and bit errors, and no frame gets through.",
            "The adapter was opened at another speed than the drive's.",
            "Set the drive's bit rate.",
            "20000008#0000040000000000",
        ),
        Cause(
            "can_bit_errors",
            "Frames are destroyed on the line, and others get through.",
            "Stuff, form or bit errors between good frames.",
            "Termination, long stubs, no common ground, or interference.",
            "Measure 60 Ohm between CAN_H and CAN_L without power; shorten the stubs.",
            "20000008#0000040000000000",
        ),
        Cause(
            "can_bus_off",
            "The adapter has switched itself off the bus.",
            "An error frame says so, and nothing follows.",
            "Its counter of errors went over 255.",
            "Mend what makes the errors, then restart the interface.",
            "20000040#0000000000000000",
        ),
        Cause(
            "can_extended_id",
            "Frames have identifiers of 29 bits; the drives take 11 bits.",
            "The data and the sum fit a standard frame of the same number.",
            "The program sets the extended flag: python-can does by default.",
            "Send standard frames: is_extended_id=False.",
            "00000001#3031",
        ),
    )
}
