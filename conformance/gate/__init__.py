"""The gate: what may be sent to a motor, judged by the bytes that leave."""
