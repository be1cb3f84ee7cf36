"""Types of messages and how a field of a message is read, for every middleware and recording."""

from .definitions import (
    LONGEST_TEXT,
    NUMBERS,
    ROS1_KINDS,
    SEQUENCE,
    TEXTS,
    Definitions,
    Field,
    parse_definition,
    parse_msg,
)
from .dialect import Dialect
from .mapping_field import MISSING, MappingField
from .native_messages import NativeMessages, find_generated
from .raw_messages import PROFILES, RawFormat, json_bytes, json_format, json_text, ros1_format, ros2_format
from .serialized import SerializedType
from .standard_messages import MESSAGES, PACKAGES, SERVICES, check_field, check_type, complete, definition, is_stamped

__all__ = [
    "Definitions", "Dialect", "Field", "LONGEST_TEXT", "MESSAGES", "MISSING", "MappingField", "NUMBERS",
    "NativeMessages", "PACKAGES", "PROFILES", "ROS1_KINDS", "RawFormat", "SEQUENCE", "SERVICES", "SerializedType",
    "TEXTS", "check_field", "check_type", "complete", "definition", "find_generated", "is_stamped", "json_bytes",
    "json_format", "json_text", "parse_definition", "parse_msg", "ros1_format", "ros2_format",
]  # fmt: skip
