"""The model of a drive: what it should be after any sequence of requests, and how sequences are drawn."""
