"""The description of a middleware's messages."""

from __future__ import annotations

from robot_health_monitor.core.messages.dialect import Dialect


def test_messages_are_objects_with_attributes_unless_a_dialect_says_otherwise() -> None:
    class Message:
        data = 0

    dialect = Dialect(lambda *_: Message, lambda _: [], lambda _: None, list)
    message = dialect.new(Message)
    dialect.assign(message, "data", 5)
    assert message.data == 5
    assert dialect.plain([1, 2]) == [1, 2]
