"""The traffic in the captures of this folder: every row was written by hand from the manuals, bytes and meaning.

A row has a time in ms, the sender (> host, < drive), the bytes without their check, and their meaning. The meaning uses the
words of `servotap show`: address, command, role, fields. It is never computed from the bytes. `make.py` puts the bytes into
files of every format and the meaning into the golden decodes beside them, and the tests hold both together.
"""

from __future__ import annotations

from typing import NamedTuple


class Row(NamedTuple):
    """One frame: time in ms, `>` or `<`, hex text without its check (CAN: ID first), its meaning.

    `raw`: the text is the whole frame with its check, right or wrong.
    """

    at: float
    sender: str
    text: str
    meaning: str
    raw: bool = False


# MKS SERVO42D/57D, native frames. A drive at address 1 is set up, runs, moves 20 turns and is stopped; address 2 answers
# a read; a broadcast, a package and a group; one status 0 and one reply with a bad check.
MKS_RS485 = (
    Row(0.000, ">", "FA 01 30", "1 read_encoder_carry request"),
    Row(3.125, "<", "FB 01 30 FF FF FF FF 22 69", "1 read_encoder_carry reply carry=-1 encoder=8809"),
    Row(10.000, ">", "FA 01 31", "1 read_position request"),
    Row(13.250, "<", "FB 01 31 00 00 00 00 7F F0", "1 read_position reply position=32752"),
    Row(20.000, ">", "FA 01 82 05", "1 set_work_mode request work_mode=sr_vfoc"),
    Row(24.000, "<", "FB 01 82 01", "1 set_work_mode reply status=success"),
    Row(520.000, ">", "FA 01 83 06 40", "1 set_current request current=1600"),
    Row(524.125, "<", "FB 01 83 01", "1 set_current reply status=success"),
    Row(1020.000, ">", "FA 01 84 10", "1 set_subdivision request subdivision=16"),
    Row(1024.000, "<", "FB 01 84 01", "1 set_subdivision reply status=success"),
    Row(1030.000, ">", "FA 01 F3 01", "1 enable request enabled=enabled"),
    Row(1033.500, "<", "FB 01 F3 01", "1 enable reply status=success"),
    Row(1040.000, ">", "FA 01 F6 01 40 02", "1 run_speed request direction=ccw speed=320 acceleration=2"),
    Row(1043.000, "<", "FB 01 F6 01", "1 run_speed reply status=success"),
    Row(1140.000, ">", "FA 01 32", "1 read_speed request"),
    Row(1143.000, "<", "FB 01 32 01 40", "1 read_speed reply speed=320"),
    Row(1150.000, ">", "FA 01 F1", "1 read_status request"),
    Row(1153.000, "<", "FB 01 F1 04", "1 read_status reply status=full_speed"),
    Row(1160.000, ">", "FA 01 F6 00 00 02", "1 stop_speed request direction=ccw speed=0 acceleration=2"),
    Row(1163.000, "<", "FB 01 F6 01", "1 stop_speed reply status=starting"),
    Row(5230.000, "<", "FB 01 F6 02", "1 stop_speed reply status=complete"),
    Row(5300.000, ">", "FA 01 FD 81 40 02 00 00 FA 00",
        "1 move_relative_pulses request direction=cw speed=320 acceleration=2 pulses=64000"),
    Row(5303.000, "<", "FB 01 FD 01", "1 move_relative_pulses reply status=starting"),
    Row(5400.000, ">", "FA 01 39", "1 read_angle_error request"),
    Row(5403.000, "<", "FB 01 39 00 00 00 8E", "1 read_angle_error reply angle_error=0.998437"),
    Row(9053.000, "<", "FB 01 FD 02", "1 move_relative_pulses reply status=complete"),
    Row(9100.000, ">", "FA 01 F4 02 58 02 FF FF C0 00",
        "1 move_relative_axis request speed=600 acceleration=2 position=-16384"),
    Row(9103.000, "<", "FB 01 F4 01", "1 move_relative_axis reply status=starting"),
    Row(9460.000, "<", "FB 01 F4 02", "1 move_relative_axis reply status=complete"),
    Row(9500.000, ">", "FA 02 34", "2 read_io request"),
    Row(9503.000, "<", "FB 02 34 05", "2 read_io reply out_2=low out_1=high in_2=low in_1=high"),
    Row(9600.000, ">", "FA 00 F6 00 00 00", "0 stop_speed request direction=ccw speed=0 acceleration=0"),
    Row(9700.000, ">", "FC 01 F6 00 32 0A 00 00 00 00 00 02 F6 80 64 20 00 00 00 00 00" + " 00" * 30,
        "all long_package request 1:run_speed 2:run_speed"),
    Row(9800.000, ">", "FA 01 83 17 70", "1 set_current request current=6000 ! out_of_range"),
    Row(9804.000, "<", "FB 01 83 00", "1 set_current reply status=failed ! failed_status"),
    Row(9900.000, ">", "FA 01 3A", "1 read_enabled request"),
    Row(9903.000, "<", "FB 01 3A 01 30", "1 read_enabled reply enabled=enabled ! bad_checksum", raw=True),
    Row(10000.000, ">", "FA 01 F7", "1 emergency_stop request"),
    Row(10003.000, "<", "FB 01 F7 01", "1 emergency_stop reply status=success"),
)  # fmt: skip

# The same drive under Modbus-RTU: reads, writes by 06 and 10, a refused write, an exception, a read of a register that
# the manual does not list.
MKS_MODBUS = (
    Row(0.0, ">", "01 04 00 30 00 03", "1 read_encoder_carry request"),
    Row(4.0, "<", "01 04 06 00 00 00 01 3F F0", "1 read_encoder_carry reply carry=1 encoder=16368"),
    Row(20.0, ">", "01 04 00 32 00 01", "1 read_speed request"),
    Row(24.0, "<", "01 04 02 FE D4", "1 read_speed reply speed=-300"),
    Row(40.0, ">", "01 06 00 82 00 05", "1 set_work_mode request work_mode=sr_vfoc"),
    Row(45.0, "<", "01 06 00 82 00 05", "1 set_work_mode reply work_mode=sr_vfoc"),
    Row(560.0, ">", "01 10 00 90 00 03 05 00 01 00 64 00",
        "1 set_home request home_trigger=low home_direction=ccw home_speed=100 end_limit=disabled"),
    Row(565.0, "<", "01 10 00 90 00 03", "1 set_home reply quantity=3"),
    Row(1080.0, ">", "01 10 00 F6 00 02 04 01 02 01 40",
        "1 run_speed request direction=cw acceleration=2 speed=320"),
    Row(1084.0, "<", "01 10 00 F6 00 02", "1 run_speed reply quantity=2"),
    Row(1100.0, ">", "01 04 00 F1 00 01", "1 read_status request"),
    Row(1104.0, "<", "01 04 02 00 02", "1 read_status reply status=speeding_up"),
    Row(1200.0, ">", "01 10 00 F6 00 02 04 00 00 00 00",
        "1 stop_speed request direction=ccw acceleration=0 speed=0"),
    Row(1204.0, "<", "01 10 00 F6 00 02", "1 stop_speed reply quantity=2"),
    Row(1300.0, ">", "01 10 00 FD 00 04 08 00 64 02 58 00 00 0C 80",
        "1 move_relative_pulses request direction=ccw acceleration=100 speed=600 pulses=3200"),
    Row(1304.0, "<", "01 10 00 FD 00 04", "1 move_relative_pulses reply quantity=4"),
    Row(1400.0, ">", "01 06 00 82 00 09", "1 set_work_mode request work_mode=9 ! unknown_choice"),
    Row(1404.0, "<", "01 06 00 82 FF FF", "1 set_work_mode reply refused=65535 ! refused_write"),
    Row(1500.0, ">", "01 03 00 10 00 02", "1 unknown_read request register=16 quantity=2 ! unknown_command"),
    Row(1504.0, "<", "01 83 01", "1 unknown_read reply exception=illegal_function ! modbus_exception"),
    Row(1600.0, ">", "01 06 00 F7 00 01", "1 emergency_stop request execute=1"),
    Row(1604.0, "<", "01 06 00 F7 00 01", "1 emergency_stop reply execute=1"),
)  # fmt: skip

# MKS SERVO42E/57E on CAN, two drives. IDs first.
MKS_CAN = (
    Row(0.0, ">", "001 30", "1 read_encoder_carry request"),
    Row(0.35, "<", "001 30 00 00 00 01 29 EF", "1 read_encoder_carry reply carry=1 encoder=10735"),
    Row(10.0, ">", "001 40", "1 read_version request"),
    Row(10.4, "<", "001 40 92 01 00 01",
        "1 read_version reply series=e calibration=cw_raises hardware=s42e_can firmware_major=1 firmware_minor=0 "
        "firmware_patch=1"),
    Row(20.0, ">", "001 82 05", "1 set_work_mode request work_mode=bus_closed"),
    Row(21.0, "<", "001 82 01", "1 set_work_mode reply status=success"),
    Row(520.0, ">", "001 00 83", "1 read_parameter request parameter=current"),
    Row(520.6, "<", "001 83 06 40", "1 read_parameter reply current=1600"),
    Row(530.0, ">", "001 F3 01", "1 enable request enabled=enabled"),
    Row(530.4, "<", "001 F3 01", "1 enable reply status=success"),
    Row(540.0, ">", "001 F6 01 40 02", "1 run_speed request direction=ccw speed=320 acceleration=2"),
    Row(540.4, "<", "001 F6 01", "1 run_speed reply status=success"),
    Row(640.0, ">", "001 32", "1 read_speed request"),
    Row(640.4, "<", "001 32 01 40", "1 read_speed reply speed=320"),
    Row(700.0, ">", "001 F6 00 00 02", "1 stop_speed request direction=ccw speed=0 acceleration=2"),
    Row(700.4, "<", "001 F6 01", "1 stop_speed reply status=starting"),
    Row(4764.0, "<", "001 F6 02", "1 stop_speed reply status=complete"),
    Row(4800.0, ">", "001 F5 02 58 02 FF C0 00",
        "1 move_absolute_axis request speed=600 acceleration=2 position=-16384"),
    Row(4800.4, "<", "001 F5 01", "1 move_absolute_axis reply status=starting"),
    Row(5100.0, "<", "001 F5 02", "1 move_absolute_axis reply status=complete"),
    Row(5200.0, ">", "002 3E", "2 read_protection request"),
    Row(5200.4, "<", "002 3E 01", "2 read_protection reply status=protected"),
    Row(5300.0, ">", "000 F7", "0 emergency_stop request"),
    Row(5400.0, ">", "001 84 03", "1 set_subdivision request subdivision=3 ! unknown_choice"),
    Row(5400.4, "<", "001 84 00", "1 set_subdivision reply status=failed ! failed_status"),
)  # fmt: skip

# Lingkong. Head with its sum, data with theirs: the check texts are left out here too.
LK_RS485 = (
    Row(0.00, ">", "3E 88 01 00", "1 motor_on request"),
    Row(0.25, "<", "3E 88 01 00", "1 motor_on reply"),
    Row(5.00, ">", "3E 9A 01 00", "1 read_state_1 request"),
    Row(5.25, "<", "3E 9A 01 07|1E 60 09 2C 01 00 00",
        "1 read_state_1 reply temperature=30 voltage=24 current=3 state=on input_lost=0 stalled=0 short_circuit=0 "
        "overcurrent=0 motor_hot=0 drive_hot=0 high_voltage=0 low_voltage=0"),
    Row(10.00, ">", "3E A2 01 04|A0 8C 00 00", "1 run_speed request speed=360"),
    Row(10.25, "<", "3E A2 01 07|1E 64 00 68 01 00 40",
        "1 run_speed reply temperature=30 torque_current=100 speed=360 encoder=16384"),
    Row(20.00, ">", "3E A4 01 0C|50 46 00 00 00 00 00 00 50 46 00 00",
        "1 move_multi_turn_limited request position=180 max_speed=180"),
    Row(20.25, "<", "3E A4 01 07|1F 9C FF B4 00 00 20",
        "1 move_multi_turn_limited reply temperature=31 torque_current=-100 speed=180 encoder=8192"),
    Row(30.00, ">", "3E 92 01 00", "1 read_position request"),
    Row(30.25, "<", "3E 92 01 08|B0 B9 FF FF FF FF FF FF", "1 read_position reply position=-180"),
    Row(40.00, ">", "3E C0 01 07|0A 00 00 00 00 00 00", "1 read_parameter request parameter=angle_pid"),
    Row(40.25, "<", "3E C0 01 07|0A 64 00 0A 00 01 00",
        "1 read_parameter reply parameter=angle_pid angle_kp=100 angle_ki=10 angle_kd=1"),
    Row(50.00, ">", "3E 8C 02 01|10", "2 brake request brake_control=read"),
    Row(50.25, "<", "3E 8C 02 01|00", "2 brake reply brake_state=power_off"),
    Row(60.00, ">", "3E 81 01 00", "1 stop request"),
    Row(60.25, "<", "3E 81 01 00", "1 stop reply"),
    Row(70.00, ">", "3E 80 01 00", "1 motor_off request"),
    Row(70.25, "<", "3E 80 01 00", "1 motor_off reply"),
)  # fmt: skip

SESSIONS = {"mks_rs485": MKS_RS485, "mks_modbus": MKS_MODBUS, "mks_can": MKS_CAN, "lk_rs485": LK_RS485}
