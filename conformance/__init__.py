"""The conformance side of Servotap: emulated drives, and claims that prove a drive against its manual."""
