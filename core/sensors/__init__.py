"""Sources of measurements: simulated or this machine."""
