"""What is configured: the keys, their checks, and YAML files with lines."""

from .causes import Causes, causes_of
from .kept_settings import read_kept, settings_of
from .monitor_config import (
    DEFAULT_SIGNALS,
    NODE_PARAMETERS,
    NODES,
    MonitorConfig,
    Section,
    described_parameters,
    find_section,
    is_whole_file,
    load_config,
    read_monitor,
    sections,
)
from .parameters import Parameter, flatten, unflatten
from .remarks import doubt_of, remarks_of
from .schema import (
    LATEST_S,
    REQUIRED,
    Time,
    declared,
    read_parameters,
    read_record,
    read_section,
    read_texts,
    require_mapping,
    row_reader,
)
from .signal_config import (
    ACTIVE,
    BOUNDS,
    CONDITIONS,
    LINK,
    LINK_CONFIG,
    LONGEST_NAME,
    LONGEST_S,
    OF_ARRIVALS,
    SignalConfig,
    is_element_name,
    read_signal,
    template_name,
)
from .yaml_file import YamlFile, parse_yaml, read_yaml

__all__ = [
    "ACTIVE", "BOUNDS", "CONDITIONS", "Causes", "DEFAULT_SIGNALS", "LATEST_S", "LINK", "LINK_CONFIG",
    "LONGEST_NAME", "LONGEST_S", "MonitorConfig", "NODES", "NODE_PARAMETERS", "OF_ARRIVALS", "Parameter", "REQUIRED",
    "Section", "SignalConfig", "Time", "YamlFile", "causes_of", "declared", "described_parameters",
    "doubt_of", "find_section", "flatten", "is_element_name", "is_whole_file", "load_config",
    "parse_yaml", "read_kept", "read_monitor", "read_parameters", "read_record", "read_section", "read_signal",
    "read_texts", "read_yaml", "remarks_of",
    "require_mapping", "row_reader", "sections", "settings_of", "template_name", "unflatten",
]  # fmt: skip
