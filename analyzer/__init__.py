"""Servotap listens to the bus of a servo drive and says what happened on it."""

__version__ = "0.1.0"
