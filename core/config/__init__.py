"""What is configured: the keys, their checks, and YAML files with lines."""
