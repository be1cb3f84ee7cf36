"""The port over a WebSocket: nodes for a robot that only its rosbridge server can reach."""
