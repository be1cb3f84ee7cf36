"""The commands of `robot-health`, a module each."""
