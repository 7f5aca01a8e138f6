"""Sinks: outputs for the decoded records of the pipeline."""
