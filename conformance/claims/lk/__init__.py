"""Claims about what LK motors alone have."""
