"""A log as one page: what was captured, what is wrong with it, and its values over time.

    log -> Traffic (columns, counts) -> sections -> page

Nothing is decoded again: a log holds values, units, latencies and findings. A capture becomes a log first.
"""
