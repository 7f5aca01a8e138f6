"""Claims about frames alone: shape, framing, worked examples, traffic."""
