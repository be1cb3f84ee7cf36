"""The description of a middleware's messages."""

from __future__ import annotations

from robot_health_monitor.core.messages.dialect import Dialect, FieldType


def test_a_field_is_one_plain_value_unless_it_says_otherwise() -> None:
    field = FieldType("double", "float64")
    assert (field.message, field.is_array, field.size, field.most) == (None, False, None, None)


def test_messages_are_objects_with_attributes_unless_a_dialect_says_otherwise() -> None:
    class Message:
        data = 0

    dialect = Dialect(lambda *_: Message, str, lambda _: {}, {}, list, list)
    message = dialect.new(Message)
    dialect.assign(message, "data", 5)
    assert message.data == 5
