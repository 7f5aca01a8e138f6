"""What the manuals of the MKS drives say in both links of RS485: Parts 1 to 3 and section 6.1 of the RS485 manual V1.0.5.

In the manual's order, in our words. `EFFECTS` is what Parts 5, 6 and 8 say of a command in the same words.
Here is also how statements of these manuals are declared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from analyzer.catalogue import Statement

DISPLAY = "not visible on the bus: the display"
KEYS = "not visible on the bus: the keys at the display"
CURRENT_UNSEEN = "not visible on the bus: no command reads a current"

RUNS = ("run_speed", "move_relative_pulses", "move_absolute_pulses", "move_relative_axis", "move_absolute_axis")


def said(name: str, says: str, *claims: str) -> Statement:
    """Declare what a drive does, and the claims that refute one that does otherwise."""
    return Statement(name, says, claims)


def unseen(name: str, says: str, why: str) -> Statement:
    """Declare what a drive does and no claim can see, and why."""
    return Statement(name, says, unclaimed=why)


def each(names: tuple[str, ...], pattern: str) -> tuple[str, ...]:
    """Return a pattern of claims for each command."""
    return tuple(pattern.format(name) for name in names)


def effects(section: str, name: str) -> Iterator[Statement]:
    """Yield what a section says of its command that the other link's section says, too."""
    for each in EFFECTS.get(name, ()):
        yield replace(each, id=f"{section}/{each.id}")


def read(section: str, name: str, what: str, *claims: str) -> Iterator[Statement]:
    """Yield what a read tells, the length and order of its bytes, then what its values mean."""
    yield said(f"{section}/told", what, f"shape/{name}/answered", f"shape/{name}/length", f"shape/{name}/code", *claims)
    yield from effects(section, name)


#: Parts 1 to 3: modes, ports, end limits, options. What an option does, the command of the same name does.
SHARED = (
    # Part 1
    said("1.3/angle", "The displayed angle is reckoned from the encoder value that can be read.", "motion/read_position/turn"),
    said("1.3/angle-error", "The displayed error is that of the shaft's angle.", "motion/read_angle_error/*"),
    said("1.3/pulses", "The displayed clk is the count of pulses received.", "motion/read_pulses/counts-*"),
    said("1.4/open-400", "In the open modes the shaft turns at 400 rpm at most.", "motion/run_speed/highest-sr_open"),
    said("1.4/close-1500", "In the close modes the shaft turns at 1500 rpm at most.", "motion/run_speed/highest-sr_close"),
    said("1.4/vfoc-3000", "In the vFOC modes the shaft turns at 3000 rpm at most.", "motion/run_speed/highest-sr_vfoc"),
    said("1.4/pulse-or-bus", "CR modes take pulses, SR modes the bus.",
        "motion/run_speed/pulse-mode", "read-back/set_work_mode/effect"),
    unseen("1.4/fixed-current", "In open and close modes the working current is Ma, always.", CURRENT_UNSEEN),
    unseen("1.4/adapted-current", "In vFOC the current adapts itself, up to Ma.", CURRENT_UNSEEN),
    said("1.4/default-mode", "The default work mode is CR_vFOC.", "read-back/restore/settings"),
    unseen("1.4/open-needs-no-encoder", "In the open modes the drive works without an encoder.",
        "needs a drive without its magnet"),
    # Part 2
    said("2.5/in-1", "IN_1 is the home switch or left limit.",
        "motion/home/finds-switch-*", "motion/set_home/end-limit-stops-*"),
    said("2.5/in-2", "On the 57D IN_2 is the right limit; the 42D has none.", "motion/set_limit_remap/right-off"),
    said("2.5/out-1", "OUT_1 of the 57D is 0 while the rotor protection holds, else 1.", "motion/read_io/stall"),
    unseen("2.5/out-2", "OUT_2 is reserved.", "the manual gives it no meaning"),
    said("2.5/remapped", "With the limits remapped IN_1 is En and IN_2 is Dir.", "read-back/set_limit_remap/effect"),
    said("2.6/off-at-first", "The end limits hold only when they are switched on.", "motion/set_home/end-limit-off"),
    unseen("2.6/home-first", "After a change of the limits the drive must go home first.",
        "the manual does not say what a limit does before homing"),
    said("2.6/left", "A shaft at its left end stop turns no farther to the left.",
        "motion/set_home/end-limit-stops-*", "motion/set_home/end-limit-holds-*"),
    said("2.6/right", "A shaft at its right end stop turns no farther to the right (57D).",
        "motion/set_limit_remap/right-off", "motion/set_limit_remap/right-on"),
    said("2.6/way-back", "Away from a closed end stop the shaft still turns.", "motion/set_home/end-limit-lets-back"),
    said("2.6/remap", "In serial modes the limits can be moved to the ports En and Dir.", "motion/set_limit_remap/right-on"),
    # Part 3
    said("3.2/modes", "Six work modes: open, close and vFOC, each by pulses or by the bus.",
        "ranges/set_work_mode/work_mode/*"),
    said("3.3/current", "The working current is set up to 3000 mA, on a 57D up to 5200 mA.", "ranges/set_current/current/*"),
    unseen("3.3/default", "Default currents: 42D 1600, 57D 3200, 28D 600, 35D 800 mA.", CURRENT_UNSEEN),
    said("3.3/any", "Currents between the steps of the menu are set by the bus.", "ranges/set_current/current/inside"),
    said("3.4/percent", "The holding current is 10 to 90 percent of the working one.", "ranges/set_holding_current/*"),
    unseen("3.4/default", "By default half the working current holds.", CURRENT_UNSEEN),
    unseen("3.4/not-vfoc", "The holding current counts in open and close modes only.", CURRENT_UNSEEN),
    said("3.5/range", "Every subdivision from 1 to 256 can be set.",
        "ranges/set_subdivision/*", "motion/set_subdivision/pulses-at-*", "motion/move_*/crossed-speed"),
    said("3.5/default", "The default subdivision is 16.", "read-back/restore/settings"),
    said("3.6/en-level", "The motor holds at the set level of En, or always with Hold.",
        "read-back/set_enable_level/effect", "read-back/set_enable_level/pin"),
    said("3.6/default", "By default En is active at its low level.", "read-back/restore/settings"),
    unseen("3.7/way", "Dir sets which way pulses turn the motor.", "needs pulses at the step port"),
    said("3.7/not-the-bus", "Dir does not turn motion by the bus.", "motion/set_direction/and-*"),
    unseen("3.8/dark", "With AutoSDD the display goes dark after 15 seconds.", DISPLAY),
    said("3.9/lets-go", "With the protection on, a locked rotor is let go.",
        "motion/set_protection/lets-go*", "motion/release_protection/limp*"),
    said("3.9/off", "With the protection off a locked rotor is not let go.", "motion/set_protection/off-holds-on"),
    said("3.9/default", "By default the protection is off.", "read-back/restore/settings", "motion/read_protection/at-first"),
    said("3.9/released", "The protection is ended by a key or by the bus.", "motion/release_protection/*"),
    unseen("3.10/smooth", "Interpolation to 256 lessens vibration and noise at low speed.", "needs a microphone on the motor"),
    said("3.11/rates", "Seven baud rates from 9600 to 256000 can be set.", "ranges/set_baud_rate/baud_rate/*"),
    said("3.11/default", "The default baud rate is 38400.", "read-back/restore/link"),
    said("3.12/default", "The default address is 1.", "read-back/restore/link"),
    said("3.12/above-16", "Addresses above 16 are set by the bus.", "ranges/set_address/new_address/highest"),
    said("3.14/modbus", "Mb_RTU chooses Modbus-RTU instead of the native frames.", "ranges/set_modbus/modbus/listed"),
    said("3.14/default", "By default Modbus-RTU is off.", "read-back/restore/link"),
    said("3.15/off", "With O_Mode off nothing turns when power comes on.", "read-back/set_zero_mode/off"),
    said("3.15/direction", "In DirMode the shaft goes back to zero by the set direction.", "motion/set_zero_mode/direction-*"),
    said("3.15/near", "In NearMode the shaft goes back to zero by the smaller angle.", "motion/set_zero_mode/near"),
    said("3.16/zero", "Set 0 makes the present place the one to go back to.",
        "motion/set_zero_mode/near", "read-back/set_zero_mode/clean"),
    said("3.17/speed", "O_Speed 0 is the slowest way back and 4 the fastest.", "motion/set_zero_mode/faster"),
    said("3.18/way", "O_Dir is the direction of the way back.", "motion/set_zero_mode/direction-*"),
    said("3.19/level", "Hm_Trig is the level at which the end stop counts as closed.",
        "motion/home/trigger", "motion/home/finds-switch-*", "motion/home/from-closed-*", "motion/set_home/end-limit-*",
        "read-back/set_home/home_trigger"),
    said("3.20/way", "Hm_Dir is the direction in which home is looked for.", "motion/home/finds-switch-*", "motion/home/turns"),
    said("3.21/speed", "Hm_Speed is the speed of homing in rpm.", "motion/home/speed-*", "motion/home/turns"),
    said("3.22/limited", "With Hm_Mode Limited, the default, homing ends at the switch.", "motion/home/finds-switch-*"),
    said("3.24/default", "By default the end limit is off.", "read-back/restore/settings"),
    said("3.24/lets-go", "With EndLimit on, homing lets the shaft go at the left switch.", "motion/home/end-limit"),
    said("3.24/holds", "With EndLimit off the shaft is held after homing.", "motion/home/holds"),
    said("3.25/runs-on", "Homing turns the shaft until it meets the switch.", "motion/home/finds-switch-*"),
    said("3.25/closed", "From a closed switch the shaft first turns the other way until it opens.",
        "motion/home/from-closed-*"),
    said("3.26/defaults", "Restore loads the default parameters.", "read-back/restore/settings", "read-back/restore/link"),
    unseen("3.26/uncalibrated", "After a restore the motor needs a calibration.",
        "no command tells whether the motor is calibrated"),
    unseen("3.26/key", "A key held at power-on restores the defaults.", KEYS),
    unseen("3.27/version", "About shows the version.", DISPLAY),
)  # fmt: skip

#: Section 6.1: speed and acceleration, which 8.3 refers to.
RAMPS = (
    said("6.1/range", "A speed is 0 to 3000; a greater one turns faster.",
        "motion/*/crossed-speed", "motion/run_speed/speed-*"),
    said("6.1/zero-stops", "Speed 0 stops the shaft.", *each(RUNS, "motion/{}/speed-0")),
    said("6.1/mode-limit", "A speed above the mode's maximum turns the shaft at that maximum.",
        "motion/run_speed/highest-sr_*", "ranges/*/speed/above", "motion/*/mode-limit"),
    said("6.1/16-32-64", "At 16, 32 and 64 subdivisions the speed is that which is sent.",
        *(f"motion/set_subdivision/speed-at-{n}" for n in (16, 32, 64)), "motion/set_subdivision/pulses-at-64"),
    said("6.1/other-subdivisions", "At others it is speed times 16 over the subdivision.",
        *(f"motion/set_subdivision/speed-at-{n}" for n in (2, 8, 100, 128, 256)), "motion/move_*/crossed-speed",
        "motion/*/parts-of-a-rpm"),
    said("6.1/8", "At 8 subdivisions speed 1200 is 2400 rpm.", "motion/set_subdivision/speed-at-8"),
    said("6.1/128", "At 128 subdivisions speed 1200 is 150 rpm.", "motion/set_subdivision/speed-at-128"),
    said("6.1/acceleration", "An acceleration is 0 to 255; a greater one is a steeper ramp.",
        "timing/run_speed/ramp-*", "ranges/run_speed/acceleration/*"),
    said("6.1/at-once", "With acceleration 0 the shaft takes its speed at once.",
        "timing/run_speed/ramp-0", "timing/stop_speed/ramp-0", "motion/*/own-ramp"),
    said("6.1/up", "On the way up each rpm takes (256 - acc) times 50 microseconds.",
        "timing/run_speed/ramp-*", *each(RUNS, "motion/{}/crossed-course")),
    said("6.1/up-to-speed", "The way up ends at the speed that was asked for.", "motion/run_speed/speed-*"),
    said("6.1/example-236", "At acceleration 236 each rpm takes 1 ms.", "timing/run_speed/ramp-236"),
    said("6.1/down", "On the way down each rpm takes as long as on the way up.",
        "timing/stop_speed/ramp-*", "timing/run_speed/ramp-240-to-60"),
    said("6.1/down-to-speed", "The way down ends at the lower speed that was asked for.", "timing/run_speed/ramp-240-to-60"),
)  # fmt: skip

#: What is said of a command in both links, by its name; an id is without the section.
EFFECTS: dict[str, tuple[Statement, ...]] = {
    "read_encoder_carry": (
        said("range", "The value is 0 to 3FFFh.", "shape/read_encoder_carry/values", "motion/read_encoder_carry/at-the-carry"),
        said("turn", "A turn changes the carry by one and leaves the value.", "motion/read_encoder_carry/standing"),
        said("disabled", "The encoder is read whether the motor is enabled or not.", "motion/read_position/while-disabled"),
    ),
    "read_position": (
        said("turn", "A turn changes it by 4000h.", "motion/read_position/turn"),
        said("way", "Counter-clockwise raises it (in print both ways).", "motion/run_speed/raises"),
    ),
    "read_speed": (
        said("sign", "The speed is positive counter-clockwise and negative clockwise.", "motion/read_speed/crossed"),
    ),
    "read_io": (said("remapped", "With the limits remapped, IN_1 is En and IN_2 is Dir.", "read-back/set_limit_remap/effect"),),
    "read_angle_error": (
        said("sign", "The error is the wanted angle minus the real one.",
            "motion/read_angle_error/held-*", "motion/read_angle_error/limp"),
        said("unit", "51200 units are 360 degrees.", "motion/read_angle_error/held-*", "motion/read_angle_error/limp"),
    ),
    "read_zero_status": (unseen("fail", "2: the way back failed.", "the manual does not say when it fails"),),
    "set_current": (
        said("maximum", "At most 3000 mA, on a 57D 5200 mA.",
            "ranges/set_current/current/highest", "ranges/set_current/current/above"),
        unseen("flows", "This current flows.", CURRENT_UNSEEN),
        unseen("shown", "The display shows the new current.", DISPLAY),
    ),
    "set_subdivision": (
        said("pulses", "A turn has 200 times the subdivision in pulses.",
            "motion/set_subdivision/pulses-at-*", "motion/move_*/crossed-speed"),
    ),
    "set_enable_level": (
        said("effect", "At that level the motor holds; with 2 it holds always.",
            "read-back/set_enable_level/effect", "read-back/set_enable_level/pin"),
    ),
    "set_direction": (
        said("not-the-bus", "The direction of the bus's motion is that of its commands.", "motion/set_direction/and-*"),
    ),
    "set_protection": (
        said("on", "With 1 a locked rotor is let go.", "motion/set_protection/lets-go*", "motion/release_protection/limp*"),
        said("off", "With 0 a locked rotor is not let go.", "motion/set_protection/off-holds-on"),
        said("released", "A command ends the protection.", "motion/release_protection/*"),
        unseen("key", "A key ends the protection.", KEYS),
    ),
    "set_interpolation": (unseen("smooth", "Steps are interpolated to 256.", "finer than the encoder tells"),),
    "set_baud_rate": (
        said("rates", "1 to 7 are 9600, 19200, 25000, 38400, 57600, 115200, 256000.", "ranges/set_baud_rate/baud_rate/?*00"),
    ),
    "set_address": (
        said("heard", "The drive is heard at its new address.", "addressing/set_address/moves"),
        said("broadcast", "0 is the address of all drives.",
            "addressing/broadcast/*", "addressing/set_address/shared-heard", "read-back/settings/restart-broadcast",
            "read-back/*/restart-broadcast-*", "ranges/set_address/new_address/below"),
        unseen("shown", "The display shows the new address.", DISPLAY),
    ),
    "set_key_lock": (unseen("locked", "Locked keys do nothing.", KEYS),),
    "set_home": (
        said("level", "The trigger level is 0 low or 1 high.",
            "motion/home/trigger", "motion/set_home/end-limit-*", "read-back/set_home/home_trigger"),
        said("way", "Homing turns clockwise with 0, the other way with 1.", "motion/home/finds-switch-*", "motion/home/turns"),
        said("speed", "Homing turns at the set speed, 0 to 3000 rpm.",
            "motion/home/speed-*", "motion/home/turns", "motion/home/within-mode"),
        said("limit", "The end limit is off with 0 and on with 1.",
            "motion/set_home/end-limit-off", "motion/set_home/end-limit-stops-*"),
        unseen("home-first", "A changed end limit holds after homing.",
            "the manual does not say what a limit does before homing"),
        said("lets-go", "With the end limit on, homing lets the shaft go at the switch.", "motion/home/end-limit"),
        said("holds", "With it off, the shaft is held after homing.", "motion/home/holds"),
    ),
    "home": (said("closed", "From a closed switch the shaft turns away first, then comes back.", "motion/home/from-closed-*"),),
    "set_limit_remap": (
        said("serial", "It works in serial modes alone.", "motion/set_limit_remap/pulse-mode"),
        said("right", "A 42D then has a right limit, at Dir.", "motion/set_limit_remap/right-on"),
        unseen("left", "The left limit is then at En.", "no command tells at which port a switch is read"),
        said("off", "Without it a small drive has no right limit.", "motion/set_limit_remap/right-off"),
    ),
    "set_zero_mode": (
        said("off", "Mode 0: nothing turns at power-on.", "read-back/set_zero_mode/off"),
        said("direction", "Mode 1: the shaft goes back by the direction.", "motion/set_zero_mode/direction-*"),
        said("near", "Mode 2: the shaft goes back by the smaller angle.", "motion/set_zero_mode/near"),
        said("one-turn", "The way back is 359 degrees at most.", "motion/set_zero_mode/*"),
        said("set", "Zero 1: the present place is kept.", "motion/set_zero_mode/near", "read-back/set_zero_mode/restart"),
        said("clean", "Zero 0: the kept place is forgotten.", "read-back/set_zero_mode/clean"),
        said("speed", "Speed 0 is the slowest, 4 the fastest.", "motion/set_zero_mode/faster"),
    ),
    "read_status": (
        said("stopped", "1: it stands.",
            "motion/read_status/standing", "motion/read_status/behind-emergency", "motion/read_status/slow-*",
            "motion/read_status/after-a-move"),
        said("up", "2: it speeds up.", "motion/read_status/crossed"),
        said("down", "3: it slows down.", "motion/read_status/slowing-down"),
        said("full", "4: it turns at full speed.", "motion/read_status/crossed", "motion/read_status/slow-*"),
        said("homing", "5: it is homing.", "motion/home/status", "motion/home/status-*"),
        said("fail", "0: the query failed.", "shape/read_status/status"),
    ),
    "move_relative_pulses": (
        said("pulses", "It goes on by the pulses, 32 bits of them.",
            "motion/move_relative_pulses/distance", "motion/move_relative_pulses/behind-ended",
            "ranges/move_relative_pulses/pulses/width", "motion/move_relative_pulses/low-word", "motion/*/crossed-ends",
            "motion/move_relative_pulses/many"),
    ),
    "move_absolute_pulses": (
        said("place", "It goes to a place in pulses, 32 signed bits.",
            "motion/move_absolute_pulses/distance", "ranges/move_absolute_pulses/position/width",
            "motion/move_absolute_pulses/low-word"),
        said("read", "Then the pulses read what was sent.", "motion/move_absolute_pulses/reads-as-asked"),
    ),
    "move_relative_axis": (
        said("distance", "It goes on by a distance in encoder counts, 32 signed bits.",
            "motion/move_relative_axis/distance", "motion/move_relative_axis/behind-ended",
            "ranges/move_relative_axis/position/width", "motion/move_relative_axis/low-word", "motion/*_axis/crossed-ends",
            "motion/move_relative_axis/many"),
    ),
    "move_absolute_axis": (
        said("place", "It goes to a place in encoder counts, 32 signed bits.",
            "motion/move_absolute_axis/distance", "ranges/move_absolute_axis/position/width",
            "motion/move_absolute_axis/low-word"),
        said("updates", "A newer target and speed are taken up under way.",
            "motion/move_absolute_axis/update-*", "motion/move_absolute_axis/newer-*"),
    ),
}  # fmt: skip
