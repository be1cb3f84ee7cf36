"""What the clients of all bridges share: addresses, one connection per robot, nodes. No protocol."""
