"""What a run says: on the terminal, as a page, as logs. Everything here works on records of verdicts and knows no rig."""
