"""rosbridge: the protocol as pure code, a client that implements the port, a server that serves any port."""
