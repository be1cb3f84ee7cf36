"""What the command line writes: a live table, plain lines or JSON."""
