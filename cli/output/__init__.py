"""Output of the command line: a live table, plain lines or JSON."""
