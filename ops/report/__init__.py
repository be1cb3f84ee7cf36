"""The report of a replay or of a history: one HTML file with a plot per signal."""
