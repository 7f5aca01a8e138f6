"""The emulated LK drive: commands, motor and quirks."""
