"""Where what the pipeline decodes goes to."""
