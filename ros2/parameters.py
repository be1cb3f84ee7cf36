"""The ROS 2 parameters of a node, as its configuration: declared with descriptors, changeable at run time.

`ParameterFiles` checks the files given with `--params-file` before rcl reads them, so that errors name file and line.
"""

from __future__ import annotations

import contextlib
import os
import re
from functools import partial
from typing import Any, Iterator, Sequence

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.logging import LoggingSeverity
from rclpy.node import Node

from ..core.config import NODE_PARAMETERS, Parameter, load_config, read_yaml, sections, unflatten
from ..core.port import OnChange
from ..core.values import ConfigError, JsonObject, Problems
from ..runtime.native_node import Log, apply_change
from .messages import plain

_START_ONLY = {
    parameter.name: parameter for parameter in NODE_PARAMETERS if parameter.name in ("executor", "use_sim_time")
}
"""Parameters that this adapter reads itself, at the start only."""
_NOT_FOR_NODES = (*_START_ONLY, "qos_overrides", "start_type_description_service")
"""Parameters that this adapter or rclpy reads for itself."""
_OPTION = "--params-file"
_NODE = re.compile(r"^(['\"]?)(\w+)\1(?=\s*:)", re.MULTILINE)
"""The name of a node in a parameter file, without a namespace."""


class ParameterNode(Node):  # type: ignore[misc]  # rclpy is not typed
    """An rclpy node that declares the parameters that it was given."""

    def __init__(self, name: str, **options: Any) -> None:
        """Creates the node; `options` are further arguments of rclpy's Node."""
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **options)

    def declare_parameters(self, namespace: str, parameters: list[Any], ignore_override: bool = False) -> list[Any]:
        """Declares an empty list too, which rcl gives no type: rclpy could not start the node."""
        untyped = ParameterDescriptor(dynamic_typing=True)
        parameters = [
            parameter
            if len(parameter) < 3 or parameter[1] is not None or parameter[2].dynamic_typing
            else (parameter[0], None, untyped)
            for parameter in parameters
        ]
        declared: list[Any] = super().declare_parameters(namespace, parameters, ignore_override)
        return declared


class NodeParameters:
    """Reads the parameters of one node, and proposes their changes to it."""

    def __init__(self, node: Node) -> None:
        """Reads what was given to a node that has declared nothing else."""
        self._node = node
        values = {name: parameter.value for name, parameter in node.get_parameters_by_prefix("").items()}
        given = {name: [] if value is None else plain(value) for name, value in values.items()}
        self._own = {name: given[name] for name in _START_ONLY if name in given}
        self._given = {name: value for name, value in given.items() if name.partition(".")[0] not in _NOT_FOR_NODES}
        self._declared: dict[str, Parameter] = {}

    @property
    def executor(self) -> str:
        """The parameter `executor`."""
        return str(self._own.get("executor", _START_ONLY["executor"].default))

    def given(self) -> JsonObject:
        """Returns the configuration in force.

        Raises ConfigError if a parameter of the adapter is wrong, or if a name begins another.
        """
        for name, value in self._own.items():
            _START_ONLY[name].read(value, (name,))
        return unflatten(self._given)

    def declare(self, parameters: Sequence[Parameter], apply: OnChange, log: Log) -> None:
        """Declares parameters by their dotted paths; `use_sim_time` and `executor` cannot change from now on.

        Types are dynamic, so that a bound may be set to the whole number 30, as in the file.
        """
        self._declared = {parameter.name: parameter for parameter in parameters}
        for parameter in self._declared.values():
            self._declare(parameter)
        self._set_log_level(self._given)
        # rclpy calls this callback first. The only other one is its own for use_sim_time, which is read-only: a change
        # that the node has accepted is never rejected afterwards.
        self._node.add_on_set_parameters_callback(partial(self._propose, apply, log))
        self._node.add_post_set_parameters_callback(self._declare_deleted)

    def _declare(self, parameter: Parameter) -> None:
        descriptor = ParameterDescriptor(
            description=parameter.description,
            additional_constraints=parameter.allowed,
            read_only=parameter.name in _START_ONLY,
            dynamic_typing=True,
        )
        if self._node.has_parameter(parameter.name):
            self._node.set_descriptor(parameter.name, descriptor)
        else:
            # An empty list has no type in rclpy: it is declared without a value.
            default = None if parameter.default == () else parameter.default
            self._node.declare_parameter(parameter.name, default, descriptor, ignore_override=True)

    def _propose(self, apply: OnChange, log: Log, changes: Sequence[Any]) -> SetParametersResult:
        proposed = {**self._given, **{change.name: plain(change.value) for change in changes}}
        proposed = {name: value for name, value in proposed.items() if value is not None}
        if proposed == self._given:
            return SetParametersResult(successful=True)

        def use() -> str:
            changed = apply(unflatten(proposed))
            self._set_log_level(proposed)
            self._given = proposed
            return changed

        accepted, text = apply_change(use, log)
        return SetParametersResult(successful=accepted, reason="" if accepted else text)

    def _declare_deleted(self, changes: Sequence[Any]) -> None:
        """Declares a parameter again that `ros2 param delete` has removed, so that it can be set again."""
        for change in changes:
            if change.value is None and change.name in self._declared and not self._node.has_parameter(change.name):
                self._declare(self._declared[change.name])

    def _set_log_level(self, values: JsonObject) -> None:
        """Applies the parameter `log_level`; if it is not given, `--log-level` stays in force."""
        if "log_level" in values:
            self._node.get_logger().set_level(LoggingSeverity[values["log_level"]])


class ParameterFiles:
    """The parameter files of a command line.

    For ROS 2, a section `alert_system:` applies to `/alert_system` only: in a namespace it would silently be ignored.
    Here it applies to alert_system in any namespace, as in ROS 1.
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        """Reads them; raises ConfigError if one cannot be read or is not YAML."""
        self._arguments = self._passed = list(arguments)
        self._files = {
            place: read_yaml(arguments[place]) for place in range(1, len(arguments)) if arguments[place - 1] == _OPTION
        }

    @contextlib.contextmanager
    def arguments_for_any_namespace(self) -> Iterator[list[str]]:
        """Returns the arguments with copies of the files in which a node's name applies to any namespace.

        The copies are in memory, as no folder need be writable; they exist while the context is entered, for rclpy to
        read.
        """
        with contextlib.ExitStack() as copies:
            self._passed = list(self._arguments)
            for place, file in self._files.items():
                copy = copies.enter_context(open(os.memfd_create("parameters"), "w", encoding="utf-8"))
                with open(file.file, encoding="utf-8") as stream:
                    copy.write(_NODE.sub(r'"/**/\2"', stream.read()))
                copy.flush()
                self._passed[place] = f"/proc/self/fd/{copy.fileno()}"
            yield self._passed

    def located(self, error: ConfigError, node: str) -> ConfigError:
        """Returns an error of a node with file and line if its key is in one of the files."""
        for file in reversed(self._files.values()):
            for section in sections(file.tree, Problems()):
                path = (*section.path, *error.path)
                if section.node in (node.rpartition("/")[2], "*", "**") and path in file.lines:
                    return file.locate(ConfigError(error.problem, path))
        return error

    def explained(self, problem: str) -> ConfigError:
        """Returns an error message of rcl as a ConfigError: that of the monitor if it refuses a file as well."""
        for file in self._files.values():
            try:
                load_config(file.file)
            except ConfigError as error:
                if error.line is not None:
                    return error
        for passed, given in zip(self._passed, self._arguments):
            problem = problem.replace(passed, given)
        return ConfigError(" ".join(problem.split()))
