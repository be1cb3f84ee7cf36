"""The rosbridge server: serves any implementation of the port to rosbridge clients."""
