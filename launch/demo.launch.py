"""Eight simulated IMUs become one: an emulated board, the driver, and every stage as a process.

ros2 launch multiimu_ros demo.launch.py motion:=foot profile:=foot

The emulator writes the calibration of its board before it says where its port is, so its first
line starts the nodes; and the motion's end is the demonstration's.
"""

from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    IncludeLaunchDescription,
    RegisterEventHandler,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.event_handlers import OnProcessIO
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import (
    EnvironmentVariable,
    LaunchConfiguration,
    LaunchLogDir,
    PathJoinSubstitution,
)
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare

from launch import LaunchDescription

SHARE = FindPackageShare('multiimu_ros')
PORT = PathJoinSubstitution([LaunchLogDir(), 'board'])
CALIBRATED = PathJoinSubstitution([LaunchLogDir(), 'rig.yaml'])
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
ARGUMENTS = {
    'rig_file': (PathJoinSubstitution([SHARE, 'config', 'ring8.yaml']), 'rig file to simulate'),
    'motion': ('hand', 'static, turntable, slider, hand or foot'),
    'rate': ('200', 'scans a second [Hz]'),
    'duration': ('60', 'length of the motion, and of the demonstration [s]'),
    'profile': ('hand', 'what the rig is mounted on: hand, foot or vehicle'),
    'composed': ('false', 'all stages in one process (`pipeline`) instead of three'),
}


def emulated_board():
    """Return the process that plays the board; the launch ends with it."""
    options = [
        word
        for name in ('motion', 'rate', 'duration')
        for word in (f'--{name}', LaunchConfiguration(name))
    ]
    return ExecuteProcess(
        cmd=[
            ExecutableInPackage('emulator', 'multiimu_ros'),
            *('--rig', LaunchConfiguration('rig_file'), '--calibrated-rig', CALIBRATED),
            *('--link', PORT),
            *options,
        ],
        output='screen',
        on_exit=Shutdown(reason='the motion is over'),
    )


def graph():
    """Return what a real board would be given."""
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([SHARE, 'launch', 'multiimu.launch.py'])
        ),
        launch_arguments={
            'rig_file': CALIBRATED,
            'profile': LaunchConfiguration('profile'),
            'composed': LaunchConfiguration('composed'),
            'port': PORT,
        }.items(),
    )


def generate_launch_description():
    """Declare the arguments; start the emulator and, once its port is there, the nodes."""
    emulator = emulated_board()
    at_first_line = OnProcessIO(
        target_action=emulator, on_stdout=lambda _: graph(), handle_once=True
    )
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            SetEnvironmentVariable(RANGE, EnvironmentVariable(RANGE, default_value='LOCALHOST')),
            RegisterEventHandler(at_first_line),
            emulator,
        ]
    )
