"""What the catalogue and a single frame look like to people and programs: pages, pictures, explanations."""
