"""Talking to a drive: exchanges through the gate, matching of replies, garbled requests."""
