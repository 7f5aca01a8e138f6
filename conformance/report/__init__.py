"""Reports of a run: on the terminal, as a page, as logs. All are made from records of verdicts; no rig is needed."""
