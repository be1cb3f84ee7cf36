"""Recordings as one more implementation of the port: time and messages come from files."""
