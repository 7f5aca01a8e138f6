"""Claims about Modbus: functions, registers, writes."""
