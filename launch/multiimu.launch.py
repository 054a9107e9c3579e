"""One board to one IMU: the driver, then the stages as processes of their own or as one.

ros2 launch multiimu_ros multiimu.launch.py rig_file:=my_rig.yaml port:=/dev/ttyACM0
"""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

SHARE = FindPackageShare('multiimu_ros')
ARGUMENTS = {
    'rig_file': (PathJoinSubstitution([SHARE, 'config', 'ring8.yaml']), 'rig file of the board'),
    'params_file': (PathJoinSubstitution([SHARE, 'config', 'params.yaml']), 'parameter file'),
    'namespace': ('', 'namespace of all nodes and topics'),
    'use_sim_time': ('false', 'take the time from /clock'),
    'composed': ('true', 'all stages in one process (`pipeline`) instead of three'),
    'port': ('', 'serial port of the board; empty: no driver, something else says data_raw'),
    'profile': ('hand', 'what the rig is mounted on: hand, foot or vehicle'),
}


def node(name, condition, *parameters):
    """Return one node; its parameters are those of the file, then these."""
    shared = {'use_sim_time': LaunchConfiguration('use_sim_time')}
    given = {key: LaunchConfiguration(key) for key in parameters}
    return Node(
        package='multiimu_ros',
        executable=name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[LaunchConfiguration('params_file'), shared | given],
        output='screen',
        condition=condition,
    )


def generate_launch_description():
    """Declare the arguments and start the nodes."""
    composed = LaunchConfiguration('composed')
    with_port = IfCondition(PythonExpression(["'", LaunchConfiguration('port'), "' != ''"]))
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            node('driver', with_port, 'port'),
            node('pipeline', IfCondition(composed), 'rig_file', 'profile'),
            node('calibration', UnlessCondition(composed), 'rig_file'),
            node('registration', UnlessCondition(composed), 'rig_file'),
            node('fusion', UnlessCondition(composed), 'rig_file', 'profile'),
        ]
    )
