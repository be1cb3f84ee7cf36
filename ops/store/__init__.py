"""The history: transitions with their evidence, and what a restarted monitor resumes from, in one SQLite file."""
