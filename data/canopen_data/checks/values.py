"""Check the values of objects: defaults, configured values and limits, against type and access.

Source: CiA 306-1 v1.4.0, the entries of an object's section; CiA 301 v4.2.0, 7.4.8.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final

from canopen_data.checks.subject import ERROR, NOTICE, WARNING, Rule, Subject
from canopen_data.findings import Finding
from canopen_proto.datatypes import DataType, Value, ValueRangeError, is_number, range_of
from canopen_proto.dictionary.model import Access, Variable
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.pdo.mapping import MAX_BITS

RULES: Final = (
    Rule("default-type", ERROR, "a default that the object's type cannot hold"),
    Rule("text-characters", WARNING, "a text with characters that a VISIBLE_STRING does not have; CiA's own checker takes it"),
    Rule("default-limits", WARNING, "a default outside the object's own limits"),
    Rule("configured-type", ERROR, "a configured value that the object's type cannot hold"),
    Rule("configured-limits", ERROR, "a configured value outside the object's limits: the device will refuse it"),
    Rule("configured-read-only", NOTICE, "a configured value for an object that cannot be written"),
    Rule("limits-crossed", ERROR, "the low limit is above the high limit: nothing can be written"),
    Rule("limit-type", WARNING, "a limit that the object's type cannot hold"),
    Rule("limit-useless", NOTICE, "limits of an object that holds no number"),
    Rule("real-infinite", WARNING, "an infinite REAL: hardly any device means that"),
    Rule("const-default", NOTICE, "a constant whose value the file does not tell"),
    Rule("domain-default", NOTICE, "a DOMAIN with a default"),
    Rule("mappable-type", WARNING, "an object that no PDO can carry is marked as one that a PDO may carry"),
)


def check_values(subject: Subject) -> Iterator[Finding]:
    """Check all variables, each by itself."""
    for variable in subject.dictionary:
        yield from _check_limits(subject, variable)
        if variable.default is not None:
            yield from _check_value(subject, variable, variable.default, "default", "DefaultValue", variable.adds_node_id)
        if variable.configured is not None:
            adds = variable.configured_adds_node_id
            yield from _check_value(subject, variable, variable.configured, "configured", "ParameterValue", adds)
            if not variable.access.writable and variable.configured != variable.default:
                text = f"it is {variable.access}, so that {_shown(variable.configured)} cannot be written there"
                yield subject.of_variable("configured-read-only", variable, text, "ParameterValue")
        elif variable.access is Access.CONST and variable.default is None and variable.subindex:
            # At subindex 0 most files leave it out: names and versions (0x1008 to 0x100A), numbers of entries.
            yield subject.of_variable("const-default", variable, "it is const, but has no DefaultValue", "AccessType")
        yield from _check_type(subject, variable)


def _check_type(subject: Subject, variable: Variable) -> Iterator[Finding]:
    if variable.data_type is DataType.DOMAIN and variable.default not in (None, b""):
        text = "a DOMAIN is sent as it is; a default for it has no meaning"
        yield subject.of_variable("domain-default", variable, text, "DefaultValue")
    if variable.pdo_mappable and (variable.data_type is DataType.DOMAIN or (variable.bit_length or 0) > MAX_BITS):
        text = f"PDOMapping=1, but no PDO can carry a {variable.data_type.name}"
        yield subject.of_variable("mappable-type", variable, text, "PDOMapping")


def _check_value(
    subject: Subject, variable: Variable, value: Value, what: str, field: str, adds_node_id: bool
) -> Iterator[Finding]:
    if isinstance(value, float) and math.isinf(value):
        yield _infinite(subject, variable, field)
        return
    for each in _candidates(subject, value, adds_node_id):
        try:
            variable.encode(each)
        except ValueRangeError as error:
            text = f"{field}={_shown(value)}: {str(error).partition(': ')[2]}"
            is_text = isinstance(each, str) and variable.data_type is DataType.VISIBLE_STRING
            yield subject.of_variable("text-characters" if is_text else f"{what}-type", variable, text, field)
            return
        try:
            variable.check_limits(each)
        except ValueRangeError:
            text = f"{field}={_shown(value)} is outside its limits {_shown(variable.low_limit)}..{_shown(variable.high_limit)}"
            yield subject.of_variable(f"{what}-limits", variable, text, field)
            return


def _infinite(subject: Subject, variable: Variable, field: str) -> Finding:
    return subject.of_variable("real-infinite", variable, f"{field} is infinite", field)


def _candidates(subject: Subject, value: Value, adds_node_id: bool) -> tuple[Value, ...]:
    """Return the value in a device, or those for the lowest and highest node-ID if it depends on an unknown one."""
    if not adds_node_id or not isinstance(value, int):
        return (value,)
    return (value + subject.node_id,) if subject.node_id is not None else (value + 1, value + MAX_NODE_ID)


def _check_limits(subject: Subject, variable: Variable) -> Iterator[Finding]:
    low, high = variable.low_limit, variable.high_limit
    if low is None and high is None:
        return
    if not is_number(variable.data_type) and variable.data_type is not DataType.BOOLEAN:
        text = f"a {variable.data_type.name} has no limits"
        yield subject.of_variable("limit-useless", variable, text, "LowLimit" if low is not None else "HighLimit")
        return
    for field, limit in (("LowLimit", low), ("HighLimit", high)):
        if isinstance(limit, float) and math.isinf(limit):
            yield _infinite(subject, variable, field)
    if low is not None and high is not None and low > high:
        text = f"LowLimit {_shown(low)} is above HighLimit {_shown(high)}: no value lies between"
        yield subject.of_variable("limits-crossed", variable, text, "LowLimit")
    bounds = range_of(variable.data_type)
    for field, limit in (("LowLimit", low), ("HighLimit", high)):
        if bounds is not None and limit is not None and not bounds[0] <= limit <= bounds[1]:
            text = f"{field} {_shown(limit)} is outside {bounds[0]}..{bounds[1]} ({variable.data_type.name})"
            yield subject.of_variable("limit-type", variable, text, field)


def _shown(value: Value | None) -> str:
    if value is None:
        return ""
    text = value.hex() if isinstance(value, bytes) else repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 40 else f"{text[:40]}..."


CHECKS: Final[tuple[Callable[[Subject], Iterator[Finding]], ...]] = (check_values,)
