"""What operators use: the report of a replay, and the plot that it shares with the web page."""
