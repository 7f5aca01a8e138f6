"""Motion of a drive under test: moves by any of its commands, watched through its own reads."""
