"""Where the RS485 manual V1.0.5 of the MKS SERVO42D/57D contradicts itself, outside its Modbus chapter (Part 8).

In the manual's order; a number stays with its entry, so later entries have higher ones. `certain` and `likely` readings
refute a drive that differs; an `open` one is only observed.
Damage of the scan is separated from errors of the authors where the text allows it.

Not known here: the content of the figures, which are not in the text.
"""

from __future__ import annotations

from dataclasses import replace

from analyzer.catalogue import Certainty, Damage, Doubt, Erratum
from analyzer.protocols.mks_shared import RUNS, STOPS

_CERTAIN, _LIKELY, _OPEN = Certainty.CERTAIN, Certainty.LIKELY, Certainty.OPEN

ERRATA = (
    # The whole manual, and Parts 1 to 3
    Erratum(
        "mks-rs485-01", "title", "SERV042D, Notel, position model, O_Mode",
        "digits and letters of like shape are mixed up; other places print SERVO42D, Note1, mode 1, 0_Mode",
        "SERVO42D, Note1, position mode 1, 0_Mode",
        "5.4 explains 0_Mode as the way back to the 0 point, and 5.7 counts the position modes from 1",
        _CERTAIN, Damage.SCAN,
    ),
    Erratum(
        "mks-rs485-02", "1.1, 2.1, 7.2, 7.4, 7.5", "text that points at a figure, and no figure",
        "the figures are lost, and with them frames that may stand in them",
        "the frames that the text prints are all that is known",
        "the text goes on as if the figures were there",
        _CERTAIN, Damage.SCAN,
    ),
    Erratum(
        "mks-rs485-03", "1.2, 9.1", "lists that begin with 3 and with b)",
        "the first items are missing",
        "nothing about a command is lost",
        "both lists make sense without them; items beside figures were lost in the same way",
        _LIKELY, Damage.SCAN,
    ),
    Erratum(
        "mks-rs485-04", "title, 3.3, 3.23, 5.2.3, 5.3.5", "SERVO42D/57D",
        "the title names two drives; 3.3, 3.23 and 5.2.3 give currents of 28D and 35D too, and 5.3.5 names them",
        "four models: 42D, 57D, 28D, 35D",
        "the default currents of the smaller drives differ from those of the 42D, so they are not slips",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-05", "1.4, 6", "SR_CLSOE; SR_VFOC",
        "two work modes have two spellings each",
        "SR_CLOSE and SR_vFOC",
        "5.2.2 numbers six modes, three of them serial; no other reading leaves six",
        _CERTAIN, commands=("set_work_mode",),
    ),
    Erratum(
        "mks-rs485-06", "3, 5.2.10, 5.2.12, 5.2.14, 5.3.1",
        "MPlyer/Mplyer, UartAddr/UautAddr, Mb_RTU/MB_RTU, Hm_Trig/HmTrig, Hm_Dir/HmDir",
        "menu options are spelt one way in the menu chapter and another way beside their commands",
        "the spelling of Part 3",
        "each pair is named by the same function; the command says that it is the same as the option",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-07", "2.4", "SERVO42D_CAN, SERVO57D_CAN end stop wire",
        "captions name CAN drives in a manual of RS485 drives",
        "the wiring is that of the RS485 drives",
        "the switch table below it has an RS485 terminal",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-08", "2.4", "SW1: a function for pin 3, none for pin 2",
        "the row of pin 2 is empty, and the note asks for pin 2 to be on",
        "pins 2 and 3 switch the supply of the end stop together, pin 1 the terminal",
        "supply and ground are two wires; cells that span rows are torn in the text",
        _LIKELY, Damage.SCAN,
    ),
    Erratum(
        "mks-rs485-09", "2.6, 5.3.5", "right limit: only for 57D",
        "2.6 (5) and 5.3.5 give the other drives a right limit too",
        "a drive of another model has a right limit once En and Dir serve as limits",
        "5.3.5 names the 28D, 35D and 42D as the drives that gain by it",
        _LIKELY,
    ),
    Erratum(
        "mks-rs485-10", "3.5, 5.2.5", "subdivision 1 to 256; micstep 00~FF",
        "256 does not fit the byte, and 0 is no subdivision",
        "00 stands for 256",
        "256 is the only value of the range that is left for the only byte that is left",
        _LIKELY,
        bears_on={Doubt.VALUES: ("subdivision",), Doubt.EFFECT: ("set_subdivision",)},
    ),
    Erratum(
        "mks-rs485-11", "3.12, 4", "menu addresses 01..16; 01~10 can be set in the menu",
        "the menu chapter has sixteen addresses, the chapter on frames ten",
        "sixteen",
        "by the release notes V1.0.3 raised the number in the menu to 16; Part 4 kept the older text",
        _LIKELY, commands=("set_address",),
    ),
    Erratum(
        "mks-rs485-12", "3.20", "Hm_Dir: CW, clockwise rotation is positive",
        "the option sets the way of homing, not which way counts as positive",
        "CW: homing turns clockwise",
        "5.3.1 describes the same option as the direction of homing; the wording is that of option 7",
        _CERTAIN, commands=("set_home",),
    ),
    Erratum(
        "mks-rs485-13", "3.23", "Hm_Ma default: 42D 800 mA, 57D 400 mA",
        "the larger drive has half the default of the smaller one, although its range is larger",
        "as printed",
        "nothing else in the manual names the default",
        _OPEN, commands=("set_no_limit_home",),
    ),
    Erratum(
        "mks-rs485-14", "3.25, 5.3.2", "go home needs an end stop and runs until it hits one",
        "with Hm_Mode noLimit (3.22) homing works without an end stop",
        "the note holds for Hm_Mode Limited only",
        "homing without a switch came with V1.0.5; the note is older",
        _CERTAIN,
    ),
    # Part 4: frames
    Erratum(
        "mks-rs485-15", "4", "check code: CRC, and CHECKSUM 8bit",
        "the column is headed CRC, yet the check is a sum",
        "the low byte of the sum of all bytes before it",
        "the worked sum of Part 4 and every complete frame but one fit it",
        _CERTAIN,
        bears_on={Doubt.CHECK: ()},
    ),
    Erratum(
        "mks-rs485-16", "4, 5.2.12", "slave address 00~255; addr(00~FF)",
        "0 is named the broadcast address in the same place, and the range mixes two number bases",
        "a drive has an address of 1..255; setting 0 is refused",
        "a drive with the address of all could not be told from the others",
        _LIKELY,
        bears_on={Doubt.VALUES: ("new_address",)},
    ),
    # Part 5
    Erratum(
        "mks-rs485-17", "5.1.1", "+0x4000 makes carry|value 0x3FF0 into 0x13FF0",
        "the sum would be 0x7FF0, which is outside the value's range; the printed result adds 0x10000",
        "a turn changes the carry by 1 and leaves the value",
        "the printed results, 0x13FF0 and 0xFFFFFFFF3FF0, are carry 1 and -1 beside an unchanged 0x3FF0",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-18", "5.1.2", "clockwise += 0x4000, CCW -= 0x4000",
        "the examples below it, those of 5.1.1 and the sign of the speed in 5.1.3 say the opposite",
        "counter-clockwise raises the encoder value",
        "three places against one; which way a real shaft turns is observed, not judged",
        _OPEN,
    ),
    Erratum(
        "mks-rs485-19", "5.1.2", "0xFFFFFFFFFF0",
        "eleven digits for a 48-bit value",
        "0xFFFFFFFFFFF0",
        "0x3FF0 - 0x4000 is -0x10, and twelve digits of it end in FF0",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-20", "5.1.3", "reply FB 01 31 speed",
        "the reply to 32 carries the code of the command before it",
        "FB 01 32",
        "all other replies repeat the code of their request, and a reply of code 31 has six bytes of data",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-21", "5.1.5 to 5.1.10", "Command6, Command5, Command6, ..., Command9 as items 5 to 10",
        "Command6 stands twice, Command5 after it, and the numbers lag the items",
        "the numbers of the items",
        "34 was put in with V1.0.3 and took a number that was in use",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-53", "2.5, 5.1.5, 5.1.10", "OUT_2: reserved, and bit 3; OUT_1 0: protected; 3E 1: protected",
        "a port without a function has a bit, and one state is told by 0 on a port and by 1 in a status",
        "OUT_2 is read and means nothing; OUT_1 is the level of the port, 3E the state",
        "5.1.5 lists the ports, not what they tell; the two senses stand in two places that do not meet",
        _LIKELY,
    ),
    Erratum(
        "mks-rs485-22", "5.1.6", "an error of 1 degree is returned as 142.222",
        "the field is an int32 and can hold no fraction",
        "the nearest integer of angle x 51200 / 360",
        "the example shows how to reckon, not what is sent",
        _LIKELY,
    ),
    Erratum(
        "mks-rs485-23", "5.1.7", "read the En pins status; enable = 1 Enabled",
        "heading and values differ: the level of a pin, or whether the motor is enabled",
        "whether the motor is enabled, by pin or by F3",
        "the values are named Enabled and Disabled, and in serial modes F3 decides",
        _LIKELY,
        bears_on={Doubt.MEANING: ("read_enabled", "set_enable_level")},
    ),
    Erratum(
        "mks-rs485-24", "5.1.9", "3D under the commands that read",
        "it changes the state of the drive",
        "a command that acts",
        "Part 8 has it among the commands that write",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-54", "5.2.1, 5.3.2, 5.3.3, 5.5, 5.6, 6.2.1, 6.3", "data: NULL (91, 92, 3F, 41), a dash (F1, F7), 00 (80)",
        "NULL and a dash could each be a byte 00, as 80 has one, or nothing",
        "no byte where NULL or a dash stands; 80 has its 00",
        "reads without data have no such byte in print, 2.4 has NULL for nothing, and the sum of 80 in Part 4 lists its 00",
        _LIKELY,
    ),
    Erratum(
        "mks-rs485-25", "5.2.4", "holdMa(01~08)",
        "the list below begins with 00 for 10 %",
        "0..8",
        "nine steps from 10 to 90 % need nine values; Part 8 lists 00 too",
        _CERTAIN,
        bears_on={Doubt.VALUES: ("holding_current",)},
    ),
    Erratum(
        "mks-rs485-26", "5.2.7, 5.3.1, 5.4.1, 6.5.1, 6.6.1", "dir 00 CW, 01 CCW; dir 0/1 (CCW/CW)",
        "settings and motion commands number the directions the other way round, and 0 is called forward in 6.5",
        "both as printed",
        "each is printed several times alike; which way a real shaft turns is observed, not judged",
        _OPEN,
    ),
    Erratum(
        "mks-rs485-27", "5.2.13, 3.13", "respond 0: no information at all is returned",
        "the note just above has F1 answered while respond is 0, and 3.13 speaks of speed and position mode only",
        "respond 0 silences the replies of F6, FD, FE, F4 and F5",
        "exactly these carry the note that their replies can be switched off",
        _LIKELY, commands=(*RUNS, *STOPS),
        bears_on={Doubt.EFFECT: ("set_respond",), Doubt.SEQUENCE: ()},
    ),
    Erratum(
        "mks-rs485-28", "5.3.4", "94: no limit of ma is printed",
        "the option of the menu has one for each model, the command none",
        "0..3000 mA, on the 57D 0..5200 mA",
        "the command refers to the options of the menu",
        _LIKELY,
        bears_on={Doubt.VALUES: ("home_current",)},
    ),
    Erratum(
        "mks-rs485-29", "5.4.1, 3.16", "9A takes mode 0 together with set zero",
        "the menu asks that 0_Mode be not Disable before a zero is set",
        "accepted by the command",
        "9A has one status for all four values and names no condition",
        _OPEN,
    ),
    Erratum(
        "mks-rs485-30", "5.7", "a package as sent, in 50 bytes",
        "one zero is missing in each of the first two slots; the note asks for 52 bytes and slots of 10",
        "the same package with the two zeros",
        "the list above the log has them; a sum does not notice lost zeros",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-31", "5.7", "motor 4: position mode 2, slot F4",
        "F4 is position mode 3; mode 2 is FE",
        "F4, position mode 3",
        "the modes were renumbered when FE was put in with V1.0.4; the example is of April 2023",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-32", "5.7", "motor 5: position mode 3, slot F5",
        "F5 is position mode 4",
        "F5, position mode 4",
        "as for motor 4",
        _CERTAIN,
    ),
    # Part 6
    Erratum(
        "mks-rs485-33", "6", "Part 6 needs a serial work mode",
        "the note covers F1, F3 and F7 too; of these Part 8 asks it of F3 alone (mks-modbus-19)",
        "F1 is answered in every mode; F3, F7, FF and motion need a serial one, under Modbus too",
        "F1 names the calibration as a state, which every mode has; for F7 nothing takes the note back",
        _OPEN,
    ),
    Erratum(
        "mks-rs485-34", "1.4, 6.8, 6.9", "SR_OPEN runs without an encoder; Part 6 is for SR_OPEN too",
        "F4 and F5 go by the encoder, which an open loop need not have",
        "F4 and F5 are accepted in SR_OPEN",
        "Part 6 makes no exception for them, and 6.8 and 6.9 name no mode",
        _OPEN,
    ),
    Erratum(
        "mks-rs485-35", "6.1", "calibrated at 16/32/64 subdivisions; others reckoned from 16",
        "reckoned from 16, 32 and 64 would be slower; 64 keeps 1200 rpm and 128 drops to an eighth of it",
        "at 16, 32 and 64 the speed as sent; else speed x 16 / subdivision",
        "the three worked values (8: 2400, 16/32/64: 1200, 128: 150) fit it",
        _LIKELY, commands=("set_subdivision", *RUNS),
        bears_on={Doubt.SEQUENCE: ()},
    ),
    Erratum(
        "mks-rs485-36", "6.1", "speed 0 to 3000; more than the mode's maximum runs at that maximum",
        "below 16 subdivisions a speed within the range turns the shaft faster than the maximum (3000 at 8: 6000)",
        "the limit is that of the speed as sent",
        "the text compares the set speed with the maximum",
        _OPEN, commands=RUNS,
    ),
    Erratum(
        "mks-rs485-37", "6.1, 6.5.1", "value range 0-3000; greater speeds run at the maximum",
        "a value outside its range is elsewhere refused, here it is said to be cut",
        "the drive runs at the maximum of its mode and answers success",
        "6.1 says what happens to a greater speed, and 12 bits hold up to 4095",
        _LIKELY, commands=RUNS,
        bears_on={Doubt.LIMITS: ("speed",)},
    ),
    Erratum(
        "mks-rs485-38", "6.1", "acc 0: no acceleration; (256 - acc) x 50 us",
        "the formula makes 0 the slowest ramp, the text the steepest",
        "0 changes the speed at once; the formula holds from 1 on",
        "the stop commands say so again: acc 0 stops at once",
        _CERTAIN, commands=(*RUNS, *STOPS),
    ),
    Erratum(
        "mks-rs485-39", "6.2.1", "status 5 homing, status 5 Cal...",
        "one status for two states",
        "6 is calibrating",
        "Part 8 prints 5 and 6",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-40", "6.5.1", "one cell for b3-b0, none for b7-b0",
        "byte 5 has no cell of its own, and the heads above it are shifted",
        "byte 4: dir, three reserved bits, speed bits 11-8; byte 5: speed bits 7-0",
        "6.5.2, 6.6.1 and 6.6.2 have the cell, and the examples fit (01 40: 320 rpm); the scan is likely to have lost it",
        _CERTAIN, Damage.SCAN,
    ),
    Erratum(
        "mks-rs485-41", "6.5.1, 6.6.1", "the lower 4 bits of byte 5 and byte 4 are the speed",
        "the sentence on byte 5 has the bytes the wrong way round; the one on byte 4 has them right",
        "the lower 4 bits of byte 4 and all of byte 5",
        "the examples: 01 40 is 320, 02 80 is 640",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-42", "6.5.2, 7.4", "stop: 1 started, 2 stopped; the worked example has 1 alone and calls it success",
        "the example leaves out the second reply or calls the first one by the wrong name",
        "1 when the stop begins, 2 when the shaft stands still, if active is on",
        "6.5.2 lists both, and the stop of 7.5 gets both",
        _LIKELY,
        bears_on={Doubt.SEQUENCE: ()},
    ),
    Erratum(
        "mks-rs485-43", "6.5.2, 6.6.2", "stops of F6 and FD: statuses 0 to 2; of FE, F4, F5: 0 to 3",
        "an end limit can be met during any of them",
        "3 is accepted as an end of every stop",
        "the same motor and the same limit; the later sections have the longer list",
        _LIKELY,
    ),
    Erratum(
        "mks-rs485-44", "6.5.3, 7.4", "FF: 1 start, 2 success; the worked example has 1 alone and calls it success",
        "the list has two steps, the example one",
        "one reply, 1",
        "the worked example; 2, or 1 and then 2, are taken too",
        _OPEN,
        bears_on={Doubt.REPLY_COUNT: ("save_speed",), Doubt.EXAMPLE: ("save_speed",)},
    ),
    Erratum(
        "mks-rs485-45", "5.1.4, 6.6.1", "pulses 0 - 0xFFFFFFFF; pulses(int32_t)",
        "a single move can be longer than the count of pulses can tell",
        "both as printed; the count wraps",
        "nothing says what the count does at its end, or that a move may not be longer",
        _OPEN,
    ),
    Erratum(
        "mks-rs485-55", "6.6, 6.8", "relative motion; to the specified position, to the specified axis",
        "a relative move goes by a distance, not to a place",
        "by the pulses or counts that are sent, from where the shaft is",
        "the examples: 20 turns for 64000 pulses, and 0x8000 + 0x4000 = 0xC000",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-46", "6.7", "column: absolute axis; field: absPulses",
        "axis is elsewhere the encoder, in counts",
        "pulses",
        "6.7 is the absolute motion by pulses, and its examples end with a pulse count",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-47", "6.8.1", "6.8: position mode3; 6.8.1: position mode2",
        "heading and item differ",
        "mode 3",
        "6.8.2 and the introduction of 6.8 say mode3; see motor 4 of 5.7",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-48", "6.8.1", "FA 01 F4 02 58 02 FF FF C0 00 03",
        "the bytes sum to 0x509, so the checksum is 09",
        "FA 01 F4 02 58 02 FF FF C0 00 09",
        "all other bytes fit the text; FE and F5 with the same data have checksums that fit",
        _CERTAIN,
    ),
    Erratum(
        "mks-rs485-49", "5.1.2, 6.8, 6.9", "axis: the value that 31 reads (int48); field: int32",
        "positions beyond 2^31 counts, 131072 turns, can be read and not sent",
        "both as printed",
        "the bytes of the tables leave four for the axis",
        _OPEN,
    ),
    Erratum(
        "mks-rs485-50", "6.9.1", "relAxis: the absolute axis",
        "the table above and the heading say absAxis",
        "absAxis, absolute",
        "the examples end at the position that was sent, wherever they began",
        _CERTAIN,
    ),
    # Part 7
    Erratum(
        "mks-rs485-51", "7.2 to 7.5", "append CHECKSUM-8; send FA 01 30 2B",
        "with the tool set to append the sum, 7.4 and 7.5 print frames without it, 7.3 one with it",
        "the frame of 7.3 is complete, those of 7.4 and 7.5 lack their sums",
        "2B is the sum of FA 01 30",
        _CERTAIN,
        commands=(
            "read_encoder_carry", "run_speed", "stop_speed", "save_speed", "move_relative_pulses", "stop_relative_pulses",
        ),
    ),
    Erratum(
        "mks-rs485-52", "5.1.1, 5.2.13, 5.3.2, 5.3.3, 6.1", "vaule, respon, sucess, Currnet, uS",
        "misspelt words and units",
        "value, respond, success, current, microseconds",
        "the words stand right elsewhere",
        _CERTAIN,
    ),
)  # fmt: skip
_BY_ID = {erratum.id: erratum for erratum in ERRATA}


def repeated(known: str, number: str, section: str, **otherwise: str) -> Erratum:
    """Return what another manual, or the Modbus chapter, repeats of an entry; `otherwise`: the texts that differ there."""
    return replace(_BY_ID[known], id=number, section=section, **otherwise)  # type: ignore[arg-type]
