"""Claims about motion: what a command does to the shaft, and what is read of it meanwhile."""
