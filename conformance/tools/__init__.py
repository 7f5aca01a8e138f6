"""Tools besides the suite that talk to drives: scan, replay, and the mutants that test the suite itself."""
