"""The values of the monitor: levels, samples, elements, field paths, names, texts, errors. They import nothing else."""

from .elements import (
    ARRAY_TYPE,
    MOST_ELEMENTS,
    NAME_ARRAYS,
    OWN_KEY,
    OWN_TOPICS,
    STATUS_TYPE,
    TIME_TYPES,
    Age,
    BadDatum,
    DriverStatus,
    Elements,
    LinkDown,
    Stamp,
    is_own_status,
    too_many,
    with_ages,
)
from .errors import ConfigError, LinkError, MessageError, Path, Problems, ServiceError
from .faults import PARAMETERS_FAULT, Fault, Faults, summary_of
from .field_path import (
    ABSENT,
    Every,
    Getter,
    Keyed,
    Step,
    element_path,
    every_step,
    key_field,
    leading_path,
    mapping_getter,
    number_of_text,
    parse_field_path,
    steps_getter,
)
from .formatting import (
    bound_text,
    count_text,
    datum_text,
    describe,
    duration_text,
    fingerprint,
    list_text,
    number_text,
    printable,
    with_degree_sign,
    with_hint,
    with_unit,
)
from .goals import STATUS_TOPICS, STATUS_TYPES, Goals
from .model import Changes, Clock, Forecast, JsonObject, Level, Message, Report, Sample, Status, Transition
from .names import canonical_type, full_name, is_namespace, resolve_name, split_type_name
from .nesting import read_json, shallow_json
from .patterns import matches_pattern
from .reduction import REDUCTIONS, Element, Reduced, reduced
from .version import package_version
from .where import COMPARE, is_equal, parse_where, selected, selection

__all__ = [
    "ABSENT", "ARRAY_TYPE", "Age", "BadDatum", "COMPARE", "Changes", "Clock", "ConfigError", "DriverStatus",
    "Element", "Elements", "Every", "Fault", "Faults", "Forecast", "Getter", "Goals", "JsonObject", "Keyed", "Level",
    "LinkDown", "LinkError", "MOST_ELEMENTS", "Message", "MessageError", "NAME_ARRAYS", "OWN_KEY", "OWN_TOPICS",
    "PARAMETERS_FAULT", "Path", "Problems", "REDUCTIONS", "Reduced", "Report", "STATUS_TOPICS", "STATUS_TYPE",
    "STATUS_TYPES", "Sample", "ServiceError", "Stamp", "Status", "Step", "TIME_TYPES", "Transition", "bound_text",
    "canonical_type", "count_text", "datum_text", "describe", "duration_text", "element_path", "every_step",
    "fingerprint", "full_name", "is_equal", "is_namespace", "is_own_status", "key_field", "leading_path", "list_text",
    "mapping_getter", "matches_pattern", "number_of_text", "number_text", "package_version", "parse_field_path",
    "parse_where", "printable", "read_json", "reduced", "resolve_name", "selected", "selection", "shallow_json",
    "split_type_name", "steps_getter", "summary_of", "too_many", "with_ages", "with_degree_sign", "with_hint",
    "with_unit",
]  # fmt: skip
