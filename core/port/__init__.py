"""The port: what a node needs from a middleware, and the in-process implementation."""
