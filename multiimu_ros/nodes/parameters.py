"""Parameters with a description, a range and one-sentence errors.

rclpy silently ignores a parameter nobody declared and a parameter file made for another node, and
refuses `rate: 100` where a float is meant; here the first two are warned about and the third is
understood.
"""

from collections.abc import Collection, Sequence
from dataclasses import fields, MISSING
from itertools import pairwise
from pathlib import Path
import re
import sys
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import ParameterUninitializedException
from rclpy.node import Node
import yaml

from multiimu_ros.errors import ConfigError

C = TypeVar('C')
DESCRIBED = re.compile(r'^ {4}(\w[\w, ]*) : .*\n((?: {8}.*(?:\n|$))+)', re.MULTILINE)
IMPLICIT = re.compile(r'use_sim_time$|start_type_description_service$|qos_overrides\.')


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    *,
    low: float | None = None,
    choices: Collection[str] = (),
) -> Any:
    """Declare a parameter that is fixed at start-up, and return its value.

    Parameters
    ----------
    default : bool, int, float, str, list of str or of float
        Also says the type; an integer is accepted where it is a float.
    description : str
        One phrase for the user, with the unit in brackets.
    low : float, optional
        The smallest value allowed.
    choices : collection of str, optional
        The only values allowed.

    Raises
    ------
    ConfigError
        If the user's value has another type or lies outside the range.
    """
    limits = ''
    if low is not None:
        limits = f'at least {low:g}'
    if choices:
        limits = f'one of {", ".join(sorted(choices))}'
    descriptor = ParameterDescriptor(
        description=description, additional_constraints=limits, read_only=True, dynamic_typing=True
    )
    try:
        value = node.declare_parameter(name, default, descriptor).value
    except ParameterUninitializedException:  # `[]` in a parameter file has no type
        value = None
    value = _typed(name, value, default)
    if (low is not None and not value >= low) or (choices and value not in choices):
        msg = f'Parameter `{name}` must be {limits}, got {value!r}; {description}.'
        raise ConfigError(msg)
    return value


def _typed(name: str, value: Any, default: Any) -> Any:
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if isinstance(default, list):
        value = [] if value is None else value
        kinds = (float, int) if _is_of_floats(default) else (str,)
        listed = isinstance(value, Sequence) and not isinstance(value, str)
        if listed and all(type(item) in kinds for item in value):
            return [type(default[0])(item) for item in value] if default else list(value)
    elif type(value) is type(default):
        return value
    needed = f'of type {type(default).__name__}'
    if isinstance(default, list):
        needed = f'a list of {"float" if _is_of_floats(default) else "str"}'
    msg = f'Parameter `{name}` must be {needed}, got {value!r}; correct it where it is set.'
    raise ConfigError(msg)


def _is_of_floats(default: list[Any]) -> bool:
    return bool(default) and isinstance(default[0], float)


def declare_config(node: Node, config: type[C], **fixed: Any) -> C:
    """Declare each field of a settings dataclass as a parameter and make the settings.

    Parameters
    ----------
    config : type
        A dataclass; each field has a default of a parameter's type, and its line in the numpydoc
        section `Parameters` becomes the description.
    fixed
        Fields that are not for the user to choose.

    Raises
    ------
    ConfigError
        If a value has the wrong type, or the dataclass refuses it.
    """
    descriptions = _described(config.__doc__ or '')
    values = dict(fixed)
    for field in fields(config):  # type: ignore[arg-type]
        plain = field.default
        if field.name in values or not isinstance(plain, bool | int | float | str | tuple):
            continue
        default = list(plain) if isinstance(plain, tuple) else plain
        value = declare(node, field.name, default, descriptions.get(field.name, ''))
        values[field.name] = tuple(value) if isinstance(plain, tuple) else value
    missing = [
        field.name
        for field in fields(config)  # type: ignore[arg-type]
        if field.name not in values and field.default is field.default_factory is MISSING
    ]
    assert not missing, missing
    try:
        return config(**values)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _described(docstring: str) -> dict[str, str]:
    """Return the phrase of each name in the numpydoc section `Parameters`."""
    section = docstring.partition('Parameters\n')[2].partition('\n\n')[0]
    phrases: dict[str, str] = {}
    for names, text in DESCRIBED.findall(section):
        phrase = ' '.join(text.split()).rstrip('.')
        phrases |= dict.fromkeys(names.replace(' ', '').split(','), phrase)
    return phrases


def warn_about_unused(node: Node) -> None:
    """Warn once about parameters that the user set and the node never declared.

    Called at the end of a node's constructor; also warns about a parameter file none of whose
    sections is for this node.
    """
    overrides = node._parameter_overrides  # rclpy has no public way to ask
    unused = [
        name for name in overrides if not node.has_parameter(name) and not IMPLICIT.match(name)
    ]
    if unused:
        node.get_logger().warning(
            f'Ignored {", ".join(f"`{name}`" for name in sorted(unused))}: no such parameter; '
            f'`ros2 param list {node.get_fully_qualified_name()}` shows the names.'
        )
    for path in _parameter_files(sys.argv):
        _warn_about_foreign_file(node, path)


def _parameter_files(argv: Sequence[str]) -> list[str]:
    pairs = pairwise(argv)
    return [path for option, path in pairs if option == '--params-file']


def _warn_about_foreign_file(node: Node, path: str) -> None:
    content = yaml.safe_load(Path(path).read_text(encoding='utf-8'))  # rcl has read it already
    sections = [str(section) for section in content or ()]
    full = node.get_fully_qualified_name()
    for section in sections:
        pattern = re.escape('/' + section.lstrip('/')).replace(r'/\*\*', '(/.*)?')
        if re.fullmatch(pattern.replace(r'/\*', '/[^/]+'), full):
            return
    node.get_logger().warning(
        f'`{path}` sets nothing for {full}: its sections are {", ".join(sections)}; '
        f'write `/**:` or `{full}:`.'
    )
