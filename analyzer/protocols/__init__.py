"""The dialects: each manual as a table."""
