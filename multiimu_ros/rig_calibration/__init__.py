"""One recording of N IMUs to one rig file."""
