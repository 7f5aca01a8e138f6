"""A run of the suite: which claims on which drives, the rig of each, and the verdicts."""
