"""Notifications: what happens to alerts beyond the log, on targets that may be slow, gone or misconfigured."""
