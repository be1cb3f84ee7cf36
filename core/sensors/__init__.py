"""Sources of measurements: simulated, this host, or none."""
