"""`python -m multiimu_ros.cli`, for where the script `multiimu` is not on the path."""

from multiimu_ros.cli.app import main

main()
