"""What the manuals of the MKS drives say in both links of RS485: Parts 1 to 3 and section 6.1 of the RS485 manual V1.0.5.

In the manual's order, in our words. Here is also how statements of these manuals are declared.
"""

from __future__ import annotations

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


def read(section: str, name: str, what: str, *claims: str) -> Statement:
    """Declare what a read tells and the length and order of its bytes."""
    return said(f"{section}/told", what, f"shape/{name}/answered", f"shape/{name}/length", f"shape/{name}/code", *claims)


#: Parts 1 to 3: modes, ports, end limits, options. What an option does, the command of the same name does.
SHARED = (
    # Part 1
    said("1.3/angle", "The displayed angle is reckoned from the encoder value that can be read.", "motion/read_position/turn"),
    said("1.3/angle-error", "The displayed error is that of the shaft's angle.", "motion/read_angle_error/*"),
    said("1.3/pulses", "The displayed clk is the count of pulses received.", "motion/read_pulses/counts-*"),
    said("1.4/open-400", "In the open modes the shaft turns at 400 rpm at most.", "motion/run_speed/highest-sr_open"),
    said("1.4/close-1500", "In the close modes the shaft turns at 1500 rpm at most.", "motion/run_speed/highest-sr_close"),
    said("1.4/vfoc-3000", "In the vFOC modes the shaft turns at 3000 rpm at most.", "motion/run_speed/highest-sr_vfoc"),
    said(
        "1.4/pulse-or-bus",
        "CR modes take pulses, SR modes the bus.",
        "motion/run_speed/pulse-mode",
        "read-back/set_work_mode/effect",
    ),
    unseen("1.4/fixed-current", "In open and close modes the working current is Ma, always.", CURRENT_UNSEEN),
    unseen("1.4/adapted-current", "In vFOC the current adapts itself, up to Ma.", CURRENT_UNSEEN),
    said("1.4/default-mode", "The default work mode is CR_vFOC.", "read-back/restore/settings"),
    unseen(
        "1.4/open-needs-no-encoder", "In the open modes the drive works without an encoder.", "needs a drive without its magnet"
    ),
    # Part 2
    said(
        "2.5/in-1", "IN_1 is the home switch or left limit.", "motion/home/finds-switch-*", "motion/set_home/end-limit-stops-*"
    ),
    said("2.5/in-2", "On the 57D IN_2 is the right limit; the 42D has none.", "motion/set_limit_remap/right-off"),
    said("2.5/out-1", "OUT_1 of the 57D is 0 while the rotor protection holds, else 1.", "motion/read_io/stall"),
    unseen("2.5/out-2", "OUT_2 is reserved.", "the manual gives it no meaning"),
    said("2.5/remapped", "With the limits remapped IN_1 is En and IN_2 is Dir.", "read-back/set_limit_remap/effect"),
    said("2.6/off-at-first", "The end limits hold only when they are switched on.", "motion/set_home/end-limit-off"),
    unseen(
        "2.6/home-first",
        "After a change of the limits the drive must go home first.",
        "the manual does not say what a limit does before homing",
    ),
    said(
        "2.6/left",
        "A shaft at its left end stop turns no farther to the left.",
        "motion/set_home/end-limit-stops-*",
        "motion/set_home/end-limit-holds-*",
    ),
    said(
        "2.6/right",
        "A shaft at its right end stop turns no farther to the right (57D).",
        "motion/set_limit_remap/right-off",
        "motion/set_limit_remap/right-on",
    ),
    said("2.6/way-back", "Away from a closed end stop the shaft still turns.", "motion/set_home/end-limit-lets-back"),
    said("2.6/remap", "In serial modes the limits can be moved to the ports En and Dir.", "motion/set_limit_remap/right-on"),
    # Part 3
    said(
        "3.2/modes", "Six work modes: open, close and vFOC, each by pulses or by the bus.", "ranges/set_work_mode/work_mode/*"
    ),
    said("3.3/current", "The working current is set up to 3000 mA, on a 57D up to 5200 mA.", "ranges/set_current/current/*"),
    unseen("3.3/default", "Default currents: 42D 1600, 57D 3200, 28D 600, 35D 800 mA.", CURRENT_UNSEEN),
    said("3.3/any", "Currents between the steps of the menu are set by the bus.", "ranges/set_current/current/inside"),
    said("3.4/percent", "The holding current is 10 to 90 percent of the working one.", "ranges/set_holding_current/*"),
    unseen("3.4/default", "By default half the working current holds.", CURRENT_UNSEEN),
    unseen("3.4/not-vfoc", "The holding current counts in open and close modes only.", CURRENT_UNSEEN),
    said(
        "3.5/range",
        "Every subdivision from 1 to 256 can be set.",
        "ranges/set_subdivision/*",
        "motion/set_subdivision/pulses-at-*",
        "motion/move_*/crossed-speed",
    ),
    said("3.5/default", "The default subdivision is 16.", "read-back/restore/settings"),
    said(
        "3.6/en-level",
        "The motor holds at the set level of En, or always with Hold.",
        "read-back/set_enable_level/effect",
        "read-back/set_enable_level/pin",
    ),
    said("3.6/default", "By default En is active at its low level.", "read-back/restore/settings"),
    unseen("3.7/way", "Dir sets which way pulses turn the motor.", "needs pulses at the step port"),
    said("3.7/not-the-bus", "Dir does not turn motion by the bus.", "motion/set_direction/and-*"),
    unseen("3.8/dark", "With AutoSDD the display goes dark after 15 seconds.", DISPLAY),
    said(
        "3.9/lets-go",
        "With the protection on, a locked rotor is let go.",
        "motion/set_protection/lets-go*",
        "motion/release_protection/limp*",
    ),
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
    said("3.15/off", "With O_Mode off nothing turns when power comes on.", "motion/set_zero_mode/off"),
    said("3.15/direction", "In DirMode the shaft goes back to zero by the set direction.", "motion/set_zero_mode/direction-*"),
    said("3.15/near", "In NearMode the shaft goes back to zero by the smaller angle.", "motion/set_zero_mode/near"),
    said(
        "3.16/zero",
        "Set 0 makes the present place the one to go back to.",
        "motion/set_zero_mode/near",
        "motion/set_zero_mode/clean",
    ),
    said("3.17/speed", "O_Speed 0 is the slowest way back and 4 the fastest.", "motion/set_zero_mode/faster"),
    said("3.18/way", "O_Dir is the direction of the way back.", "motion/set_zero_mode/direction-*"),
    said(
        "3.19/level",
        "Hm_Trig is the level at which the end stop counts as closed.",
        "motion/home/trigger",
        "motion/home/finds-switch-*",
        "motion/home/from-closed-*",
        "motion/set_home/end-limit-*",
        "read-back/set_home/home_trigger",
    ),
    said(
        "3.20/way",
        "Hm_Dir is the direction in which home is looked for.",
        "motion/home/finds-switch-*",
        "read-back/set_home/home_direction",
    ),
    said("3.21/speed", "Hm_Speed is the speed of homing in rpm.", "motion/home/speed-*", "read-back/set_home/home_speed"),
    said("3.22/limited", "With Hm_Mode Limited, the default, homing ends at the switch.", "motion/home/finds-switch-*"),
    said("3.24/default", "By default the end limit is off.", "read-back/restore/settings"),
    said("3.24/lets-go", "With EndLimit on, homing lets the shaft go at the left switch.", "motion/home/end-limit"),
    said("3.24/holds", "With EndLimit off the shaft is held after homing.", "motion/home/holds"),
    said("3.25/runs-on", "Homing turns the shaft until it meets the switch.", "motion/home/finds-switch-*"),
    said(
        "3.25/closed", "From a closed switch the shaft first turns the other way until it opens.", "motion/home/from-closed-*"
    ),
    said("3.26/defaults", "Restore loads the default parameters.", "read-back/restore/settings", "read-back/restore/link"),
    unseen(
        "3.26/uncalibrated",
        "After a restore the motor needs a calibration.",
        "no command tells whether the motor is calibrated",
    ),
    unseen("3.26/key", "A key held at power-on restores the defaults.", KEYS),
    unseen("3.27/version", "About shows the version.", DISPLAY),
)

#: Section 6.1: speed and acceleration, which 8.3 refers to.
RAMPS = (
    said(
        "6.1/range", "A speed is 0 to 3000; a greater one turns faster.", "motion/*/crossed-speed", "motion/run_speed/speed-*"
    ),
    said("6.1/zero-stops", "Speed 0 stops the shaft.", *each(RUNS, "motion/{}/speed-0")),
    said(
        "6.1/mode-limit",
        "A speed above the mode's maximum turns the shaft at that maximum.",
        "motion/run_speed/highest-sr_*",
        "motion/*/beyond-highest",
        "motion/*/mode-limit",
    ),
    said(
        "6.1/16-32-64",
        "At 16, 32 and 64 subdivisions the speed is that which is sent.",
        *(f"motion/set_subdivision/speed-at-{n}" for n in (16, 32, 64)),
        "motion/set_subdivision/pulses-at-64",
    ),
    said(
        "6.1/other-subdivisions",
        "At others it is speed times 16 over the subdivision.",
        *(f"motion/set_subdivision/speed-at-{n}" for n in (2, 8, 100, 128, 256)),
        "motion/move_*/crossed-speed",
    ),
    said("6.1/8", "At 8 subdivisions speed 1200 is 2400 rpm.", "motion/set_subdivision/speed-at-8"),
    said("6.1/128", "At 128 subdivisions speed 1200 is 150 rpm.", "motion/set_subdivision/speed-at-128"),
    said(
        "6.1/acceleration",
        "An acceleration is 0 to 255; a greater one is a steeper ramp.",
        "timing/run_speed/ramp-*",
        "ranges/run_speed/acceleration/*",
    ),
    said(
        "6.1/at-once",
        "With acceleration 0 the shaft takes its speed at once.",
        "timing/run_speed/ramp-0",
        "timing/stop_speed/ramp-0",
    ),
    said(
        "6.1/up",
        "On the way up each rpm takes (256 - acc) times 50 microseconds.",
        "timing/run_speed/ramp-*",
        *each(RUNS, "motion/{}/crossed-course"),
    ),
    said("6.1/up-to-speed", "The way up ends at the speed that was asked for.", "motion/run_speed/speed-*"),
    said("6.1/example-236", "At acceleration 236 each rpm takes 1 ms.", "timing/run_speed/ramp-236"),
    said(
        "6.1/down",
        "On the way down each rpm takes as long as on the way up.",
        "timing/stop_speed/ramp-*",
        "timing/run_speed/ramp-240-to-60",
    ),
    said("6.1/down-to-speed", "The way down ends at the lower speed that was asked for.", "timing/run_speed/ramp-240-to-60"),
)
