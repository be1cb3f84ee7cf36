"""The files of the web page, as data."""
