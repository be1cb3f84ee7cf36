"""The rosbridge v2 protocol as pure code: no sockets, no clock, no threads."""
