"""Types of messages and how a field of a message is read, for every middleware and recording."""
