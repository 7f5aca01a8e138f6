"""Claims about settings: what is set is read, obeyed, kept over a restart and restored."""
