"""The black box: a recording of each robot's messages around each alert, as an MCAP file."""
