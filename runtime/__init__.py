"""What adapters and operations need and core must not have: threads, loops, waits, limits, files with secrets."""
