"""The command line and the executables: all wiring is here."""
