"""The suite in pytest: options, collection, fixtures, workers and reports."""
