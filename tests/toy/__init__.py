"""An invented drive that no part of the project knows: all that is said of it stands in `dialect.py`."""
