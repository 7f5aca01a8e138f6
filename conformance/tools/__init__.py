"""Tools that talk to drives beside the suite: scan, replay, and the mutants that prove the suite itself."""
