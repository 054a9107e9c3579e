"""Parameters inside one process: types, ranges, descriptions."""

from dataclasses import dataclass

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

from multiimu_ros.errors import ConfigError
from multiimu_ros.nodes.parameters import declare, declare_config

pytestmark = pytest.mark.ros


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of nothing.

    Parameters
    ----------
    window_s, hop_s : float
        Length of the window
        and of the hop [s].
    name : str
        What to call it.
    """

    window_s: float = 1.0
    hop_s: float = 0.5
    name: str = 'a'

    def __post_init__(self):
        if self.hop_s > self.window_s:
            msg = f'`hop_s` must be below `window_s`, got {self.hop_s}.'
            raise ValueError(msg)


@pytest.fixture
def make_node():
    """Return a function that makes a node with these overrides."""
    rclpy.init()
    nodes = []

    def make(**overrides):
        parameters = [Parameter(name, value=value) for name, value in overrides.items()]
        nodes.append(Node('settings', parameter_overrides=parameters))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


def test_an_integer_is_understood_where_a_float_is_meant(make_node):
    value = declare(make_node(rate=100), 'rate', 1.0, 'rate [Hz]')
    assert (type(value), value) == (float, 100.0)


def test_a_value_below_its_limit_is_refused_with_the_limit(make_node):
    with pytest.raises(ConfigError, match=r'`rate` must be at least 1, got 0.5; rate \[Hz\].'):
        declare(make_node(rate=0.5), 'rate', 2.0, 'rate [Hz]', low=1.0)


def test_an_unknown_choice_is_refused_with_the_known_ones(make_node):
    with pytest.raises(ConfigError, match="must be one of hard, soft, got 'mild'"):
        declare(make_node(mode='mild'), 'mode', 'soft', 'mode', choices=('soft', 'hard'))


def test_a_text_is_no_number(make_node):
    with pytest.raises(ConfigError, match="`rate` must be of type float, got 'fast'"):
        declare(make_node(rate='fast'), 'rate', 2.0, 'rate [Hz]')


def test_settings_become_parameters_with_the_docstrings_words(make_node):
    node = make_node(window_s=2, name='b')
    assert declare_config(node, Settings, hop_s=0.1) == Settings(window_s=2.0, hop_s=0.1, name='b')
    assert not node.has_parameter('hop_s')
    descriptor = node.describe_parameter('window_s')
    assert descriptor.description == 'Length of the window and of the hop [s]'
    assert descriptor.read_only


def test_what_the_settings_refuse_is_a_config_error(make_node):
    with pytest.raises(ConfigError, match='`hop_s` must be below'):
        declare_config(make_node(hop_s=3.0), Settings)


@pytest.mark.parametrize('given', [[0.1, 0.0, -0.2], [1, 0, 2]])
def test_a_tuple_of_floats_is_a_list_of_numbers(make_node, given):
    value = declare(make_node(point=given), 'point', [0.0, 0.0, 0.0], 'point [m]')
    assert value == given
    assert {type(item) for item in value} == {float}


@pytest.mark.parametrize('given', [['a', 'b', 'c'], 'abc', [True, False, True]])
def test_what_is_no_list_of_numbers_is_refused(make_node, given):
    with pytest.raises(ConfigError, match='`point` must be a list of float'):
        declare(make_node(point=given), 'point', [0.0, 0.0, 0.0], 'point [m]')
