"""What the commands show of a stored past."""
