"""Where the Modbus chapter (Part 8) of the RS485 manual V1.0.5 contradicts itself, the other parts or Modbus.

In the manual's order; a number stays with its entry, so later entries have higher ones. `certain` and `likely` readings
refute a drive that differs; an `open` one is only observed.

Not known here: the content of the .mbp files that the chapter names. Registers that only a later manual of the vendor has
are left out.
"""

from __future__ import annotations

from analyzer.catalogue import Certainty, Damage, Doubt, Erratum
from analyzer.protocols.mks_rs485_errata import repeated

_CERTAIN, _LIKELY, _OPEN = Certainty.CERTAIN, Certainty.LIKELY, Certainty.OPEN

ERRATA = (
    Erratum(
        "mks-modbus-01", "8", "CRC16 Hi, Lo",
        "the byte under Hi is sent first and is the low byte of the CRC",
        "low byte first",
        "the CRC of every printed frame but one fits so, as Modbus asks",
        _CERTAIN,
        bears_on={Doubt.CHECK: ()},
    ),
    Erratum(
        "mks-modbus-02", "8", "F4(30), F6(3F), F16(F6) in file names",
        "F4 and F6 are codes of motion commands elsewhere, and 16 is decimal beside hexadecimal codes",
        "functions 04h, 06h and 10h; the register stands in brackets",
        "each file name fits the function of its section so",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-03", "8.1", "three registers from 30h, three from 31h, one from 32h",
        "in Modbus a read from 30h would end with the registers 31h and 32h, which hold other values here",
        "each start address is a command of its own and has its own quantity",
        "the responses are described by start address alone",
        _CERTAIN,
    ),
    repeated("mks-rs485-17", "mks-modbus-04", "8.1.1"),
    repeated("mks-rs485-18", "mks-modbus-05", "8.1.2",
             wrong="the examples below it, those of 8.1.1 and the sign of the speed in 8.1.3 say the opposite"),
    repeated("mks-rs485-19", "mks-modbus-06", "8.1.2"),
    Erratum(
        "mks-modbus-07", "8.1.3", "01 04 00 32 00 01, CRC E1 C4",
        "E1 C4 is the CRC of the frame of 8.1.2",
        "01 04 00 32 00 01 90 05",
        "computed; the other frames of the chapter fit their CRCs",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-08", "8.1.4", "pulses (uint32_t)",
        "5.1.4 has the same value as int32_t",
        "int32",
        "pulses count both ways: FE moves to positions below zero and ends at such a pulse count",
        _LIKELY,
    ),
    repeated("mks-rs485-22", "mks-modbus-09", "8.1.6"),
    repeated("mks-rs485-23", "mks-modbus-10", "8.1.7"),
    Erratum(
        "mks-modbus-31", "5.2.13, 5.2.16, 5.3.4, 8.2.20, 8.3", "no register for 8C, 8D and 94",
        "homing and motion depend on what they set, and Part 8 neither sets it nor says whether it holds",
        "what native frames have set stays; whether respond, active and the group address hold under Modbus is observed",
        "it is the same drive, and 8E changes how it is spoken to, not what it has stored",
        _OPEN,
    ),
    Erratum(
        "mks-modbus-11", "8.2.1", "see 09_F4(F1) Read the motor status.mbp",
        "that is the file of 8.1.10; this section writes 3Dh by function 06h",
        "a file of function 06h and register 3Dh",
        "copied; the file names go from 09 to 11",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-12", "8.2.4, 5.2.1", "80h is written with 1; the native command has the data byte 00",
        "the same command is given by two values",
        "each as printed",
        "in Part 8 every command without a value writes 1",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-13", "8.2.8", "micstep in both bytes, no range",
        "the native command has one byte, in which 256 does not fit",
        "1..256 as a 16-bit number; 0 is taken as 256",
        "3.5 supports 1 to 256, and the table leaves both bytes to the value",
        _LIKELY,
        bears_on={Doubt.VALUES: ("subdivision",), Doubt.EFFECT: ("set_subdivision",)},
    ),
    Erratum(
        "mks-modbus-14", "8.2.15, 4", "addr; 0 is the broadcast address; 00~255",
        "Modbus ends the addresses of slaves at 247",
        "1..247; 0 is refused",
        "248 to 255 are reserved in Modbus, and a drive with the address of all could not be told from the others",
        _LIKELY,
        bears_on={Doubt.VALUES: ("new_address",), Doubt.ADDRESSING: ()},
    ),
    Erratum(
        "mks-modbus-15", "8.2.20", "quantity 03H, bytes 05H",
        "three registers are six bytes; a host that keeps to Modbus cannot send it",
        "five bytes, as printed",
        "the five bytes fit the fields of the table; the vendor's later manual prints a whole frame of this kind",
        _CERTAIN,
        bears_on={Doubt.LAYOUT: ("set_home",)},
    ),
    Erratum(
        "mks-modbus-16", "8.2.20", "hmTrig, hmDir, HmSpeed, hmSpeed, enable",
        "one field has two spellings, and the end limit is headed enable",
        "HmTrig, HmDir, HmSpeed, EndLimit",
        "the spelling of 5.3.1",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-17", "8.2.22", "10 H",
        "a blank within the function",
        "10H",
        "the response has 10H",
        _CERTAIN, Damage.SCAN,
    ),
    Erratum(
        "mks-modbus-18", "8.3.4, 8.3.5", "position model; Notel",
        "the letter l stands for the digit 1",
        "position mode 1; Note 1",
        "8.3.5 to 8.3.7 go on with mode2, mode3 and mode4",
        _CERTAIN, Damage.SCAN,
    ),
    Erratum(
        "mks-modbus-19", "8.3.1, 6", "F7 without a note on the work mode",
        "Part 6, which asks for a serial mode, has F7 too; in Part 8 only F3, 9E and 8.3.3 to 8.3.7 ask for one",
        "F7 needs a serial mode, as the native command (mks-rs485-33)",
        "it is one command of one drive; yet each section of Part 8 that needs a mode says so itself",
        _OPEN,
    ),
    Erratum(
        "mks-modbus-20", "8.2.19, 8.3.3 to 8.3.7", "SR_VFOC",
        "8.2.5 has SR_vFOC",
        "SR_vFOC",
        "the spelling of the list that gives the modes their numbers",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-21", "8.3.3 to 8.3.7", "stop: speed 00H, pulses 00H, axis 00H",
        "a single byte is printed for fields of two and four bytes; with byte counts 04H and 08H they cannot be bytes",
        "0000h and 00000000h",
        "the byte counts are those of the runs",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-22", "8.3.3.3", "flag = C8H, CAH",
        "the native command calls the same byte state",
        "state",
        "the spelling of 6.5.3",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-23", "8.3.4, 8.1.4", "pulses 0 - 0xFFFFFFFF",
        "a single move can be longer than an int32 count of pulses can tell",
        "uint32 in the move, int32 in the count, which wraps",
        "nothing says what the count does at its end, or that a move may not be longer",
        _OPEN,
    ),
    Erratum(
        "mks-modbus-24", "8.3.4 to 8.3.7", "acc (uint8_t) in FD, acc (uint16_t) in FE, F4 and F5",
        "one quantity has two widths within the chapter, and 0 - 255 fits either",
        "each as printed; above 255 is out of range",
        "without a direction the wider field fills the register, and the byte counts fit",
        _CERTAIN,
    ),
    repeated("mks-rs485-46", "mks-modbus-25", "8.3.5",
             why="8.3.5 is the absolute motion by pulses"),
    Erratum(
        "mks-modbus-26", "8.3.5", "01 10 00 FE 00 04, no CRC, twice",
        "the responses of FD, F4 and F5 have theirs",
        "01 10 00 FE 00 04 A0 3A",
        "computed",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-32", "8.3.6", "relative motion; to the specified axis",
        "a relative move goes by a distance, not to a place",
        "by the counts that are sent, from where the shaft is",
        "the heading; 6.8 has the same sentence and examples of a distance",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-27", "8.3.6, 8.3.7", "relAxis, absAxis: the steps",
        "the axis is the encoder, which has counts, not steps",
        "counts, 16384 a turn",
        "the note of the same section says what the axis is",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-28", "8.3.6, 8.3.7", "can be read by command 31",
        "under Modbus there is no command 31",
        "register 31h",
        "the sentence is that of 6.8; 8.1.2 reads the same value",
        _CERTAIN,
    ),
    Erratum(
        "mks-modbus-29", "8.1.2, 8.3.6, 8.3.7", "axis: the value of 31h (int48); field: int32",
        "positions beyond 2^31 counts, 131072 turns, can be read and not sent",
        "both as printed",
        "the byte counts leave four bytes for the axis",
        _OPEN,
    ),
    Erratum(
        "mks-modbus-30", "8.3.6, 8.3.7", "31_F16(F4) Position mode2, 32_F16(F5) Position mode3",
        "the sections call them mode3 and mode4",
        "mode 3 and mode 4",
        "the files keep the numbers from before FE was put in as mode 2",
        _CERTAIN,
    ),
)  # fmt: skip
