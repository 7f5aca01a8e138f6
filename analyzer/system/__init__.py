"""What the program asks of the operating system: processes with bounds, folders for a while, small files as a whole."""
