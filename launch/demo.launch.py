"""Eight simulated IMUs become one: an emulated board, the driver, and every stage as a process.

ros2 launch multiimu_ros demo.launch.py motion:=foot
"""

from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare

from launch import LaunchDescription

SHARE = FindPackageShare('multiimu_ros')
LINK = '/tmp/multiimu_demo_port'
ARGUMENTS = {
    'rig_file': (PathJoinSubstitution([SHARE, 'config', 'ring8.yaml']), 'rig file to simulate'),
    'motion': ('hand', 'static, turntable, slider, hand or foot'),
    'rate': ('200', 'scans a second [Hz]'),
    'duration': ('60', 'length of the motion [s]'),
    'composed': ('false', 'all stages in one process (`pipeline`) instead of three'),
}


def generate_launch_description():
    """Declare the arguments; start the emulator and what a real board would be given."""
    options = [
        word
        for name in ('motion', 'rate', 'duration')
        for word in (f'--{name}', LaunchConfiguration(name))
    ]
    emulator = ExecuteProcess(
        cmd=[
            ExecutableInPackage('emulator', 'multiimu_ros'),
            *('--rig', LaunchConfiguration('rig_file'), '--link', LINK),
            *options,
        ],
        output='screen',
    )
    graph = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([SHARE, 'launch', 'multiimu.launch.py'])
        ),
        launch_arguments={
            'rig_file': LaunchConfiguration('rig_file'),
            'composed': LaunchConfiguration('composed'),
            'port': LINK,
        }.items(),
    )
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            emulator,
            graph,
        ]
    )
