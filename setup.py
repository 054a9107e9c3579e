"""Build for pip and for colcon (ament_python); pyproject.toml holds the tools' settings only.

colcon puts the console scripts into lib/multiimu_ros, where `ros2 run` looks (setup.cfg).  pip
ignores that and fills bin/, so the wrappers of lib/ are installed beside them as data files.
"""

from pathlib import Path

from setuptools import find_packages, setup

NAME = 'multiimu_ros'
NODES = ('driver', 'calibration', 'registration', 'fusion', 'pipeline', 'record', 'play')


def files(folder, *patterns):
    """Return the paths in a folder that match, sorted, relative to this file."""
    return sorted(str(path) for pattern in patterns for path in Path(folder).glob(pattern))


setup(
    name=NAME,
    version='0.1.0',
    description='Turn 1-16 cheap IMUs on one rigid body into one good IMU and an odometry.',
    license='Apache-2.0',
    maintainer='multiimu_ros maintainers',
    maintainer_email='maintainers@users.noreply.h-seed-e7f4b59e.example',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed'], f'{NAME}.report': ['*.html', '*.css']},
    python_requires='>=3.11',
    install_requires=[
        'setuptools',
        'allantools',
        'matplotlib',
        'numba',
        'numpy',
        'pydantic>=2',
        'pyserial',
        'PyYAML',
        'rich',
        'rosbags',
        'scipy',
        'typer',
    ],
    extras_require={'wavelet': ['PyWavelets']},
    zip_safe=False,
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', files('config', '*.yaml', '*.rules')),
        (f'share/{NAME}/launch', files('launch', '*.launch.py')),
        (f'lib/{NAME}', files(f'lib/{NAME}', '*')),
    ],
    entry_points={
        'console_scripts': [
            f'multiimu = {NAME}.cli.app:main',
            *(f'{name} = {NAME}.cli.executables:main' for name in ('emulator', *NODES)),
        ]
    },
)
