"""Claims about a drive that still hears and obeys after many, damaged or odd requests."""
